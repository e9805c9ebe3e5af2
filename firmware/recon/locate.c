#include "firmware/recon/locate.h"

#include "core/base/num.h"

void locate_plan(int n_views, int size, int threads, size_t *keep, size_t *tmp)
{
    *keep = arena_add(match_keep(n_views, size), bundle_keep(n_views, MATCH_SEEN_MAX / 2));
    *tmp = num_max_size(match_plan(n_views, size, threads), bundle_plan(n_views, MATCH_SEEN_MAX));
}

err_t locate_run(const struct run *r, const struct views *v, const struct correspondence *prior,
                 const struct bundle_config *cfg, struct bundle_result *out)
{
    struct bundle_config own = *cfg;
    struct match_tracks tracks;
    own.aspect = v->aspect;
    if (r->progress)
        r->progress(r->progress_ctx, "cameras", 0, 2, NULL);
    err_t e = match_run(r, v, prior, &tracks);
    if (!e && r->progress)
        r->progress(r->progress_ctx, "cameras", 1, 2, NULL);
    return e ? e : bundle_run(r, v->n, v->size, &tracks, &own, out);
}
