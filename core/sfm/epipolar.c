/* Samples of seven matches leave a line of matrices, on which a cubic finds up to three of rank 2.
 * Samples are drawn from the best matches first and then from ever more (Chum & Matas, "Matching
 * with PROSAC", 2005). The score is truncated (MSAC), and the best matrix is polished by least
 * squares on the matches that agree with it, weighted so that Sampson's distance is minimised.
 * The polished matrix need not have rank 2: only distances are needed. */
#include "core/sfm/epipolar.h"

#include "core/base/lin.h"
#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { SAMPLE = 7, POLISH = 3 };

/* The third coordinate of a point. */
static double lifted(const float x[2], double bend)
{
    return 1 + bend * (double)(x[0] * x[0] + x[1] * x[1]);
}

double epipolar_distance(const double f[9], struct epipolar_bend bend,
                         const struct epipolar_match *m)
{
    const double x = m->a[0], y = m->a[1], u = m->b[0], v = m->b[1];
    const double w = lifted(m->a, bend.a), z = lifted(m->b, bend.b);
    const double l0 = f[0] * x + f[1] * y + f[2] * w, l1 = f[3] * x + f[4] * y + f[5] * w;
    const double l2 = f[6] * x + f[7] * y + f[8] * w, r2 = f[2] * u + f[5] * v + f[8] * z;
    const double r0 = f[0] * u + f[3] * v + f[6] * z, r1 = f[1] * u + f[4] * v + f[7] * z;
    const double bu = l0 + 2 * bend.b * u * l2, bv = l1 + 2 * bend.b * v * l2;
    const double ax = r0 + 2 * bend.a * x * r2, ay = r1 + 2 * bend.a * y * r2;
    const double e = u * l0 + v * l1 + z * l2;
    return e * e / (bu * bu + bv * bv + ax * ax + ay * ay + 1e-300);
}

static void match_equation(const struct epipolar_match *m, struct epipolar_bend bend, double scale,
                           double row[9])
{
    const double x = m->a[0] * scale, y = m->a[1] * scale, w = lifted(m->a, bend.a);
    const double u = m->b[0] * scale, v = m->b[1] * scale, z = lifted(m->b, bend.b);
    const double r[9] = {u * x, u * y, u * w, v * x, v * y, v * w, z * x, z * y, z * w};
    memcpy(row, r, sizeof r);
}

/* From coordinates times `scale` to px. */
static void rescale_matrix(double f[9], double scale)
{
    for (int i = 0; i < 9; i++)
        f[i] *= (i / 3 < 2 ? scale : 1) * (i % 3 < 2 ? scale : 1);
}

/* ---- seven matches ---- */

static void swap_columns(double a[SAMPLE][9], int *order, int i, int j)
{
    for (int r = 0; r < SAMPLE; r++) {
        double t = a[r][i];
        a[r][i] = a[r][j];
        a[r][j] = t;
    }
    int t = order[i];
    order[i] = order[j];
    order[j] = t;
}

/* Gauss-Jordan elimination with full pivoting; order: the permutation of the columns.
 * returns: the rank, 6 or less where the view only shifted or did not move. */
static int eliminate_rows(double a[SAMPLE][9], int order[9])
{
    for (int i = 0; i < 9; i++)
        order[i] = i;
    for (int k = 0; k < SAMPLE; k++) {
        int at = 10 * k; // row times 9 plus column
        for (int i = 9 * k; i < 9 * SAMPLE; i++)
            if (i % 9 >= k && fabs(a[i / 9][i % 9]) > fabs(a[at / 9][at % 9]))
                at = i;
        int pr = at / 9, pc = at % 9;
        if (fabs(a[pr][pc]) < 1e-9)
            return k;
        double t[9];
        memcpy(t, a[pr], sizeof t);
        memcpy(a[pr], a[k], sizeof t);
        memcpy(a[k], t, sizeof t);
        swap_columns(a, order, k, pc);
        for (int r = 0; r < SAMPLE; r++) {
            double part = r == k ? 0 : a[r][k] / a[k][k];
            for (int c = k; c < 9 && part != 0; c++)
                a[r][c] -= part * a[k][c];
        }
    }
    return SAMPLE;
}

