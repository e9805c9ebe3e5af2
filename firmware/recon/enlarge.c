#include "firmware/recon/enlarge.h"

#include "firmware/recon/lenses.h"

#include "core/sfm/pose.h"

#include <stdlib.h>
#include <string.h>

/* The shots that became views. */
struct chosen {
    const struct prep_source *from;
    struct capture c;
    int *shot; // (c.n) among all
};

static err_t decode_chosen(void *ctx, int i, struct image8 *out)
{
    const struct chosen *s = ctx;
    return s->from->decode(s->from->ctx, s->shot[i], out);
}

static err_t decode_chosen16(void *ctx, int i, struct image16 *out)
{
    const struct chosen *s = ctx;
    return s->from->decode16(s->from->ctx, s->shot[i], out);
}

static err_t decode_chosen_mask(void *ctx, int i, struct image8 *out)
{
    const struct chosen *s = ctx;
    return s->from->decode_mask(s->from->ctx, s->shot[i], out);
}

static void add_shot(const struct capture *all, const char *name, bool again, struct chosen *out)
{
    int i = 0;
    while (i + 1 < all->n && strcmp(all->shots[i].name, name) != 0)
        i++;
    out->shot[out->c.n] = i;
    out->c.shots[out->c.n] = all->shots[i];
    out->c.shots[out->c.n++].again = again;
}

/* In the order that prep_read gives back as that of `v`. */
static err_t choose_photographs(const struct capture *all, const struct views *v,
                                struct chosen *out)
{
    const size_t n = (size_t)(v->n + v->n_more);
    out->shot = malloc(n * sizeof *out->shot);
    out->c.shots = malloc(n * sizeof *out->c.shots);
    if (!out->shot || !out->c.shots)
        return err_fail(ERR_NOMEM, "no memory for the names of %zu photographs", n);
    for (int i = 0; i < v->n; i++)
        for (int k = i; k >= 0; k = views_next(v, i, k))
            add_shot(all, v->names[k], k != i, out);
    return OK;
}

static void take_over(struct views *large, struct job_result *out)
{
    struct scene *s = &out->scene;
    const struct shade *shade = out->views.shade;
    const float *drift = out->views.drift;
    lenses_reshape(out, &out->views, large);
    out->views = *large;
    out->views.shade = shade;
    out->views.drift = drift;
    for (int i = 0; i < large->n + large->n_more && drift; i++)
        out->views.log2t[i] += drift[i];
    for (int i = 0; i < s->n_views; i++)
        s->cams[i] = pose_scaled(&s->cams[i], large->extent[i].w, large->extent[i].h);
    s->size = large->size;
    s->names = large->names;
    s->log2t = large->log2t;
    out->views.cams = s->cams;
}

err_t enlarge_run(const struct run *r, const struct capture *c, const struct job_config *cfg,
                  int edge, struct job_result *out)
{
    struct chosen chosen = {.from = cfg->source};
    const struct prep_source *from = cfg->source;
    const struct prep_source source = {decode_chosen,
                                       from ? from->release : NULL,
                                       &chosen,
                                       from && from->decode16 ? decode_chosen16 : NULL,
                                       from ? from->release16 : NULL,
                                       from && from->decode_mask ? decode_chosen_mask : NULL};
    struct views large;
    err_t e = choose_photographs(c, &out->views, &chosen);
    if (!e)
        e = prep_read(r, &chosen.c, cfg->source ? &source : NULL, (struct prep_size){edge, false},
                      &large);
    free(chosen.shot);
    free(chosen.c.shots);
    if (e)
        return e;
    take_over(&large, out);
    return lenses_redraw(r, c, cfg->source, out);
}

void enlarge_plan(struct plan *p, const struct capture *c, const struct prep_source *from, int edge)
{
    prep_plan_capture(p, c, from, (struct prep_size){edge, false});
}
