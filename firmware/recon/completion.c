#include "firmware/recon/completion.h"

#include "core/base/share.h"
#include "core/net/complete.h"
#include "core/stereo/fill.h"

_Static_assert(FILL_INPUT == (int)NET_COMPLETE_IN && FILL_ANSWER == (int)NET_COMPLETE_OUT,
               "the branch reads what fill_input writes");

struct completion {
    struct fill fill;
    float *input;  // (FILL_INPUT) of one view
    float *answer; // (FILL_ANSWER) of all views, one after another
};

static err_t layout(struct completion *c, struct arena *a, const struct extent *maps, int n)
{
    err_t e = fill_layout(&c->fill, a, maps, n);
    if (!e)
        e = arena_alloc(a, extent_cover(maps, n).at * FILL_INPUT, sizeof *c->input, &c->input);
    return e ? e
             : arena_alloc(a, extent_total(maps, n) * FILL_ANSWER, sizeof *c->answer, &c->answer);
}

/* All views that are dealt to this rank, one after another: the branch keeps the pool busy. */
static err_t ask_branch(const struct run *r, const struct net *net, struct completion *c)
{
    const struct depthmaps *d = c->fill.depth;
    err_t e = OK;
    const int first = team_first(r->team, d->n, team_rank(r->team)), n = team_own(r->team, d->n);
    for (int i = first; i < first + n && !e; i++) {
        const struct extent *map = &d->extent[i];
        const struct complete_in in = {map->h, map->w, c->input};
        fill_input(&c->fill, i, c->input);
        e = complete_run(r, net, &in, c->answer + FILL_ANSWER * map->at);
        if (r->progress)
            r->progress(r->progress_ctx, "completion", i + 1 - first, n, NULL);
    }
    return e;
}

err_t completion_run(const struct run *r, const struct net *net, const struct views *v,
                     const struct tonemap *tone, struct depthmaps *d, float *share)
{
    struct completion c;
    const size_t mark = arena_mark(r->tmp);
    size_t taken = 0;
    err_t e = layout(&c, r->tmp, d->extent, d->n);
    if (!e) {
        fill_set(&c.fill, v, tone, d);
        e = ask_branch(r, net, &c);
    }
    if (!e)
        e = share_gather(r, c.answer, FILL_ANSWER * sizeof *c.answer, d->extent, d->n);
    if (!e)
        fill_look_for_sky(&c.fill, c.answer);
    for (int i = 0; i < d->n && !e; i++)
        taken += fill_take(&c.fill, i, c.answer + FILL_ANSWER * d->extent[i].at, d);
    *share = (float)taken / (float)extent_total(d->extent, d->n);
    arena_reset(r->tmp, mark);
    return e;
}

void completion_plan(struct plan *p, const struct net *net, const struct extent *maps, int n)
{
    const size_t mark = arena_mark(&p->tmp);
    struct completion c;
    if (layout(&c, &p->tmp, maps, n))
        plan_refuse(p);
    for (int i = 0; i < n; i++)
        complete_plan(p, net, &(struct complete_in){maps[i].h, maps[i].w, NULL});
    arena_reset(&p->tmp, mark);
}
