/* rotation.h - rotations as unit quaternions and as row-major 3 x 3 matrices.
 * Pure functions; any thread. */
#ifndef BASE_ROTATION_H
#define BASE_ROTATION_H

/* Matrix of a unit quaternion w,x,y,z. */
void rotation_from_quat(const float q[4], float r[9]);

/* Unit quaternion of a matrix, in the order x,y,z,w (Shepperd 1978: from its largest component). */
void rotation_to_xyzw(const float r[9], float q[4]);

#endif
