/* rotate.h - spherical harmonics and raw Gaussians under a rotation of the world.
 * Pure computation; thread: any, the pool inside struct run does the work.
 * Invariant: the result does not depend on the number of threads. */
#ifndef SPLAT_ROTATE_H
#define SPLAT_ROTATE_H

#include "core/base/types.h"

/* Spherical harmonics under rotation r: the function with coefficients out_i = sum_j m_ij c_j has
 * at direction r d the value that c has at d. Bands do not mix. */
void rotate_bands(const float r[9], float m[SH_COEFS_MAX][SH_COEFS_MAX]);

/* Rotate raw Gaussians [first, first + count) of features as voxel_merge takes them, (87, n):
 * quaternions and harmonics.
 * err:  ERR_CANCELLED. */
MUST_USE err_t rotate_features(const struct run *r, const float rotation[9], float *features,
                               size_t n, const int range[2]);

#endif
