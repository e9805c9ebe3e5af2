/* splats.h - what files of Gaussian splats have in common.
 * thread: any. */
#ifndef DRIVERS_SPLATS_H
#define DRIVERS_SPLATS_H

#include "core/splat/gaussians.h"

/* Refuse what no file can hold; `path` begins the sentence.
 * err:  ERR_ARG (a value is not finite or a quaternion has no length: splat and plane named). */
MUST_USE err_t splats_check(const char *path, const struct gaussians *g);

/* Axes that point the other way than those of struct camera (right, down, forward). */
enum { SPLATS_RUB = 2 | 4, SPLATS_LUF = 1 | 2 }; // bits x, y, z: right, up, back; left, up, forward

/* -1 or 1: what a plane of struct gaussians is multiplied with to change these axes, either way. */
int splats_sign(int plane, unsigned axes);

/* Display harmonics in the planes of SH, degree 0 to 3, become those of radiance, at `ev`. */
void splats_to_radiance(struct gaussians *g, float ev);

#endif
