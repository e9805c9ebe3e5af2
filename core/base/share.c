#include "core/base/share.h"

struct part {
    pool_fn *fn;
    void *ctx;
    int first;
};

static err_t run_chunk(void *ctx, int chunk, int worker)
{
    const struct part *p = ctx;
    return p->fn(p->ctx, p->first + chunk, worker);
}

err_t share_for(const struct run *r, int n_chunks, pool_fn *fn, void *ctx)
{
    struct part part = {fn, ctx, team_first(r->team, n_chunks, team_rank(r->team))};
    return pool_for(r->pool, team_own(r->team, n_chunks), run_chunk, &part);
}

err_t share_gather(const struct run *r, void *data, size_t elem, const struct extent *px, int n)
{
    size_t at[TEAM_MAX + 1];
    if (!r->team)
        return OK;
    for (int i = 0; i <= r->team->size; i++) {
        const int view = team_first(r->team, n, i);
        at[i] = elem * (view < n ? px[view].at : extent_total(px, n));
    }
    return team_spread(r->team, data, at);
}