static double determinant(const double f[9])
{
    return f[0] * (f[4] * f[8] - f[5] * f[7]) - f[1] * (f[3] * f[8] - f[5] * f[6]) +
           f[2] * (f[3] * f[7] - f[4] * f[6]);
}

/* Real roots of c3 x^3 + c2 x^2 + c1 x + c0; root 0 if c0 is 0. returns: their number. */
static int solve_cubic(const double c[4], double root[3])
{
    root[0] = 0;
    if (c[0] == 0)
        return 1;
    if (fabs(c[3]) < 1e-12 * (fabs(c[2]) + fabs(c[1]) + fabs(c[0]))) {
        double d = c[1] * c[1] - 4 * c[2] * c[0];
        if (c[2] == 0 || d < 0)
            return 0;
        root[0] = (-c[1] + sqrt(d)) / (2 * c[2]);
        root[1] = (-c[1] - sqrt(d)) / (2 * c[2]);
        return 2;
    }
    double a = c[2] / c[3] / 3, b = c[1] / c[3], q = a * a - b / 3;
    double r = a * a * a - a * b / 2 + c[0] / c[3] / 2;
    if (r * r < q * q * q) {
        double t = acos(fmin(fmax(r / sqrt(q * q * q), -1), 1)), s = -2 * sqrt(q);
        for (int i = 0; i < 3; i++)
            root[i] = s * cos((t + 2 * NUM_PI * (i - 1)) / 3) - a;
        return 3;
    }
    double s = -copysign(cbrt(fabs(r) + sqrt(r * r - q * q * q)), r);
    root[0] = s + (s != 0 ? q / s : 0) - a;
    return 1;
}

/* Matrices through seven matches; returns their number, at most 3. */
static int solve_seven(const struct epipolar_match *const m[SAMPLE], struct epipolar_bend bend,
                       double scale, double f[3][9])
{
    double a[SAMPLE][9], p[9], q[9], at[4], c[4], root[3];
    int order[9];
    for (int i = 0; i < SAMPLE; i++)
        match_equation(m[i], bend, scale, a[i]);
    int rank = eliminate_rows(a, order);
    memset(p, 0, sizeof p);
    memset(q, 0, sizeof q);
    for (int i = 0; i < rank; i++) {
        p[order[i]] = -a[i][7] / a[i][i];
        q[order[i]] = -a[i][8] / a[i][i];
    }
    p[order[7]] = q[order[8]] = 1;
    for (int k = 0; k < 4; k++) { // determinant of p + x q at x = -1, 0, 1, 2
        double mix[9];
        for (int i = 0; i < 9; i++)
            mix[i] = p[i] + (k - 1) * q[i];
        at[k] = determinant(mix);
    }
    c[0] = at[1];
    c[2] = 0.5 * (at[0] + at[2]) - at[1];
    c[3] = (at[3] - 4 * c[2] - c[0] - (at[2] - at[0])) / 6;
    c[1] = 0.5 * (at[2] - at[0]) - c[3];
    int n = solve_cubic(c, root);
    for (int k = 0; k < n; k++) {
        for (int i = 0; i < 9; i++)
            f[k][i] = p[i] + root[k] * q[i];
        rescale_matrix(f[k], scale);
    }
    return n;
}

/* ---- all matches ---- */

/* MSAC */
double epipolar_score(const double f[9], struct epipolar_bend bend, const struct epipolar_match *m,
                      int n, float bound, int *agree)
{
    const double square = (double)bound * (double)bound;
    double sum = 0;
    *agree = 0;
    for (int i = 0; i < n; i++) {
        const double d = epipolar_distance(f, bend, m + i);
        if (d < square) {
            sum += 1 - d / square;
            ++*agree;
        }
    }
    return sum;
}

/* Weighted least squares on the matches that agree with f, in place: the eigenvector of the
 * smallest eigenvalue by inverse iteration. */
