/* response_refit.h - the response curve once depth is known: what one surface shows in two
 * photographs at different exposures says what response_run could only guess from histograms of
 * different places. Pure computation, single thread. thread: any. */
#ifndef REFINE_RESPONSE_REFIT_H
#define REFINE_RESPONSE_REFIT_H

#include "core/base/types.h"
#include "core/stereo/sweep.h"

/* Curve from the surfaces that `depth` is sure of.
 * v:    with cameras. Without further exposures of a place: these would have told the curve.
 * io:   the curve so far; stays where the views have too little in common, or one exposure.
 * err:  ERR_NOMEM (see response_refit_plan), ERR_CANCELLED. On error *io is not changed. */
MUST_USE err_t response_refit_run(const struct run *r, const struct views *v,
                                  const struct depthmaps *depth, struct tonemap *io);

/* Bytes of r->tmp. */
size_t response_refit_plan(int n_views);

#endif
