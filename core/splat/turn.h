/* turn.h - takes the network's Gaussians from its own world, which lies near the first camera at an
 * arbitrary scale, to the world of cameras that are known.
 * Pure computation; thread: any, the pool inside struct run does the work.
 * Invariant: the result does not depend on the number of threads. */
#ifndef SPLAT_TURN_H
#define SPLAT_TURN_H

#include "core/types.h"

/* How many times larger the world of `to` is than that of `from`: median over pairs of views of the
 * ratio of the distances between their cameras. 1 if the cameras of one of them stand in one place.
 * err:  ERR_NOMEM (r->tmp, see turn_plan). */
MUST_USE err_t turn_scale(const struct run *r, const struct camera *from, const struct camera *to,
                          int n_views, float *out);

/* Bytes that turn_scale takes from r->tmp. */
size_t turn_plan(int n_views);

/* Rotation, row-major, that takes directions of the world of `from` to that of `to`, where both are
 * the same camera. */
void turn_rotation(const struct camera *from, const struct camera *to, float out[9]);

/* A similarity between two worlds: x_to = scale R(q) x_from + t. */
struct turn_world {
    double scale, q[4], t[3]; // q: w,x,y,z, unit
};

/* The similarity that takes the cameras `from` to the cameras `to` of the same n_views >= 1
 * pictures: scale of turn_scale, mean rotation, then mean translation of the centres.
 * err:  ERR_NOMEM (r->tmp, see turn_plan). */
MUST_USE err_t turn_fit(const struct run *r, const struct camera *from, const struct camera *to,
                        int n_views, struct turn_world *out);

/* The same camera in the other world. */
struct camera turn_camera(const struct turn_world *w, const struct camera *cam);

/* Where a camera stands. */
void turn_centre(const struct camera *cam, double out[3]);

/* Spherical harmonics under rotation r: the function with coefficients out_i = sum_j m_ij c_j has
 * at direction r d the value that c has at d. Bands do not mix. */
void turn_bands(const float r[9], float m[SH_COEFS_MAX][SH_COEFS_MAX]);

/* Turn raw Gaussians [first, first + count) of features as voxel_merge takes them, (87, n):
 * quaternions and harmonics.
 * err:  ERR_CANCELLED. */
MUST_USE err_t turn_features(const struct run *r, const float rotation[9], float *features,
                             size_t n, const int range[2]);

#endif
