/* sweep.h - one depth map per view from photographs at different exposures with known cameras.
 * Plane sweep over inverse depth with a matching cost that is invariant to exposure,
 * semi-global smoothing, and a consistency check between views. The depth range follows from the
 * cameras alone.
 * Pure computation; thread: any. Invariant: the result does not depend on the number of threads. */
#ifndef STEREO_SWEEP_H
#define STEREO_SWEEP_H

#include "core/base/plan.h"
#include "core/base/types.h"

/* Bounds of `conf`: a depth is usable; several views confirm it. */
#define SWEEP_CONF_USABLE 0.3f
#define SWEEP_CONF_CONFIRMED 0.6f
enum { SWEEP_SIZE_MIN = 16 }; // px, least edge of a view

#define SWEEP_SAME_SURFACE 0.02f // relative difference of depths on one surface

/* Depth at 1/scale of the size of the views, rounded down. Every pixel has a depth and its
 * confidence. */
struct depthmaps {
    int n;                 // views
    int scale;             // pixels of the view per pixel of the map and axis
    struct extent *extent; // (n) of the maps
    float *depth;          // (n) maps (h, w): z in the camera, scene units, > 0, finite
    float *conf;           // (n) maps (h, w), 0: smooth guess .. 1: several views agree
    uint8_t *far;          // (n) maps (h, w): FAR_SKY, FAR_BLACK: sees what is infinitely far
                           // (core/stereo/far.h), 0: does not; NULL: not known
};

/* What a pixel of the maps sees of what is infinitely far, 0: nothing. */
static inline uint8_t sweep_far(const struct depthmaps *d, size_t at)
{
    return d->far ? d->far[at] : 0;
}

/* Whether the mask hides some of pixel i of the view's map. */
static inline bool sweep_hides(const struct depthmaps *d, const struct views *v, int view, int i)
{
    const int w = d->extent[view].w;
    return views_hides_any(v, view, i % w * d->scale, i / w * d->scale, d->scale);
}

/* Depth of every view.
 * out:  maps live in r->keep. A single view, cameras in one place or without overlap give smooth
 *       guesses with conf 0.
 * err:  ERR_ARG (no cameras, numbers that are not finite, focal length <= 0), ERR_NOMEM (see
 *       sweep_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t sweep_run(const struct run *r, const struct views *v, const struct tonemap *tone,
                         struct depthmaps *out);

/* Shapes of the maps of these views, of which n, size and extent are read. out: (n).
 * returns: their scale. */
int sweep_extents(const struct views *v, struct extent *out);

/* Count the memory of sweep_run; of v only n, size and extent are read.
 * maps: (n) shapes of the maps, of sweep_extents. */
void sweep_plan(struct plan *p, const struct views *v, const struct extent *maps);

#endif
