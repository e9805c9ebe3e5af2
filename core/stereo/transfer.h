/* transfer.h - where a pixel of one view at an inverse depth falls in another view.
 * Pure functions; any thread. */
#ifndef STEREO_TRANSFER_H
#define STEREO_TRANSFER_H

#include "core/base/types.h"

struct transfer_pose {
    double r[9], t[3], centre[3];
    double f[2], c[2]; // as a share of the picture's width and height
};

/* Focal lengths above 0 and a rotation above 0. */
void transfer_pose_set(const struct camera *c, struct transfer_pose *p);

/* Rows of h (3, 4): (u, v, 1, rho) of `a` -> homogeneous pixel of `b`; size: width and height of
 * the picture of a, then of b. */
void transfer_map(const struct transfer_pose *a, const struct transfer_pose *b,
                  const double size[4], double *h);

/* Map a pixel at rho into the other picture; false if it is behind that camera. out[2]: depth there
 * times rho here. */
bool transfer_apply(const double *h, double u, double v, double rho, double *out);

/* Between the centres, scene units. */
double transfer_distance(const struct transfer_pose *a, const struct transfer_pose *b);

#endif
