/* consensus.h - one depth from what every view says about it. */
#ifndef STEREO_CONSENSUS_H
#define STEREO_CONSENSUS_H

#include "core/stereo/visibility.h"

/* Where a view is not sure of its depth, its own guess and what the other views have at that pixel
 * (their points, the nearest of each view) are votes, and the median wins; votes of sure pixels
 * are the only ones where there are any. Guesses of one surface by several views then lie on one
 * another instead of showing it several times (median fusion of depth maps as in Merrell et al.,
 * Real-time visibility-based fusion of depth maps, ICCV 2007, without its rays).
 * s:      of n views of size x size px.
 * depth:  (n, size, size) in and out, units of the maps; guesses in. Out: where the view is sure,
 *         the depth of the maps. A guess that is not finite and > 0 is no vote and stays.
 * err:    ERR_NOMEM (r->tmp, see consensus_plan), ERR_CANCELLED.
 * thread: runs r->pool. The result does not depend on their number. */
MUST_USE err_t consensus_run(const struct run *r, const struct visibility *s, float *depth);
size_t consensus_plan(int n_views, int size, int threads);

#endif
