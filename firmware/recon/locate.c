#include "firmware/recon/locate.h"

void locate_plan(struct plan *p, const struct views *v, int n_lenses)
{
    struct match_tracks tracks;
    match_plan(p, v, &tracks);
    bundle_plan(p, v->n, n_lenses, &tracks);
}

err_t locate_run(const struct run *r, const struct views *v, const struct correspondence *prior,
                 const struct bundle_config *cfg, struct bundle_result *out)
{
    struct match_tracks tracks;
    if (r->progress)
        r->progress(r->progress_ctx, "cameras", 0, 2, NULL);
    err_t e = match_run(r, v, prior, &tracks);
    if (!e && r->progress)
        r->progress(r->progress_ctx, "cameras", 1, 2, NULL);
    return e ? e : bundle_run(r, v, &tracks, cfg, out);
}
