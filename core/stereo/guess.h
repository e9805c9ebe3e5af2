/* guess.h - the inverse depth of every pixel of a depth map, where it is sure and where it is not.
 * Pure computation; thread: any, a workspace belongs to one at a time. */
#ifndef STEREO_GUESS_H
#define STEREO_GUESS_H

#include "core/stereo/sweep.h"

struct guess_work {
    float *levels; // (2, 4/3 h w + ...) inverse depth times weight, weight: pyramid of one view
    uint32_t
        *sum; // (blocks down + 1, across + 1, bins) sure pixels above, to the left, up to a bin
};

/* Memory for any of n maps.
 * err:  ERR_NOMEM. */
MUST_USE err_t guess_layout(struct guess_work *g, struct arena *a, const struct extent *maps,
                            int n);

/* Inverse depth of a view: kept where it is confident, else filled from larger and larger
 * surroundings, as if nothing were infinitely far. out: (h, w) of the map. */
void guess_smooth(const struct guess_work *g, const struct depthmaps *d, int view, float *rho);

/* After guess_smooth: what is infinitely far is on the shell. */
void guess_shell(const struct depthmaps *d, int view, float *rho);

/* After guess_shell: limit inverse depth to that of the farthest surfaces around each pixel, even
 * where it is usable: other views see through the pixels that are left over there. */
void guess_limit(const struct guess_work *g, const struct depthmaps *d, int view, float *rho);

#endif
