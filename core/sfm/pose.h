/* pose.h - small rigid motions of cameras: the 6 degrees of freedom that optimisers move.
 * A twist (w, v) acts on the left of world-to-camera: X_cam' = exp(w) X_cam + v.
 * Pure functions; any thread. */
#ifndef SFM_POSE_H
#define SFM_POSE_H

#include "core/base/types.h"
#include "core/kernels/kernels.h"

/* Gradient by the twist at zero, from the gradient by R and t (first 12 of POSE_GRAD).
 * out: rotation (3, radians), translation (3, scene units). */
void pose_twist_grad(const struct camera *c, const float grad[POSE_GRAD], float out[6]);

/* c <- twist applied to c; the quaternion stays unit. A twist that is not finite does nothing. */
void pose_move(struct camera *c, const float twist[6]);

/* Mean distance from the cameras to the middle of the splats inside the shell (core/base/shell.h),
 * the median of each coordinate, scene units: the unit of steps of positions. Few far ones do not
 * count, for near ones would not settle. 1 if it is 0 or not finite. */
float pose_extent(const struct gaussians *g, const struct camera *cams, int n);

/* Same view at another picture size. */
struct camera pose_scaled(const struct camera *c, int w, int h);

#endif
