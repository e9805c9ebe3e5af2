/* exposure_even.h - photographs of one place that are brighter or darker than their exposures say:
 * lamps that flicker, apertures and gains that are not exact. Pixels that two of them show well
 * tell how far they are apart.
 * Gauge: the mean over the photographs of a place is 0; unless the response is known, so is that
 * over all photographs of one exposure, for a curve of another shape looks the same.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef PHOTO_EXPOSURE_EVEN_H
#define PHOTO_EXPOSURE_EVEN_H

#include "core/base/plan.h"
#include "core/base/types.h"

#define EXPOSURE_EVEN_LEAST 0.03 // stops, root mean square over the photographs; less is 0

/* Under the response `tone`; v->log2t: exposures as they were set.
 * stops: (n + n_more), by which each is brighter; all 0 if no place has several
 * err:   ERR_NOMEM (see exposure_even_plan), ERR_CANCELLED. */
MUST_USE err_t exposure_even_run(const struct run *r, const struct views *v,
                                 const struct tonemap *tone, float *stops);

/* Count what it takes; of v only its numbers are looked at. */
void exposure_even_plan(struct plan *p, const struct views *v);

#endif
