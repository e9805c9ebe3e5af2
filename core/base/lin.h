/* lin.h - small dense algebra in double for the geometry of cameras: 3-vectors, 3 x 3 matrices
 * (row-major), symmetric systems.
 * Pure functions; any thread. */
#ifndef BASE_LIN_H
#define BASE_LIN_H

#include <stdbool.h>

static inline double lin_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void lin_cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out = r x, and r^T x; out is not x. */
static inline void lin_apply(const double r[9], const double x[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2];
}

static inline void lin_apply_t(const double r[9], const double x[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = r[i] * x[0] + r[3 + i] * x[1] + r[6 + i] * x[2];
}

/* Scale x to unit length unless it is 0 or not finite. returns: its length before. */
double lin_normalise(double x[3]);

/* Two unit vectors orthogonal to the unit vector t and to each other. */
void lin_tangents(const double t[3], double b1[3], double b2[3]);

/* out = a b, and a b^T; out is neither. */
void lin_product(const double a[9], const double b[9], double out[9]);
void lin_product_t(const double a[9], const double b[9], double out[9]);

/* One equation row x + error = 0 of weight w: lower triangle of h (n x n) += w row row^T and
 * g -= w error row. */
void lin_add_equation(double *h, double *g, int n, const double *row, double w, double error);

/* Lower Cholesky factor in place of the n x n matrix whose lower triangle is a (rows of n). False,
 * and a is spoilt, if a is not positive definite. */
bool lin_cholesky(double *a, int n);

/* x <- a^-1 x with the factor of lin_cholesky. */
void lin_solve(const double *factor, int n, double *x);

/* Inverse of the symmetric 3 x 3 matrix a (all nine entries). False if it has none. */
bool lin_inverse3(const double a[9], double out[9]);

#endif
