/* Light in the patch and in the picture is brought to mean 0 and variance 1; slopes of the patch
 * are made orthogonal to a constant and to the patch itself, so that a wrong gain and offset do not
 * move it. First the shift alone, then all six parameters. The expected error follows from the
 * remaining difference and the normal equations. */
#include "core/sfm/patch.h"

#include "core/base/lin.h"

#include <math.h>
#include <string.h>

enum { SHIFTS = 4, STEPS = 10 };

#define WIDTH 3.5f         // px, Gauss that a patch fades with
#define CONTRAST_MIN 2e-3f // of light (0..1), above the error of rounding
#define RIDGE 1e-3         // of the largest normal equation
#define CORRELATED 7.0     // pixels that share noise, as light is smoothed

/* Value between pixels; (x, y) in pixel centres, inside by one pixel. */
static float sample_bilinear(const float *px, int n, float x, float y)
{
    int i = (int)x, j = (int)y;
    float fx = x - (float)i, fy = y - (float)j;
    const float *p = px + (size_t)j * (size_t)n + (size_t)i;
    float top = p[0] + fx * (p[1] - p[0]), low = p[n] + fx * (p[n + 1] - p[n]);
    return top + fy * (low - top);
}

static bool is_inside(const struct corner_level *l, float x, float y, float margin)
{
    return x >= margin && y >= margin && x < (float)(l->w - 1) - margin &&
           y < (float)(l->h - 1) - margin;
}

/* To mean 0 and variance 1 under `weight`; returns the deviation. */
static float standardise_patch(const float *weight, float *x)
{
    float mean = 0, square = 0;
    for (int k = 0; k < PATCH_AREA; k++)
        mean += weight[k] * x[k];
    for (int k = 0; k < PATCH_AREA; k++) {
        x[k] -= mean;
        square += weight[k] * x[k] * x[k];
    }
    float deviation = sqrtf(square);
    for (int k = 0; k < PATCH_AREA; k++)
        x[k] /= fmaxf(deviation, 1e-9f);
    return deviation;
}

/* Normal equations of the first n parameters. */
static bool normal_equations(const struct patch *p, int n, double *out)
{
    double top = 0;
    for (int r = 0; r < n; r++) {
        for (int c = 0; c <= r; c++) {
            float sum = 0;
            for (int k = 0; k < PATCH_AREA; k++)
                sum += p->weight[k] * p->slope[k][r] * p->slope[k][c];
            out[r * n + c] = sum;
        }
        top = fmax(top, out[r * n + r]);
    }
    for (int r = 0; r < n; r++)
        out[r * n + r] += RIDGE * top;
    return lin_cholesky(out, n);
}

/* Slopes by the parameters from gradients; those of the map are per patch radius. */
static void make_slopes(struct patch *p, const float (*gradient)[2], float deviation)
{
    float mean[6] = {0}, gain[6] = {0};
    for (int k = 0; k < PATCH_AREA; k++) {
        float x = (float)(k % PATCH_EDGE - PATCH_REACH) / PATCH_REACH;
        float y = (float)(k / PATCH_EDGE - PATCH_REACH) / PATCH_REACH;
        float gx = gradient[k][0] / deviation, gy = gradient[k][1] / deviation;
        const float s[6] = {gx, gy, gx * x, gx * y, gy * x, gy * y};
        memcpy(p->slope[k], s, sizeof s);
        for (int i = 0; i < 6; i++) {
            mean[i] += p->weight[k] * s[i];
            gain[i] += p->weight[k] * s[i] * p->light[k];
        }
    }
    for (int k = 0; k < PATCH_AREA; k++)
        for (int i = 0; i < 6; i++)
            p->slope[k][i] -= mean[i] + gain[i] * p->light[k];
}

