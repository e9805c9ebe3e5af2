/* Matrices of the harmonics are integrals over the sphere, m_ij = int Y_i(d) Y_j(r^T d) dd, by a
 * rule that is exact for polynomials of degree 9: Gauss-Legendre in z, equal steps around. */
#include "core/splat/turn.h"

#include "core/base/num.h"
#include "core/splat/raster.h"
#include "core/splat/voxel.h"

#include <math.h>
#include <string.h>

enum { RINGS = 5, STEPS = 10, BLOCK = 1024 };

/* ---- scale ---- */

static size_t pairs(int n)
{
    return (size_t)n * (size_t)(n > 0 ? n - 1 : 0) / 2;
}

size_t turn_plan(int n_views)
{
    return arena_need(pairs(n_views), sizeof(float));
}

void turn_centre(const struct camera *c, double out[3])
{
    float r[9];
    raster_rotation(c->q, r);
    for (int k = 0; k < 3; k++)
        out[k] = -((double)r[k] * (double)c->t[0] + (double)r[3 + k] * (double)c->t[1] +
                   (double)r[6 + k] * (double)c->t[2]);
}

static double distance(const struct camera *a, const struct camera *b)
{
    double p[3], q[3];
    turn_centre(a, p);
    turn_centre(b, q);
    return sqrt((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]) +
                (p[2] - q[2]) * (p[2] - q[2]));
}

err_t turn_scale(const struct run *r, const struct camera *from, const struct camera *to,
                 int n_views, float *out)
{
    size_t mark = arena_mark(r->tmp), n = 0;
    float *ratio;
    *out = 1.0f;
    err_t e = arena_alloc(r->tmp, pairs(n_views), sizeof *ratio, &ratio);
    if (e)
        return e;
    for (int i = 0; i < n_views; i++)
        for (int j = 0; j < i; j++) {
            double a = distance(&from[i], &from[j]), b = distance(&to[i], &to[j]);
            if (a > 0 && b > 0 && isnormal((float)(b / a)))
                ratio[n++] = (float)(b / a);
        }
    if (n > 0)
        *out = num_median(ratio, n);
    arena_reset(r->tmp, mark);
    return OK;
}

/* ---- worlds ---- */

/* out = a b, or a conj(b). */
static void multiply(const double a[4], const double b[4], bool conjugate, double out[4])
{
    double s = conjugate ? -1 : 1;
    out[0] = a[0] * b[0] - s * (a[1] * b[1] + a[2] * b[2] + a[3] * b[3]);
    out[1] = s * a[0] * b[1] + a[1] * b[0] + s * (a[2] * b[3] - a[3] * b[2]);
    out[2] = s * a[0] * b[2] + a[2] * b[0] + s * (a[3] * b[1] - a[1] * b[3]);
    out[3] = s * a[0] * b[3] + a[3] * b[0] + s * (a[1] * b[2] - a[2] * b[1]);
}

static void rotate(const double q[4], const double x[3], double out[3])
{
    const double v[4] = {0, x[0], x[1], x[2]};
    double half[4], full[4];
    multiply(q, v, false, half);
    multiply(half, q, true, full);
    for (int k = 0; k < 3; k++)
        out[k] = full[k + 1];
}

/* Add the rotation from one world to the other that camera i shows, on the side of the sum. */
static void add_rotation(const struct camera *from, const struct camera *to, double sum[4])
{
    const double a[4] = {(double)to->q[0], -(double)to->q[1], -(double)to->q[2], -(double)to->q[3]};
    const double b[4] = {(double)from->q[0], (double)from->q[1], (double)from->q[2],
                         (double)from->q[3]};
    double q[4], side = 0;
    multiply(a, b, false, q);
    for (int k = 0; k < 4; k++)
        side += q[k] * sum[k];
    for (int k = 0; k < 4; k++)
        sum[k] += side < 0 ? -q[k] : q[k];
}

err_t turn_fit(const struct run *r, const struct camera *from, const struct camera *to, int n_views,
               struct turn_world *out)
{
    float scale;
    double length = 0;
    err_t e = turn_scale(r, from, to, n_views, &scale);
    *out = (struct turn_world){.scale = (double)scale};
    for (int i = 0; i < n_views; i++)
        add_rotation(&from[i], &to[i], out->q);
    for (int k = 0; k < 4; k++)
        length += out->q[k] * out->q[k];
    for (int k = 0; k < 4; k++)
        out->q[k] = length > 0 ? out->q[k] / sqrt(length) : k == 0;
    for (int i = 0; i < n_views; i++) {
        double a[3], b[3], turned[3];
        turn_centre(&from[i], a);
        turn_centre(&to[i], b);
        rotate(out->q, a, turned);
        for (int k = 0; k < 3; k++)
            out->t[k] += (b[k] - out->scale * turned[k]) / n_views;
    }
    return e;
}

