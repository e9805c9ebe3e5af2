/* sweep.h - one depth map per view from photographs at different exposures with known cameras.
 * Plane sweep over inverse depth with a matching cost that does not see the exposure,
 * semi-global smoothing, and a check between the views. The depth range follows from the cameras
 * alone.
 * Pure computation; thread: any. Invariant: the result does not depend on the number of threads. */
#ifndef STEREO_SWEEP_H
#define STEREO_SWEEP_H

#include "core/base/plan.h"
#include "core/base/types.h"

/* Depth at 1/scale of the size of the views; every pixel has one, and `conf` says its worth. */
struct depthmaps {
    int n, size;  // views; px
    int scale;    // pixels of the view per pixel of the map and axis
    float *depth; // (n, size, size) z in the camera, scene units, > 0, finite
    float *conf;  // (n, size, size) 0 = smooth guess .. 1 = several views agree
};

/* Depth of every view.
 * out:  maps live in r->keep. A single view, cameras in one place or without overlap give smooth
 *       guesses with conf 0.
 * err:  ERR_ARG (no cameras, numbers that are not finite, focal length <= 0), ERR_NOMEM (see
 *       sweep_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t sweep_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                         struct depthmaps *out);

/* Count what sweep_run takes; of v only its numbers are looked at.
 * out:  the numbers of the maps. */
void sweep_plan(struct plan *p, const struct views *v, struct depthmaps *out);

#endif
