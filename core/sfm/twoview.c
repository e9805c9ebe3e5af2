/* Essential matrices of five matches (Nister, "An efficient solution to the five-point relative
 * pose problem", 2004): E = xX + yY + zZ + W in the null space of the epipolar equations; ten cubic
 * constraints, reduced by Gauss-Jordan; three of them leave a 3 x 3 matrix of polynomials in z,
 * whose determinant has degree ten. Its real roots are bracketed by those of its derivatives.
 * Samples are scored by the truncated Sampson distance (MSAC, Torr and Zisserman 2000) of all
 * matches, those behind a view being wrong; each one that may become the best is polished on them
 * (LO-RANSAC, Chum et al. 2003) in rotation and direction. Where a rotation alone fits nearly as
 * many matches in both coordinates, the direction is noise and is left out. */
#include "core/sfm/twoview.h"

#include "core/base/lin.h"
#include "core/base/rotation.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

enum { CUBIC = 20, QUADRIC = 10, SAMPLES_LEAST = 24, SAMPLES_MOST = 300, TRIAL = 2, POLISH = 5 };
static const double PROMISING =
    2; // times the cost of the best pose: up to there another is polished

/* ---- five points ---- */

/* Monomials of degree 2: x2 xy xz x y2 yz y z2 z 1; of degree 3: x3 y3 x2y xy2 x2z x2 y2z y2 xyz xy
 * x(z2 z 1) y(z2 z 1) z3 z2 z 1. Products by x, y, z, 1: */
static const int from_linear[4][4] = {{0, 1, 2, 3}, {1, 4, 5, 6}, {2, 5, 7, 8}, {3, 6, 8, 9}};
static const int from_quadric[QUADRIC][4] = {
    {0, 2, 4, 5},   {2, 3, 8, 9},   {4, 8, 10, 11},   {5, 9, 11, 12},   {3, 1, 6, 7},
    {8, 6, 13, 14}, {9, 7, 14, 15}, {10, 13, 16, 17}, {11, 14, 17, 18}, {12, 15, 18, 19},
};

static void add_quadric(const double a[4], const double b[4], double factor, double out[QUADRIC])
{
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            out[from_linear[i][j]] += factor * a[i] * b[j];
}

static void add_cubic(const double q[QUADRIC], const double a[4], double out[CUBIC])
{
    for (int i = 0; i < QUADRIC; i++)
        for (int j = 0; j < 4; j++)
            out[from_quadric[i][j]] += q[i] * a[j];
}

/* det E = 0 and (E E^T - trace/2) E = 0; e[entry] holds its coefficients of x, y, z, 1. */
static void essential_constraints(const double e[9][4], double a[10][CUBIC])
{
    double eet[6][QUADRIC] = {{0}}, minor[QUADRIC];
    static const int row[6] = {0, 0, 0, 1, 1, 2}, col[6] = {0, 1, 2, 1, 2, 2};
    static const int at[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
    memset(a, 0, 10 * CUBIC * sizeof a[0][0]);
    for (int c = 0; c < 3; c++) {
        memset(minor, 0, sizeof minor);
        add_quadric(e[3 + (c + 1) % 3], e[6 + (c + 2) % 3], 1, minor);
        add_quadric(e[3 + (c + 2) % 3], e[6 + (c + 1) % 3], -1, minor);
        add_cubic(minor, e[c], a[9]);
    }
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < 3; k++)
            add_quadric(e[3 * row[i] + k], e[3 * col[i] + k], 1, eet[i]);
    for (int m = 0; m < QUADRIC; m++) {
        double half = 0.5 * (eet[0][m] + eet[3][m] + eet[5][m]);
        eet[0][m] -= half;
        eet[3][m] -= half;
        eet[5][m] -= half;
    }
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++)
            add_cubic(eet[at[i / 3][k]], e[3 * k + i % 3], a[i]);
}