static int polish_matrix(const struct epipolar_match *m, int n, struct epipolar_bend bend,
                         const struct epipolar_search *how, double f[9])
{
    const double square = (double)how->bound * (double)how->bound, scale = 2.0 / how->size;
    double ata[81] = {0}, x[9];
    for (int i = 0; i < n; i++) {
        double row[9], d = epipolar_distance(f, bend, m + i);
        if (d >= square)
            continue;
        match_equation(m + i, bend, scale, row);
        double grad = 0, e = 0;
        for (int k = 0; k < 9; k++)
            e += f[k] * row[k] / ((k / 3 < 2 ? scale : 1) * (k % 3 < 2 ? scale : 1));
        grad = d > 1e-12 ? e * e / d : 1e-30;
        double weight = (1 - d / square) / fmax(grad, 1e-30);
        for (int r = 0; r < 9; r++)
            for (int c = 0; c <= r; c++)
                ata[9 * r + c] += weight * row[r] * row[c];
    }
    double trace = 0;
    for (int i = 0; i < 9; i++)
        trace += ata[10 * i];
    for (int i = 0; i < 9; i++) {
        ata[10 * i] += 1e-12 * trace;
        x[i] = f[i] / ((i / 3 < 2 ? scale : 1) * (i % 3 < 2 ? scale : 1));
    }
    if (!(trace > 0) || !lin_cholesky(ata, 9))
        return 0;
    for (int turn = 0; turn < 6; turn++) {
        double sum = 0;
        lin_solve(ata, 9, x);
        for (int i = 0; i < 9; i++)
            sum += x[i] * x[i];
        for (int i = 0; i < 9; i++)
            x[i] /= sqrt(sum);
    }
    memcpy(f, x, sizeof x);
    rescale_matrix(f, scale);
    return 1;
}

static uint32_t draw_below(uint32_t *state, uint32_t below)
{
    *state = *state * 1664525u + 1013904223u; // Numerical Recipes
    return (uint32_t)(((uint64_t)*state * below) >> 32);
}

/* Seven different matches of the first `from`. */
static void choose_sample(const struct epipolar_match *m, int from, uint32_t *state,
                          const struct epipolar_match *out[SAMPLE])
{
    int at[SAMPLE] = {0}, n = 0;
    while (n < SAMPLE) {
        int one = (int)draw_below(state, (uint32_t)from), k = 0;
        while (k < n && at[k] != one)
            k++;
        if (k == n)
            at[n++] = one;
    }
    for (int i = 0; i < SAMPLE; i++)
        out[i] = m + at[i];
}

/* Draws that contain one of good matches only with 99.9 % probability. */
static int draws_needed(int agree, int n, int most)
{
    double good = pow((double)agree / n, SAMPLE);
    if (good > 0.999)
        return 8;
    double k = log(1e-3) / log1p(-good);
    return k < most ? (int)k + 8 : most;
}

int epipolar_polish(const struct epipolar_search *how, struct epipolar_bend bend,
                    const struct epipolar_match *m, int n, double f[9])
{
    int agree;
    double best = epipolar_score(f, bend, m, n, how->bound, &agree);
    for (int turn = 0; turn < POLISH; turn++) {
        double trial[9];
        int count;
        memcpy(trial, f, sizeof trial);
        if (!polish_matrix(m, n, bend, how, trial))
            break;
        const double sum = epipolar_score(trial, bend, m, n, how->bound, &count);
        if (sum <= best)
            break;
        best = sum;
        agree = count;
        memcpy(f, trial, sizeof trial);
    }
    return agree;
}

int epipolar_run(const struct epipolar_search *how, struct epipolar_bend bend,
                 const struct epipolar_match *m, int n, double f[9])
{
    double best = 0;
    const double scale = 2.0 / how->size;
    uint32_t state = 1;
    int agree = 0, left = how->draws;
    memset(f, 0, 9 * sizeof *f);
    if (n < EPIPOLAR_LEAST)
        return 0;
    for (int turn = 0; turn < left; turn++) {
        const struct epipolar_match *sample[SAMPLE];
        double trial[3][9];
        const int from = 20 + turn * n / (how->draws / 4);
        choose_sample(m, from < n ? from : n, &state, sample);
        const int found = solve_seven(sample, bend, scale, trial);
        for (int k = 0; k < found; k++) {
            int count;
            const double sum = epipolar_score(trial[k], bend, m, n, how->bound, &count);
            if (sum > best) {
                best = sum;
                agree = count;
                memcpy(f, trial[k], sizeof trial[k]);
                left = draws_needed(agree, n, how->draws);
            }
        }
    }
    return epipolar_polish(how, bend, m, n, f);
}
