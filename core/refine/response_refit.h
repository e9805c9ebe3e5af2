/* response_refit.h - the response curve once depth is known: one surface in two photographs at
 * different exposures determines what response_run could only guess from histograms of different
 * places. Pure computation, single thread. thread: any. */
#ifndef REFINE_RESPONSE_REFIT_H
#define REFINE_RESPONSE_REFIT_H

#include "core/base/types.h"
#include "core/stereo/sweep.h"

/* Curve from the surfaces that `depth` confirms.
 * v:    with cameras, without further exposures of a place (these determine the curve directly).
 * io:   the curve so far; unchanged if the views share too little, or have one exposure.
 * err:  ERR_NOMEM (see response_refit_plan), ERR_CANCELLED. On error *io is not changed. */
MUST_USE err_t response_refit_run(const struct run *r, const struct views *v,
                                  const struct depthmaps *depth, struct tonemap *io);

/* Bytes of r->tmp. */
size_t response_refit_plan(int n_views);

#endif