/* Leave the identity in the first n columns. */
static bool eliminate_cubics(double a[10][CUBIC])
{
    for (int k = 0; k < 10; k++) {
        int best = k;
        for (int i = k + 1; i < 10; i++)
            best = fabs(a[i][k]) > fabs(a[best][k]) ? i : best;
        if (!(fabs(a[best][k]) > 1e-14))
            return false;
        for (int j = 0; j < CUBIC; j++) {
            double v = a[best][j];
            a[best][j] = a[k][j];
            a[k][j] = v;
        }
        for (int j = CUBIC - 1; j >= k; j--)
            a[k][j] /= a[k][k];
        for (int i = 0; i < 10; i++)
            for (int j = CUBIC - 1; i != k && j >= k; j--)
                a[i][j] -= a[i][k] * a[k][j];
    }
    return true;
}

static double evaluate_polynomial(const double *p, int degree, double z)
{
    double v = p[degree];
    for (int i = degree - 1; i >= 0; i--)
        v = v * z + p[i];
    return v;
}

/* The root of p between lo and hi, where it changes sign. */
static double bracketed_root(const double *p, const double *slope, int degree, double lo, double hi)
{
    bool rising = evaluate_polynomial(p, degree, lo) < 0;
    double z = 0.5 * (lo + hi);
    for (int i = 0; i < 80 && hi - lo > 1e-14 * (1 + fabs(z)); i++) {
        double v = evaluate_polynomial(p, degree, z), d = evaluate_polynomial(slope, degree - 1, z);
        if ((v < 0) == rising)
            lo = z;
        else
            hi = z;
        double next = z - v / d;
        if (fabs(next - z) < 1e-15 * (1 + fabs(z)))
            return z;
        z = next > lo && next < hi ? next : 0.5 * (lo + hi);
    }
    return z;
}

/* Real roots in [-limit, limit], ascending: between two roots of the derivative there is at most
 * one. */
static int roots_of(const double p[11], double limit, double roots[10])
{
    double chain[11][11], old[12], now[11] = {0};
    int n = 0;
    memcpy(chain[10], p, sizeof chain[10]);
    for (int d = 10; d > 1; d--)
        for (int i = 0; i < d; i++)
            chain[d - 1][i] = (i + 1) * chain[d][i + 1];
    for (int d = 1; d <= 10; d++) {
        const double constant = chain[d][1];
        int found = 0;
        memcpy(old + 1, now, (size_t)n * sizeof *now);
        old[0] = -limit;
        old[n + 1] = limit;
        for (int i = 0; i <= n; i++) {
            double lo = evaluate_polynomial(chain[d], d, old[i]),
                   hi = evaluate_polynomial(chain[d], d, old[i + 1]);
            if ((lo < 0) == (hi < 0))
                continue;
            const double *slope = d > 1 ? chain[d - 1] : &constant;
            now[found++] = bracketed_root(chain[d], slope, d, old[i], old[i + 1]);
        }
        n = found;
    }
    memcpy(roots, now, (size_t)n * sizeof *now);
    return n;
}

/* Subtract the projections on the first n rows of q from v, twice for precision.
 * returns: the remaining length. */
static double orthogonalise_against(const double q[9][9], int n, double v[9])
{
    double len = 0;
    for (int k = 0; k < 2 * n; k++) {
        double along = 0;
        for (int j = 0; j < 9; j++)
            along += q[k % n][j] * v[j];
        for (int j = 0; j < 9; j++)
            v[j] -= along * q[k % n][j];
    }
    for (int j = 0; j < 9; j++)
        len += v[j] * v[j];
    return sqrt(len);
}

/* Make the five rows of q orthonormal and append four vectors orthogonal to them, made
 * from the axes that are farthest from their span. False if the rows depend on each other. */
