#include "drivers/format/brackets.h"

#include "core/photo/still.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Photographs of one place, [first, first + n), as they are compared; px NULL: not yet. */
struct place {
    int first, n;
    struct image8 small[BRACKETS_MOST];
};

static void begin_place(struct place *p, int first)
{
    for (int k = 0; k < p->n; k++)
        free(p->small[k].px);
    *p = (struct place){.first = first, .n = 1};
}

/* Whether shot i may be of the place, as far as its file's header tells. */
static bool may_join(const struct shot *all, const struct place *p, int i)
{
    const struct shot *s = &all[i], *first = &all[p->first];
    bool other = s->exposure > 0 && p->n < BRACKETS_MOST && s->image.w == first->image.w &&
                 s->image.h == first->image.h && strcmp(s->camera_id, first->camera_id) == 0;
    for (int k = p->first; k < i && other; k++)
        other = all[k].exposure > 0 && fabs(log2(s->exposure / all[k].exposure)) >= BRACKETS_STOPS;
    return other;
}

static err_t read_small(const struct capture *c, const struct prep_source *from, int i,
                        struct image8 *out)
{
    struct image8 photo;
    err_t e = from->decode(from->ctx, i, &photo);
    if (e)
        return e;
    *out = still_size(photo.w, photo.h);
    out->px = malloc((size_t)out->w * (size_t)out->h + 1); // a strip leaves nothing
    if (out->px)
        still_shrink(&photo, out);
    else
        e = err_fail(ERR_NOMEM, "%s: no memory to compare it", c->shots[i].name);
    from->release(&photo);
    return e;
}

/* Shot i joins the place, or begins the next. */
static err_t place_shot(struct capture *c, const struct prep_source *from, int i, struct place *p)
{
    struct image8 own = {0};
    bool same = false;
    err_t e = OK;
    if (!may_join(c->shots, p, i)) {
        begin_place(p, i);
        return OK;
    }
    if (!p->small[0].px)
        e = read_small(c, from, p->first, &p->small[0]);
    if (!e)
        e = read_small(c, from, i, &own);
    for (int k = p->n - 1; k >= 0 && !same && !e; k--)
        same = still_same(&p->small[k], &own);
    c->shots[i].again = same;
    if (!same)
        begin_place(p, i);
    p->small[i - p->first] = own;
    p->n = i - p->first + 1;
    return e;
}

err_t brackets_mark(struct capture *c, const struct prep_source *from)
{
    struct place p = {.n = 1};
    err_t e = OK;
    for (int i = 1; i < c->n && !e; i++)
        e = place_shot(c, from, i, &p);
    begin_place(&p, 0);
    return e;
}

err_t brackets_mark_lacking(const char *source, const struct rig *rig,
                            const struct prep_source *from, struct capture *c)
{
    bool *has = calloc((size_t)c->n + 1, sizeof *has);
    int n = 0;
    err_t e = has ? OK : err_fail(ERR_NOMEM, "%s: no memory for %d pictures", source, c->n);
    for (int i = 0; i < c->n && !e; i++) {
        e = cameras_has(source, rig, c->shots[i].name, &has[i]);
        n += has[i];
    }
    if (!e && n > 0 && n < c->n)
        e = brackets_mark(c, from);
    for (int i = 0; i < c->n && !e; i++)
        c->shots[i].again = c->shots[i].again && !has[i];
    free(has);
    return e;
}