bool patch_make(const struct corner_level *l, float u, float v, struct patch *out)
{
    float gradient[PATCH_AREA][2], sum = 0;
    if (!is_inside(l, u - 0.5f, v - 0.5f, PATCH_REACH + 2))
        return false;
    for (int k = 0; k < PATCH_AREA; k++) {
        float dx = (float)(k % PATCH_EDGE - PATCH_REACH);
        float dy = (float)(k / PATCH_EDGE - PATCH_REACH);
        float x = u - 0.5f + dx, y = v - 0.5f + dy;
        out->light[k] = sample_bilinear(l->light, l->w, x, y);
        out->weight[k] = sample_bilinear(l->weight, l->w, x, y) *
                         expf(-0.5f * (dx * dx + dy * dy) / (WIDTH * WIDTH));
        gradient[k][0] = 0.5f * (sample_bilinear(l->light, l->w, x + 1, y) -
                                 sample_bilinear(l->light, l->w, x - 1, y));
        gradient[k][1] = 0.5f * (sample_bilinear(l->light, l->w, x, y + 1) -
                                 sample_bilinear(l->light, l->w, x, y - 1));
        sum += out->weight[k];
    }
    if (sum < 0.2f * PATCH_AREA)
        return false;
    for (int k = 0; k < PATCH_AREA; k++)
        out->weight[k] /= sum;
    float deviation = standardise_patch(out->weight, out->light);
    if (deviation < CONTRAST_MIN)
        return false;
    make_slopes(out, gradient, deviation);
    return normal_equations(out, 6, out->factor) && normal_equations(out, 2, out->small);
}

/* Difference of picture and patch, and its mean square; false outside the picture or without
 * contrast. */
static bool compare_patch(const struct patch *p, const struct corner_level *l,
                          const struct patch_position *at, float *diff, float *square)
{
    for (int k = 0; k < PATCH_AREA; k++) {
        float dx = (float)(k % PATCH_EDGE - PATCH_REACH);
        float dy = (float)(k / PATCH_EDGE - PATCH_REACH);
        float x = at->u - 0.5f + at->m[0] * dx + at->m[1] * dy;
        float y = at->v - 0.5f + at->m[2] * dx + at->m[3] * dy;
        if (!is_inside(l, x, y, 0))
            return false;
        diff[k] = sample_bilinear(l->light, l->w, x, y);
    }
    if (standardise_patch(p->weight, diff) < CONTRAST_MIN)
        return false;
    *square = 0;
    for (int k = 0; k < PATCH_AREA; k++) {
        diff[k] -= p->light[k];
        *square += p->weight[k] * diff[k] * diff[k];
    }
    return true;
}

/* One step of n parameters; returns how far the middle moves, px. */
static float align_step(const struct patch *p, const float *diff, int n, struct patch_position *at)
{
    double d[6] = {0};
    for (int k = 0; k < PATCH_AREA; k++)
        for (int i = 0; i < n; i++)
            d[i] += p->weight[k] * p->slope[k][i] * diff[k];
    lin_solve(n == 6 ? p->factor : p->small, n, d);
    for (int i = 2; i < 6; i++)
        d[i] /= PATCH_REACH;
    double a = 1 + d[2], b = d[3], c = d[4], e = 1 + d[5], det = a * e - b * c;
    if (!(det > 0.2))
        return INFINITY;
    const double inv[4] = {e / det, -b / det, -c / det, a / det};
    float m[4];
    memcpy(m, at->m, sizeof m);
    for (int i = 0; i < 4; i++)
        at->m[i] = (float)(m[i & 2] * inv[i & 1] + m[(i & 2) + 1] * inv[2 + (i & 1)]);
    float du = (float)(at->m[0] * d[0] + at->m[1] * d[1]);
    float dv = (float)(at->m[2] * d[0] + at->m[3] * d[1]);
    at->u -= du;
    at->v -= dv;
    return sqrtf(du * du + dv * dv);
}

/* Expected error of the middle from the mean square of the difference. */
static float expected_error(const struct patch *p, const struct patch_position *at, float square)
{
    double sum = 0, squares = 0, area = at->m[0] * at->m[3] - at->m[1] * at->m[2];
    for (int k = 0; k < PATCH_AREA; k++)
        squares += p->weight[k] * p->weight[k];
    for (int i = 0; i < 2; i++) {
        double e[6] = {0};
        e[i] = 1;
        lin_solve(p->factor, 6, e);
        sum += e[i];
    }
    return (float)sqrt(0.5 * sum * fabs(area) * square * squares * CORRELATED);
}

bool patch_find(const struct patch *p, const struct corner_level *l, struct patch_position *at)
{
    float diff[PATCH_AREA], square;
    for (int i = 0; i < SHIFTS + STEPS; i++) {
        if (!compare_patch(p, l, at, diff, &square))
            return false;
        float moved = align_step(p, diff, i < SHIFTS ? 2 : 6, at);
        if (!(moved < 3))
            return false;
        if (i >= SHIFTS && moved < 0.005f)
            break;
    }
    if (!compare_patch(p, l, at, diff, &square))
        return false;
    at->correlation = 1 - 0.5f * square;
    at->sigma = expected_error(p, at, square);
    return true;
}