static bool null_space(double q[9][9])
{
    for (int i = 0; i < 9; i++) {
        double best = 0, row[9];
        memcpy(row, q[i], sizeof row);
        for (int e = 0; e < (i < 5 ? 1 : 9); e++) {
            double v[9] = {0};
            v[e] = 1;
            if (i < 5)
                memcpy(v, row, sizeof v);
            double len = orthogonalise_against((const double(*)[9])q, i, v);
            for (int j = 0; j < 9 && len > best; j++)
                q[i][j] = v[j] / len;
            best = fmax(best, len);
        }
        if (!(best > 1e-10))
            return false;
    }
    return true;
}

/* Polynomial of degree na + nb, added with a factor. */
static void add_product(const double *a, int na, const double *b, int nb, double factor,
                        double *out)
{
    for (int i = 0; i <= na; i++)
        for (int j = 0; j <= nb; j++)
            out[i + j] += factor * a[i] * b[j];
}

/* Rows of Nister's matrix B: coefficients of x and y (degree 3) and 1 (degree 4), from z^0 on. */
static void reduce_to_z(const double a[10][CUBIC], double b[3][3][5])
{
    for (int i = 0; i < 3; i++) {
        const double *u = a[4 + 2 * i] + 10, *v = a[5 + 2 * i] + 10; // u - z v
        for (int c = 0; c < 3; c++) {
            int degree = c < 2 ? 2 : 3, first = 3 * c;
            memset(b[i][c], 0, sizeof b[i][c]);
            for (int k = 0; k <= degree; k++) {
                b[i][c][k] += u[first + degree - k];
                b[i][c][k + 1] -= v[first + degree - k];
            }
        }
    }
}

static void determinant_polynomial(const double b[3][3][5], double p[11])
{
    memset(p, 0, 11 * sizeof *p);
    for (int i = 0; i < 3; i++) { // along the last column
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        double minor[7] = {0};
        add_product(b[j][0], 3, b[k][1], 3, 1, minor);
        add_product(b[k][0], 3, b[j][1], 3, -1, minor);
        add_product(minor, 6, b[i][2], 4, 1, p);
    }
}

/* x and y at the root z: the vector orthogonal to two rows of B. */
static bool solve_xy(const double b[3][3][5], double z, double *x, double *y)
{
    double row[3][3], best[3] = {0};
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++)
            row[i][c] = evaluate_polynomial(b[i][c], c < 2 ? 3 : 4, z);
    for (int i = 0; i < 3; i++) {
        double n[3];
        lin_cross(row[i], row[(i + 1) % 3], n);
        if (lin_dot(n, n) > lin_dot(best, best))
            memcpy(best, n, sizeof best);
    }
    *x = best[0] / best[2];
    *y = best[1] / best[2];
    return isfinite(*x) && isfinite(*y);
}

int twoview_five(const struct twoview_match *const m[5], double out[TWOVIEW_SOLUTIONS][9])
{
    double q[9][9] = {{0}}, e[9][4], a[10][CUBIC], b[3][3][5], p[11], z[10];
    int n = 0;
    for (int i = 0; i < 5; i++) {
        const double u[3] = {m[i]->a[0], m[i]->a[1], 1}, v[3] = {m[i]->b[0], m[i]->b[1], 1};
        for (int k = 0; k < 9; k++)
            q[i][k] = v[k / 3] * u[k % 3];
    }
    if (!null_space(q))
        return 0;
    for (int k = 0; k < 9; k++)
        for (int j = 0; j < 4; j++)
            e[k][j] = q[5 + j][k];
    essential_constraints((const double(*)[4])e, a);
    if (!eliminate_cubics(a))
        return 0;
    reduce_to_z((const double(*)[CUBIC])a, b);
    determinant_polynomial((const double(*)[3][5])b, p);
    int found = roots_of(p, 1e3, z);
    for (int i = 0; i < found; i++) {
        double x, y;
        if (!solve_xy((const double(*)[3][5])b, z[i], &x, &y))
            continue;
        for (int k = 0; k < 9; k++)
            out[n][k] = x * e[k][0] + y * e[k][1] + z[i] * e[k][2] + e[k][3];
        n++;
    }
    return n;
}

