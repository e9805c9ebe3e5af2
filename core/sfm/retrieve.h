/* retrieve.h - which of many views look alike: a descriptor of each whole view from those of its
 * corners, compared all with all, which is 10000 times cheaper than comparing corners.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_RETRIEVE_H
#define SFM_RETRIEVE_H

#include "core/base/plan.h"
#include "core/sfm/pair.h"

/* The `most` views that look most like each, the most alike first; all are prepared.
 * out:  near (n, most), most < n
 * err:  ERR_NOMEM (r->tmp, see retrieve_plan), ERR_CANCELLED. */
MUST_USE err_t retrieve_run(const struct run *r, const struct pair_views *m, int most, int *near);

/* Count what it takes; of m only n and cap are read. */
void retrieve_plan(struct plan *p, const struct pair_views *m);

#endif
