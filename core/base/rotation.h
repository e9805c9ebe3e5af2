/* rotation.h - rotations as quaternions w,x,y,z, as row-major 3 x 3 matrices and as vectors (axis
 * times radians).
 * Pure functions; any thread. */
#ifndef BASE_ROTATION_H
#define BASE_ROTATION_H

#include "core/base/types.h"

/* Matrix of a quaternion of any length; 0 is the identity. */
void rotation_from_quat(const double q[4], double r[9]);

/* The same of a unit quaternion, in float, for drawing cameras and Gaussians. */
void rotation_from_unit(const float q[4], float r[9]);

/* Unit quaternion with w >= 0 of a matrix near a rotation. */
void rotation_to_quat(const double r[9], double q[4]);

/* Whether rows have length 1 and right angles within `error`, and are right-handed. */
bool rotation_is(const double r[9], double error);

/* Matrix of a vector, and back: an angle of 0..pi. */
void rotation_exp(const double w[3], double r[9]);
void rotation_log(const double r[9], double w[3]);

/* The quaternion a b: first b, then a. out is neither. */
void rotation_multiply(const double a[4], const double b[4], double out[4]);

/* World to camera, of a camera; and where it stands. */
void rotation_of_camera(const struct camera *cam, double r[9]);
void rotation_centre(const struct camera *cam, double out[3]);

/* Angle between the orientations of two cameras, 0..pi. */
double rotation_between(const struct camera *a, const struct camera *b);

#endif