/* ---- scores ---- */

static double epipolar_error(const double e[9], const struct twoview_match *m)
{
    const double x = m->a[0], y = m->a[1], u = m->b[0], v = m->b[1];
    const double l0 = e[0] * x + e[1] * y + e[2], l1 = e[3] * x + e[4] * y + e[5];
    const double l2 = e[6] * x + e[7] * y + e[8];
    const double k0 = e[0] * u + e[3] * v + e[6], k1 = e[1] * u + e[4] * v + e[7];
    const double c = u * l0 + v * l1 + l2, sa = m->sigma_a, sb = m->sigma_b;
    const double var = sb * sb * (l0 * l0 + l1 * l1) + sa * sa * (k0 * k0 + k1 * k1);
    return var > 0 ? c * c / var : 1e30;
}

static double rotation_error(const double r[9], const struct twoview_match *m)
{
    const double x[3] = {m->a[0], m->a[1], 1};
    double y[3];
    lin_apply(r, x, y);
    if (!(y[2] > 1e-6))
        return 1e30;
    const double du = y[0] / y[2] - m->b[0], dv = y[1] / y[2] - m->b[1];
    return (du * du + dv * dv) / (m->sigma_a * m->sigma_a + m->sigma_b * m->sigma_b);
}

static void essential_of_pose(const double r[9], const double t[3], double e[9])
{
    const double x[9] = {0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0};
    lin_product(x, r, e);
}

double twoview_distance(const struct twoview *v, const struct twoview_match *m)
{
    double e[9];
    if (!v->parallax)
        return rotation_error(v->r, m);
    essential_of_pose(v->r, v->t, e);
    return epipolar_error(e, m);
}

struct sample {
    const struct twoview_match *m;
    int n;
    uint32_t state;
    double cost; // of the best model
    double r[9], t[3];
};

/* Truncated cost of E; stops early beyond `most`. */
static double cost_of(const struct sample *s, const double e[9], double most)
{
    const double gate = TWOVIEW_GATE * TWOVIEW_GATE;
    double sum = 0;
    for (int i = 0; i < s->n && sum < most; i++)
        sum += fmin(epipolar_error(e, &s->m[i]), gate);
    return sum;
}

/* Whether the point is in front of both views, by the signs of the depths along both rays. */
static bool in_front(const double r[9], const double t[3], const struct twoview_match *m)
{
    const double x[3] = {m->a[0], m->a[1], 1}, b[3] = {m->b[0], m->b[1], 1};
    double a[3];
    lin_apply(r, x, a);
    const double aa = lin_dot(a, a), bb = lin_dot(b, b), ab = lin_dot(a, b);
    const double at = lin_dot(a, t), bt = lin_dot(b, t); // za a + t = zb b
    return ab * bt - bb * at > 0 && aa * bt - ab * at > 0;
}

/* Whether the point is behind a view, and not only because it is too far away to tell. */
static bool is_behind(const double r[9], const double t[3], const struct twoview_match *m)
{
    return !in_front(r, t, m) && !(rotation_error(r, m) < TWOVIEW_GATE * TWOVIEW_GATE);
}

/* Truncated cost of a pose: E alone also fits points behind the views. */
static double pose_cost(const struct sample *s, const double r[9], const double t[3], double most)
{
    const double gate = TWOVIEW_GATE * TWOVIEW_GATE;
    double e[9], sum = 0;
    essential_of_pose(r, t, e);
    for (int i = 0; i < s->n && sum < most; i++) {
        double d2 = epipolar_error(e, &s->m[i]);
        sum += d2 < gate && !is_behind(r, t, &s->m[i]) ? d2 : gate;
    }
    return sum;
}

/* Rotation and direction of E by the side of most matches (Horn, "Recovering baseline and
 * orientation from essential matrix", 1990). */
