/* boardpose.h - pose of a flat board in a camera of known lens, from its corners: a homography,
 * then least squares, from both of the poses that look much alike when a board is small or far.
 * Pure functions; any thread. */
#ifndef SFM_BOARDPOSE_H
#define SFM_BOARDPOSE_H

#include "core/sfm/boardfit.h"

/* corner: (n) of one camera and take; their numbers are not looked at
 * out:  X_cam = R X_board + t, and its mean squared error, px^2; INFINITY if there is no pose
 * err:  ERR_NOMEM (see boardpose_plan). */
MUST_USE err_t boardpose_find(struct arena *tmp, const struct lens *l,
                              const struct boardfit_corner *corner, int n,
                              double pose[BOARDFIT_POSE], double *error);

/* Bytes for n corners at most. */
size_t boardpose_plan(int n);

#endif
