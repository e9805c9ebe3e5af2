/* epipolar.h - which matches of two views fit one rigid scene for any cameras: the fundamental
 * matrix by random samples of seven (Hartley & Zisserman, "Multiple view geometry",
 * 2004, 11.1.2).
 * Pure functions, random draws from a fixed seed; any thread. */
#ifndef SFM_EPIPOLAR_H
#define SFM_EPIPOLAR_H

#include <stdint.h>

enum { EPIPOLAR_LEAST = 8 };

/* A point in both views, px from the middle of the view. */
struct epipolar_match {
    float a[2], b[2];
};

/* Matrix f (row-major, b^T f a = 0) that most of n matches agree with; better matches first help.
 * size: px, of the views; bound: px, Sampson distance of a match that agrees.
 * Returns the number of matches that agree; 0 and f zeroed below EPIPOLAR_LEAST matches. */
int epipolar_run(const struct epipolar_match *m, int n, float size, float bound, double f[9]);

/* Squared Sampson distance, px. */
double epipolar_distance(const double f[9], const struct epipolar_match *m);

#endif