static void decompose_essential(const struct sample *s, const double e[9], double r[9], double t[3])
{
    double cof[9], b[9], twist[9], eet[9], q[4], best = -1;
    lin_product_t(e, e, eet);
    for (int i = 0; i < 3; i++)
        lin_cross(e + 3 * ((i + 1) % 3), e + 3 * ((i + 2) % 3), cof + 3 * i);
    double half = 0.5 * (eet[0] + eet[4] + eet[8]), axis[3];
    int k = 0;
    for (int i = 1; i < 3; i++)
        k = eet[4 * i] < eet[4 * k] ? i : k;
    for (int i = 0; i < 3; i++)
        axis[i] = (i == k ? half : 0) - eet[3 * k + i];
    lin_normalise(axis);
    for (int i = 0; i < 3; i++)
        axis[i] *= sqrt(half);
    essential_of_pose((const double[9]){1, 0, 0, 0, 1, 0, 0, 0, 1}, axis, b);
    lin_product(b, e, twist);
    for (int c = 0; c < 4; c++) {
        double turn[9], side = c % 2 ? -1 : 1, sum = 0;
        const double dir[3] = {side * axis[0], side * axis[1], side * axis[2]};
        for (int i = 0; i < 9; i++)
            turn[i] = cof[i] + (c < 2 ? -1 : 1) * twist[i];
        for (int i = 0; i < 9; i++)
            turn[i] /= half;
        rotation_to_quat(turn, q);
        rotation_from_quat(q, turn);
        for (int i = 0; i < s->n; i++)
            sum += in_front(turn, dir, &s->m[i]) &&
                   epipolar_error(e, &s->m[i]) < TWOVIEW_GATE * TWOVIEW_GATE;
        if (sum > best) {
            best = sum;
            memcpy(r, turn, 9 * sizeof *r);
            memcpy(t, dir, 3 * sizeof *t);
            lin_normalise(t);
        }
    }
}

/* ---- polish ---- */

/* Normal equations of the Cauchy-weighted Sampson distances by (rotation, direction). */
static void add_normal(const double r[9], const double t[3], const struct twoview_match *m,
                       const double across[2][3], double h[25], double g[5])
{
    const double x[3] = {m->a[0], m->a[1], 1}, b[3] = {m->b[0], m->b[1], 1};
    double e[9], y[3], bt[3], turn[3], move[3], j[5];
    essential_of_pose(r, t, e);
    lin_apply(r, x, y);
    lin_cross(b, t, bt);
    lin_cross(y, bt, turn);
    lin_cross(y, b, move);
    double c = lin_dot(bt, y), d2 = epipolar_error(e, m);
    if (!(d2 < 1e20) || !(fabs(c) > 0))
        return;
    double inv = sqrt(d2) / fabs(c), w = 1 / (1 + d2);
    for (int k = 0; k < 3; k++)
        j[k] = turn[k] * inv;
    for (int k = 0; k < 2; k++)
        j[3 + k] = lin_dot(move, across[k]) * inv;
    lin_add_equation(h, g, 5, j, w, c * inv);
}

static void polish_step(const struct sample *s, double r[9], double t[3])
{
    double h[25] = {0}, g[5] = {0}, across[2][3], turn[9], old[9];
    lin_tangents(t, across[0], across[1]);
    for (int i = 0; i < s->n; i++)
        add_normal(r, t, &s->m[i], (const double(*)[3])across, h, g);
    for (int k = 0; k < 5; k++)
        h[6 * k] += 1e-6 * h[6 * k] + 1e-12;
    if (!lin_cholesky(h, 5))
        return;
    lin_solve(h, 5, g);
    if (!(lin_dot(g, g) + g[3] * g[3] + g[4] * g[4] < 1))
        return;
    rotation_exp(g, turn);
    memcpy(old, r, sizeof old);
    lin_product(turn, old, r);
    for (int k = 0; k < 3; k++)
        t[k] += g[3] * across[0][k] + g[4] * across[1][k];
    lin_normalise(t);
}

