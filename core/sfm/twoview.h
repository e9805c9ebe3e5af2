/* twoview.h - relative pose of two pinhole views of one static scene from matches, many of which
 * may be wrong.
 * Pure functions, random draws from a fixed seed; any thread. */
#ifndef SFM_TWOVIEW_H
#define SFM_TWOVIEW_H

#include <stdbool.h>
#include <stdint.h>

/* One point in both views: x/z and y/z of its ray, and the expected errors in the same unit. */
struct twoview_match {
    double a[2], b[2];
    double sigma_a, sigma_b; // > 0
};

struct twoview {
    double r[9], t[3]; // X_b = r X_a + t, |t| = 1 or 0
    int inliers;       // matches that fit, in front of both views
    bool parallax;     // false: a rotation alone explains the matches (t = 0)
};

enum { TWOVIEW_GATE = 3, TWOVIEW_SOLUTIONS = 10, TWOVIEW_LEAST = 8 };

/* Relative pose of n matches: random samples of five, the best ones polished, against a rotation
 * alone. Fewer than TWOVIEW_LEAST matches have no answer: 0 inliers and no rotation. */
void twoview_run(const struct twoview_match *m, int n, uint32_t seed, struct twoview *out);

/* The pose that an essential matrix (below) of about that pose means, polished.
 * returns: sum over the matches of their squared distances, each at most TWOVIEW_GATE^2. */
double twoview_polish(const struct twoview_match *m, int n, const double e[9]);

/* Squared distance of a match from the model, in units of its expected error: from the epipolar
 * line (Sampson) or, without parallax, from the rotated point. */
double twoview_distance(const struct twoview *v, const struct twoview_match *m);

/* All essential matrices (row-major, b^T E a = 0) of five matches; returns their number. */
int twoview_five(const struct twoview_match *const m[5], double e[TWOVIEW_SOLUTIONS][9]);

#endif
