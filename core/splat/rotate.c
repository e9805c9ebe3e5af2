/* Matrices of the harmonics are integrals over the sphere, m_ij = int Y_i(d) Y_j(r^T d) dd, by a
 * rule that is exact for polynomials of degree 9: Gauss-Legendre in z, equal steps around. */
#include "core/splat/rotate.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/splat/voxel.h"

#include <math.h>

enum { RINGS = 5, STEPS = 10, BLOCK = 1024 };

/* Basis of core/splat/README.md 4. */
static void sh_basis(const double d[3], double b[SH_COEFS_MAX])
{
    const double x = d[0], y = d[1], z = d[2], zz = z * z;
    const double c1 = x * x - y * y, s1 = 2 * x * y;
    const double c2 = x * c1 - y * s1, s2 = x * s1 + y * c1;
    const double c3 = x * c2 - y * s2, s3 = x * s2 + y * c2;
    const double p11 = -2.285228997322329 * zz + 0.4570457994644658;
    const double p18 = 3.31161143515146 * zz - 0.47308734787878;
    const double p19 = z * (-4.683325804901025 * zz + 2.007139630671868);
    b[0] = SH_BASIS0;
    b[1] = -0.48860251190292 * y;
    b[2] = 0.48860251190292 * z;
    b[3] = -0.48860251190292 * x;
    b[4] = 0.5462742152960395 * s1;
    b[5] = -1.092548430592079 * z * y;
    b[6] = 0.9461746957575601 * zz - 0.3153915652525201;
    b[7] = -1.092548430592079 * z * x;
    b[8] = 0.5462742152960395 * c1;
    b[9] = -0.5900435899266435 * s2;
    b[10] = 1.445305721320277 * z * s1;
    b[11] = p11 * y;
    b[12] = z * (1.865881662950577 * zz - 1.119528997770346);
    b[13] = p11 * x;
    b[14] = 1.445305721320277 * z * c1;
    b[15] = -0.5900435899266435 * c2;
    b[16] = 0.6258357354491763 * s3;
    b[17] = -1.770130769779931 * z * s2;
    b[18] = p18 * s1;
    b[19] = p19 * y;
    b[20] = 1.984313483298443 * z * b[12] - 1.006230589874905 * b[6];
    b[21] = p19 * x;
    b[22] = p18 * c1;
    b[23] = -1.770130769779931 * z * c2;
    b[24] = 0.6258357354491763 * c3;
}

static int band_of(int i)
{
    return i < 1 ? 0 : i < 4 ? 1 : i < 9 ? 2 : i < 16 ? 3 : 4;
}

void rotate_bands(const float r[9], float m[SH_COEFS_MAX][SH_COEFS_MAX])
{
    static const double node[RINGS] = {-0.9061798459386640, -0.5384693101056831, 0,
                                       0.5384693101056831, 0.9061798459386640};
    static const double weight[RINGS] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889,
                                         0.4786286704993665, 0.2369268850561891};
    double sum[SH_COEFS_MAX][SH_COEFS_MAX] = {{0}}, to[SH_COEFS_MAX], from[SH_COEFS_MAX];
    for (int k = 0; k < RINGS * STEPS; k++) {
        double z = node[k / STEPS], rho = sqrt(1 - z * z), phi = 2 * NUM_PI * (k % STEPS) / STEPS;
        double d[3] = {rho * cos(phi), rho * sin(phi), z}, back[3];
        for (int i = 0; i < 3; i++)
            back[i] = (double)r[i] * d[0] + (double)r[3 + i] * d[1] + (double)r[6 + i] * d[2];
        sh_basis(d, to);
        sh_basis(back, from);
        for (int i = 0; i < SH_COEFS_MAX; i++)
            for (int j = 0; j < SH_COEFS_MAX; j++)
                sum[i][j] += weight[k / STEPS] * (2 * NUM_PI / STEPS) * to[i] * from[j];
    }
    for (int i = 0; i < SH_COEFS_MAX; i++)
        for (int j = 0; j < SH_COEFS_MAX; j++)
            m[i][j] = band_of(i) == band_of(j) ? (float)sum[i][j] : 0.0f;
}

/* ---- features ---- */

struct rotate {
    const struct run *r;
    float *features;
    size_t n;
    int first, count;
    float q[4]; // x,y,z,w
    float m[SH_COEFS_MAX][SH_COEFS_MAX];
};

/* One band of one Gaussian, whose values are n apart. */
static void rotate_band(const struct rotate *t, int l, float *c)
{
    float in[2 * SH_DEGREE_MAX + 1] = {0};
    for (int k = 0; k < 2 * l + 1; k++)
        in[k] = c[(size_t)k * t->n];
    for (int k = 0; k < 2 * l + 1; k++) {
        float sum = 0;
        for (int j = 0; j < 2 * l + 1; j++)
            sum += t->m[l * l + k][l * l + j] * in[j];
        c[(size_t)k * t->n] = sum;
    }
}

static void rotate_quaternions(const struct rotate *t, size_t at, int count)
{
    const float *q = t->q;
    for (int i = 0; i < count; i++) {
        float *p = t->features + VOXEL_QUAT * t->n + at + (size_t)i;
        const float x = p[0], y = p[t->n], z = p[2 * t->n], w = p[3 * t->n];
        p[0] = q[3] * x + q[0] * w + q[1] * z - q[2] * y;
        p[t->n] = q[3] * y - q[0] * z + q[1] * w + q[2] * x;
        p[2 * t->n] = q[3] * z + q[0] * y - q[1] * x + q[2] * w;
        p[3 * t->n] = q[3] * w - q[0] * x - q[1] * y - q[2] * z;
    }
}

static err_t rotate_chunk(void *ctx, int chunk, int worker)
{
    const struct rotate *t = ctx;
    (void)worker;
    if (t->r->cancel && atomic_load(t->r->cancel))
        return err_fail(ERR_CANCELLED, "rotating Gaussians: cancelled");
    int from = chunk * BLOCK, count = t->count - from < BLOCK ? t->count - from : BLOCK;
    size_t at = (size_t)(t->first + from);
    rotate_quaternions(t, at, count);
    for (int c = 0; c < 3; c++)
        for (int l = 1; l <= SH_DEGREE_MAX; l++)
            for (int i = 0; i < count; i++)
                rotate_band(t, l,
                            t->features + (size_t)(VOXEL_SH + SH_COEFS_MAX * c + l * l) * t->n +
                                at + (size_t)i);
    return OK;
}

err_t rotate_features(const struct run *r, const float rotation[9], float *features, size_t n,
                      const int range[2])
{
    struct rotate t = {.r = r, .features = features, .n = n, .first = range[0], .count = range[1]};
    double m[9], q[4];
    for (int i = 0; i < 9; i++)
        m[i] = (double)rotation[i];
    rotation_to_quat(m, q);
    for (int i = 0; i < 4; i++)
        t.q[i] = (float)q[(i + 1) % 4];
    rotate_bands(rotation, t.m);
    return pool_for(r->pool, (t.count + BLOCK - 1) / BLOCK, rotate_chunk, &t);
}