/* Keep E if it or its polished form is the best so far: the noise of five matches may cost more
 * than a polished second solution of a plane. */
static void try_essential(struct sample *s, const double e[9], int steps)
{
    const double half = 0.5 * s->n * TWOVIEW_GATE * TWOVIEW_GATE; // cost of half of them wrong
    const double most = fmax(s->cost, fmin(PROMISING * s->cost, half));
    double r[9], t[3];
    if (!(cost_of(s, e, most) <= most))
        return;
    decompose_essential(s, e, r, t);
    for (int i = 0; i <= steps; i++) {
        double cost = pose_cost(s, r, t, s->cost);
        if (cost < s->cost) {
            s->cost = cost;
            memcpy(s->r, r, sizeof s->r);
            memcpy(s->t, t, sizeof s->t);
        }
        if (i == TRIAL && cost > s->cost)
            return;
        if (i < steps)
            polish_step(s, r, t);
    }
}

/* ---- rotation alone ---- */

/* Rotate r towards the matches: Gauss-Newton on both coordinates, Cauchy weights. */
static void rotate_step(const struct sample *s, double r[9])
{
    double h[9] = {0}, g[3] = {0}, turn[9], old[9];
    for (int i = 0; i < s->n; i++) {
        const struct twoview_match *m = &s->m[i];
        const double x[3] = {m->a[0], m->a[1], 1}, d2 = rotation_error(r, m);
        double y[3];
        if (!(d2 < 1e20))
            continue;
        lin_apply(r, x, y);
        const double u = y[0] / y[2], v = y[1] / y[2];
        const double w = 1 / (m->sigma_a * m->sigma_a + m->sigma_b * m->sigma_b) / (1 + d2 / 4);
        const double j[2][3] = {{-u * v, 1 + u * u, -v}, {-1 - v * v, u * v, u}};
        const double c[2] = {u - m->b[0], v - m->b[1]};
        for (int k = 0; k < 2; k++)
            lin_add_equation(h, g, 3, j[k], w, c[k]);
    }
    if (!lin_cholesky(h, 3))
        return;
    lin_solve(h, 3, g);
    if (!(lin_dot(g, g) < 1))
        return;
    rotation_exp(g, turn);
    memcpy(old, r, sizeof old);
    lin_product(turn, old, r);
}

