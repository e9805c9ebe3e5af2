/* pose_error.h - how far estimated cameras are from true ones, after the similarity between their
 * worlds that fits best.
 * Pure computation; thread: any. */
#ifndef SFM_POSE_ERROR_H
#define SFM_POSE_ERROR_H

#include "core/base/types.h"

struct pose_error {
    int n;          // cameras, 0: nothing is known
    double rot_deg; // median angle between the cameras, degrees
    double trans;   // median distance of the centres over the spread of the true ones
    double focal;   // median of |f / f_true - 1|
};

/* Compare found[i] with real[i], n >= 1 cameras of pictures of one size.
 * err:  ERR_NOMEM (r->tmp, see pose_error_plan). */
MUST_USE err_t pose_error_measure(const struct run *r, const struct camera *found,
                                  const struct camera *real, int n, struct pose_error *out);

/* Bytes that pose_error_measure takes from r->tmp. */
size_t pose_error_plan(int n);

#endif
