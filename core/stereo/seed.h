/* seed.h - first Gaussians from depth maps: few where the pictures are flat, many at edges, each
 * surface once. Pure computation, single thread, so the result depends only on the input. thread:
 * any. */
#ifndef STEREO_SEED_H
#define STEREO_SEED_H

#include "core/base/types.h"
#include "core/stereo/sweep.h"

struct seed_input {
    const struct views *views;     // with cameras
    const struct depthmaps *depth; // from sweep_run for these views
    const struct tonemap *tone;    // response of the pictures
};

/* Place Gaussians on the surfaces that the depth maps show: flat along the surface, as wide as
 * the pixels they represent, with the mean radiance of all views that see them. Pixels without a
 * usable depth get weak ones behind them.
 * max:  1 or more. Detail is given up until at most this many are needed.
 * out:  degree 0, out->n <= max, memory in r->keep.
 * err:  ERR_ARG, ERR_NOMEM (see seed_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t seed_run(const struct run *r, const struct seed_input *in, int max,
                        struct gaussians *out);

/* Count the memory of seed_run. maps: (n) shapes of the depth maps.
 * out:  capacity of the splats. */
void seed_plan(struct plan *p, const struct extent *maps, int n, int max, struct gaussians *out);

#endif