/* Rotation that takes two rays to two others, by the frames that they span. */
static void from_two(const struct twoview_match *p, const struct twoview_match *q, double r[9])
{
    double frame[2][9];
    for (int side = 0; side < 2; side++) {
        const double *u = side ? p->b : p->a, *v = side ? q->b : q->a;
        const double x[3] = {u[0], u[1], 1}, y[3] = {v[0], v[1], 1};
        double *f = frame[side];
        for (int k = 0; k < 3; k++)
            f[k] = x[k];
        lin_normalise(f);
        lin_cross(x, y, f + 3);
        lin_normalise(f + 3);
        lin_cross(f, f + 3, f + 6);
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r[3 * i + j] = frame[1][i] * frame[0][j] + frame[1][3 + i] * frame[0][3 + j] +
                           frame[1][6 + i] * frame[0][6 + j];
}

static uint32_t draw_index(uint32_t *state, int n)
{
    *state = *state * 1664525u + 1013904223u;
    return (uint32_t)(((uint64_t)(*state >> 8) * (uint32_t)n) >> 24);
}

static int rotated_inliers(const struct sample *s, const double r[9])
{
    int n = 0;
    for (int i = 0; i < s->n; i++)
        n += rotation_error(r, &s->m[i]) < TWOVIEW_GATE * TWOVIEW_GATE;
    return n;
}

/* Best rotation, from random pairs and from the two views' own; returns its inliers. */
static int rotation_alone(struct sample *s, double best[9])
{
    int most = -1;
    for (int k = 0; k < SAMPLES_LEAST; k++) {
        uint32_t i = draw_index(&s->state, s->n), j = draw_index(&s->state, s->n);
        double r[9];
        from_two(&s->m[i], &s->m[j], r);
        if (k == 0)
            memcpy(r, s->r, sizeof r);
        else if (i == j)
            continue;
        for (int step = 0; step < (k == 0 ? 2 * POLISH : 2); step++)
            rotate_step(s, r);
        int n = rotated_inliers(s, r);
        if (n > most) {
            most = n;
            memcpy(best, r, sizeof r);
        }
    }
    return most;
}

/* ---- both ---- */

/* Samples that contain one of five right matches with 99.9 % probability. */
static int samples_needed(const struct sample *s)
{
    const double gate = TWOVIEW_GATE * TWOVIEW_GATE;
    double e[9], share = 0;
    essential_of_pose(s->r, s->t, e);
    for (int i = 0; i < s->n; i++)
        share += epipolar_error(e, &s->m[i]) < gate;
    share = pow(share / s->n, 5);
    double want = share < 0.999 ? log(1e-3) / log(1 - share) : 0;
    return want < SAMPLES_LEAST ? SAMPLES_LEAST : want > SAMPLES_MOST ? SAMPLES_MOST : (int)want;
}

/* Five different matches. */
static void draw_five(struct sample *s, const struct twoview_match *five[5])
{
    for (int i = 0; i < 5; i++) {
        uint32_t at = draw_index(&s->state, s->n);
        for (int j = 0; j < i; j++)
            if (five[j] == &s->m[at]) {
                at = (at + 1) % (uint32_t)s->n;
                j = -1;
            }
        five[i] = &s->m[at];
    }
}

static void sample_run(struct sample *s)
{
    int want = SAMPLES_MOST;
    for (int k = 0; k < want; k++) {
        const struct twoview_match *five[5];
        double e[TWOVIEW_SOLUTIONS][9], before = s->cost;
        draw_five(s, five);
        int n = twoview_five(five, e);
        for (int i = 0; i < n; i++)
            try_essential(s, e[i], POLISH);
        if (s->cost < before)
            want = samples_needed(s);
    }
}

double twoview_polish(const struct twoview_match *m, int n, const double e[9])
{
    struct sample s = {.m = m, .n = n, .cost = n * (double)(TWOVIEW_GATE * TWOVIEW_GATE)};
    try_essential(&s, e, 2 * POLISH);
    return s.cost;
}

void twoview_run(const struct twoview_match *m, int n, uint32_t seed, struct twoview *out)
{
    struct sample s = {.m = m, .n = n, .state = seed, .cost = 1e300};
    double r[9], e[9];
    for (int k = 0; k < 9; k++)
        s.r[k] = k % 4 == 0;
    *out = (struct twoview){.r = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    if (n < TWOVIEW_LEAST)
        return;
    sample_run(&s);
    if (s.cost < 1e300) {
        essential_of_pose(s.r, s.t, e);
        s.cost *= 1 + 1e-9;
        try_essential(&s, e, 4 * POLISH);
        essential_of_pose(s.r, s.t, e); // polish may flip a baseline that is hardly observable
        decompose_essential(&s, e, s.r, s.t);
    }
    memcpy(out->r, s.r, sizeof out->r);
    memcpy(out->t, s.t, sizeof out->t);
    out->parallax = lin_dot(s.t, s.t) > 0;
    for (int i = 0; i < n && out->parallax; i++)
        out->inliers += twoview_distance(out, &m[i]) < TWOVIEW_GATE * TWOVIEW_GATE &&
                        !is_behind(out->r, out->t, &m[i]);
    int alone = rotation_alone(&s, r);
    if (alone >= 0.9 * out->inliers) {
        *out = (struct twoview){.inliers = alone};
        memcpy(out->r, r, sizeof r);
    }
}
