/* epipolar.h - which matches of two views fit one rigid scene for any cameras: the fundamental
 * matrix by random samples of seven (Hartley & Zisserman, "Multiple view geometry",
 * 2004, 11.1.2).
 * Pure functions, random draws from a fixed seed; any thread. */
#ifndef SFM_EPIPOLAR_H
#define SFM_EPIPOLAR_H

#include <stdint.h>

enum { EPIPOLAR_LEAST = 8, EPIPOLAR_DRAWS = 1500 };

/* A point in both views, px from the middle of the view. */
struct epipolar_match {
    float a[2], b[2];
};

struct epipolar_search {
    float size;  // px, of the views
    float bound; // px, Sampson distance of a match that agrees
    int draws;   // samples at most
};

/* How strongly the lenses of views a and b distort, px^-2: a pinhole sees the point x, y at
 * x / (1 + bend r^2), y / (1 + bend r^2) (division model: Fitzgibbon, "Simultaneous linear
 * estimation of multiple view geometry and lens distortion", 2001). Below 0: barrel. */
struct epipolar_bend {
    double a, b;
};

/* Matrix f (row-major) that most of n matches agree with: b^T f a = 0 for (x, y, 1 + bend r^2);
 * better matches first help.
 * Returns the number of matches that agree; 0 and f zeroed below EPIPOLAR_LEAST matches. */
int epipolar_run(const struct epipolar_search *how, struct epipolar_bend bend,
                 const struct epipolar_match *m, int n, double f[9]);

/* Make f fit the matches that agree with it better, as long as that is possible; returns the number
 * that agree. */
int epipolar_polish(const struct epipolar_search *how, struct epipolar_bend bend,
                    const struct epipolar_match *m, int n, double f[9]);

/* Sum of 1 - (distance / bound)^2 over the matches that agree with f; agree: their number. */
double epipolar_score(const double f[9], struct epipolar_bend bend, const struct epipolar_match *m,
                      int n, float bound, int *agree);

/* Squared Sampson distance, px of the views as they are. */
double epipolar_distance(const double f[9], struct epipolar_bend bend,
                         const struct epipolar_match *m);

#endif