struct camera turn_camera(const struct turn_world *w, const struct camera *cam)
{
    struct camera out = *cam;
    const double q[4] = {(double)cam->q[0], (double)cam->q[1], (double)cam->q[2],
                         (double)cam->q[3]};
    double turned[4], centre[3], moved[3], back[3];
    multiply(q, w->q, true, turned);
    turn_centre(cam, centre);
    rotate(w->q, centre, moved);
    for (int k = 0; k < 3; k++)
        moved[k] = w->scale * moved[k] + w->t[k];
    rotate(turned, moved, back);
    for (int k = 0; k < 4; k++)
        out.q[k] = (float)turned[k];
    for (int k = 0; k < 3; k++)
        out.t[k] = (float)-back[k];
    return out;
}

/* ---- rotation ---- */

void turn_rotation(const struct camera *from, const struct camera *to, float out[9])
{
    float a[9], b[9];
    raster_rotation(from->q, a);
    raster_rotation(to->q, b);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = b[i] * a[j] + b[3 + i] * a[3 + j] + b[6 + i] * a[6 + j];
}

/* Basis of model-spec 2.13. */
static void basis(const double d[3], double b[SH_COEFS_MAX])
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

void turn_bands(const float r[9], float m[SH_COEFS_MAX][SH_COEFS_MAX])
{
    static const double node[RINGS] = {-0.9061798459386640, -0.5384693101056831, 0,
                                       0.5384693101056831, 0.9061798459386640};
    static const double weight[RINGS] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889,
                                         0.4786286704993665, 0.2369268850561891};
    const double pi = 3.14159265358979323846;
    double sum[SH_COEFS_MAX][SH_COEFS_MAX] = {{0}}, to[SH_COEFS_MAX], from[SH_COEFS_MAX];
    for (int k = 0; k < RINGS * STEPS; k++) {
        double z = node[k / STEPS], rho = sqrt(1 - z * z), phi = 2 * pi * (k % STEPS) / STEPS;
        double d[3] = {rho * cos(phi), rho * sin(phi), z}, back[3];
        for (int i = 0; i < 3; i++)
            back[i] = (double)r[i] * d[0] + (double)r[3 + i] * d[1] + (double)r[6 + i] * d[2];
        basis(d, to);
        basis(back, from);
        for (int i = 0; i < SH_COEFS_MAX; i++)
            for (int j = 0; j < SH_COEFS_MAX; j++)
                sum[i][j] += weight[k / STEPS] * (2 * pi / STEPS) * to[i] * from[j];
    }
    for (int i = 0; i < SH_COEFS_MAX; i++)
        for (int j = 0; j < SH_COEFS_MAX; j++)
            m[i][j] = band_of(i) == band_of(j) ? (float)sum[i][j] : 0.0f;
}

/* ---- features ---- */

struct turn {
    const struct run *r;
    float *features;
    size_t n;
    int first, count;
    float q[4]; // x,y,z,w
    float m[SH_COEFS_MAX][SH_COEFS_MAX];
};

/* Quaternion x,y,z,w of a rotation matrix (Shepperd 1978: from its largest component). */
static void to_quaternion(const float r[9], float q[4])
{
    float t[4] = {1 + r[0] - r[4] - r[8], 1 - r[0] + r[4] - r[8], 1 - r[0] - r[4] + r[8],
                  1 + r[0] + r[4] + r[8]};
    int k = 0;
    for (int i = 1; i < 4; i++)
        k = t[i] > t[k] ? i : k;
    const float v[4][4] = {
        {t[0], r[1] + r[3], r[2] + r[6], r[7] - r[5]},
        {r[1] + r[3], t[1], r[5] + r[7], r[2] - r[6]},
        {r[2] + r[6], r[5] + r[7], t[2], r[3] - r[1]},
        {r[7] - r[5], r[2] - r[6], r[3] - r[1], t[3]},
    };
    float len =
        sqrtf(v[k][0] * v[k][0] + v[k][1] * v[k][1] + v[k][2] * v[k][2] + v[k][3] * v[k][3]);
    for (int i = 0; i < 4; i++)
        q[i] = v[k][i] / len;
}

/* One band of one Gaussian, whose values are n apart. */
static void turn_band(const struct turn *t, int l, float *c)
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

static void turn_quaternions(const struct turn *t, size_t at, int count)
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

static err_t turn_chunk(void *ctx, int chunk, int worker)
{
    const struct turn *t = ctx;
    (void)worker;
    if (t->r->cancel && atomic_load(t->r->cancel))
        return err_fail(ERR_CANCELLED, "turning Gaussians: cancelled");
    int from = chunk * BLOCK, count = t->count - from < BLOCK ? t->count - from : BLOCK;
    size_t at = (size_t)(t->first + from);
    turn_quaternions(t, at, count);
    for (int c = 0; c < 3; c++)
        for (int l = 1; l <= SH_DEGREE_MAX; l++)
            for (int i = 0; i < count; i++)
                turn_band(t, l,
                          t->features + (size_t)(VOXEL_SH + SH_COEFS_MAX * c + l * l) * t->n + at +
                              (size_t)i);
    return OK;
}

err_t turn_features(const struct run *r, const float rotation[9], float *features, size_t n,
                    const int range[2])
{
    struct turn t = {.r = r, .features = features, .n = n, .first = range[0], .count = range[1]};
    to_quaternion(rotation, t.q);
    turn_bands(rotation, t.m);
    return pool_for(r->pool, (t.count + BLOCK - 1) / BLOCK, turn_chunk, &t);
}
