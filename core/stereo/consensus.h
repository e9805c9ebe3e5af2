/* consensus.h - one depth per pixel from the depths of all views. */
#ifndef STEREO_CONSENSUS_H
#define STEREO_CONSENSUS_H

#include "core/stereo/visibility.h"

/* Where the depth of a view is not confirmed, it becomes the median of its own guess and of the
 * nearest point of each other view at that pixel. If some of these are confirmed, only they count.
 * Guesses of one surface by several views then coincide instead of showing it several times (median
 * fusion of depth maps as in Merrell et al., Real-time visibility-based fusion of depth maps, ICCV
 * 2007, without its rays). s:      n views of size x size px.
 * depth:  (n, size, size) in and out, units of the maps; guesses in. Out: confirmed depths
 *         are those of the maps. A guess that is not finite and > 0 is ignored and stays.
 * err:    ERR_NOMEM (r->tmp, see consensus_plan), ERR_CANCELLED.
 * thread: runs r->pool. The result does not depend on their number. */
MUST_USE err_t consensus_run(const struct run *r, const struct visibility *s, float *depth);
size_t consensus_plan(int n_views, int size, int threads);

#endif
