/* raster_ref.h - the formulas of core/splat/README.md 2 to 4 in double precision, splat by splat
 * and pixel by pixel, with no thought of speed. The truth for tests of core/splat: values, and
 * gradients by finite differences. */
#ifndef SPLAT_RASTER_REF_H
#define SPLAT_RASTER_REF_H

#include "core/base/gaussians.h"
#include "core/base/types.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { REF_PARAMS = 11 + 75 };

struct ref_splat {
    double p[REF_PARAMS]; // in the order of the planes of struct gaussians
};

struct ref_camera {
    double r[9], t[3], fx, fy, cx, cy;
    int w, h;
    double reach; // deviations; splats that reach so behind the camera are not drawn. gsplat: 0
};

struct ref_2d {
    double u, v, a, b, c, o, rgb[3], z;
    int tx0, tx1, ty0, ty1, index;
};

static inline void ref_sh(int degree, const double d[3], double b[25])
{
    double x = d[0], y = d[1], z = d[2];
    double c1 = x * x - y * y, s1 = 2 * x * y, c2 = x * c1 - y * s1, s2 = x * s1 + y * c1;
    double c3 = x * c2 - y * s2, s3 = x * s2 + y * c2, zz = z * z;
    double p12 = z * (1.865881662950577 * zz - 1.119528997770346);
    double p6 = .9461746957575601 * zz - .3153915652525201;
    double p11 = -2.285228997322329 * zz + .4570457994644658,
           p18 = 3.31161143515146 * zz - .47308734787878;
    double p19 = z * (-4.683325804901025 * zz + 2.007139630671868);
    const double all[25] = {.2820947917738781,
                            -.48860251190292 * y,
                            .48860251190292 * z,
                            -.48860251190292 * x,
                            .5462742152960395 * s1,
                            -1.092548430592079 * z * y,
                            p6,
                            -1.092548430592079 * z * x,
                            .5462742152960395 * c1,
                            -.5900435899266435 * s2,
                            1.445305721320277 * z * s1,
                            p11 * y,
                            p12,
                            p11 * x,
                            1.445305721320277 * z * c1,
                            -.5900435899266435 * c2,
                            .6258357354491763 * s3,
                            -1.770130769779931 * z * s2,
                            p18 * s1,
                            p19 * y,
                            1.984313483298443 * z * p12 - 1.006230589874905 * p6,
                            p19 * x,
                            p18 * c1,
                            -1.770130769779931 * z * c2,
                            .6258357354491763 * c3};
    for (int k = 0; k < 25; k++)
        b[k] = k < (degree + 1) * (degree + 1) ? all[k] : 0;
}

static inline double ref_clamp(double x, double lo, double hi)
{
    return x < lo ? lo : x > hi ? hi : x;
}

static inline void ref_rotation(const double q[4], double m[9])
{
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    double w = q[0] / n, x = q[1] / n, y = q[2] / n, z = q[3] / n;
    if (!(n > 0))
        w = 1, x = y = z = 0;
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(m, r, sizeof r);
}

/* N = J R M diag(s), the factor of the 2-D covariance N N^T before the blur.
 * returns: the variance along the view. */
static inline double ref_factor(const struct ref_splat *s, const struct ref_camera *c,
                                const double p[3], double n[2][3])
{
    double rot[9], along = 0, rz = 1 / p[2], mx = .15 * c->w / c->fx, my = .15 * c->h / c->fy;
    ref_rotation(s->p + 6, rot);
    double tx = ref_clamp(p[0] * rz, -(c->cx / c->fx + mx), (c->w - c->cx) / c->fx + mx);
    double ty = ref_clamp(p[1] * rz, -(c->cy / c->fy + my), (c->h - c->cy) / c->fy + my);
    for (int j = 0; j < 3; j++) {
        double w[3], e = exp(s->p[3 + j]);
        for (int i = 0; i < 3; i++)
            w[i] =
                c->r[3 * i] * rot[j] + c->r[3 * i + 1] * rot[3 + j] + c->r[3 * i + 2] * rot[6 + j];
        n[0][j] = c->fx * rz * (w[0] - tx * w[2]) * e;
        n[1][j] = c->fy * rz * (w[1] - ty * w[2]) * e;
        along += w[2] * e * w[2] * e;
    }
    return along;
}

/* Tiles and conic; 0 if nothing can be seen. o->u, o->v are known. */
static inline int ref_footprint(const struct ref_camera *c, double n[2][3], struct ref_2d *o)
{
    double xx = .3, xy = 0, yy = .3, nx = (c->w + 15) / 16, ny = (c->h + 15) / 16;
    for (int j = 0; j < 3; j++) {
        xx += n[0][j] * n[0][j];
        xy += n[0][j] * n[1][j];
        yy += n[1][j] * n[1][j];
    }
    double c0 = n[0][1] * n[1][2] - n[0][2] * n[1][1], c1 = n[0][2] * n[1][0] - n[0][0] * n[1][2];
    double c2 = n[0][0] * n[1][1] - n[0][1] * n[1][0];
    double det = c0 * c0 + c1 * c1 + c2 * c2 + .3 * (xx + yy) - .09;
    if (!(xx + yy < 1e18))
        return 0;
    o->a = yy / det;
    o->b = -xy / det;
    o->c = xx / det;
    double half = (xx - yy) / 2, root = sqrt(fmax(.01, half * half + xy * xy));
    double rad = ceil(3 * sqrt((xx + yy) / 2 + root));
    if (o->u + rad <= 0 || o->u - rad >= c->w || o->v + rad <= 0 || o->v - rad >= c->h)
        return 0;
    o->tx0 = (int)ref_clamp(floor((o->u - rad) / 16), 0, nx);
    o->tx1 = (int)ref_clamp(ceil((o->u + rad) / 16), 0, nx);
    o->ty0 = (int)ref_clamp(floor((o->v - rad) / 16), 0, ny);
    o->ty1 = (int)ref_clamp(ceil((o->v + rad) / 16), 0, ny);
    return 1;
}

static inline void ref_colour(const struct ref_splat *s, int degree, const double centre[3],
                              double rgb[3])
{
    double d[3], len = 0, b[25];
    for (int i = 0; i < 3; i++) {
        d[i] = s->p[i] - centre[i];
        len += d[i] * d[i];
    }
    for (int i = 0; i < 3; i++)
        d[i] /= sqrt(len);
    ref_sh(degree, d, b);
    for (int k = 0; k < 3; k++) {
        double l = 0;
        for (int i = 0; i < (degree + 1) * (degree + 1); i++)
            l += b[i] * s->p[11 + 3 * i + k];
        rgb[k] = exp(ref_clamp(l, -60, 60));
    }
}

/* 0 if the splat is not drawn. */
static inline int ref_project(const struct ref_splat *s, int degree, const struct ref_camera *c,
                              struct ref_2d *o)
{
    double p[3], n[2][3], centre[3];
    for (int i = 0; i < 11 + 3 * (degree + 1) * (degree + 1); i++)
        if (!isfinite(s->p[i]))
            return 0;
    for (int i = 0; i < 3; i++) {
        p[i] = c->t[i];
        centre[i] = 0;
        for (int j = 0; j < 3; j++) {
            p[i] += c->r[3 * i + j] * s->p[j];
            centre[i] -= c->r[3 * j + i] * c->t[j];
        }
    }
    if (p[2] < 1e-10 || p[2] > 1e10)
        return 0;
    o->u = c->fx * p[0] / p[2] + c->cx;
    o->v = c->fy * p[1] / p[2] + c->cy;
    o->z = p[2];
    o->o = 1 / (1 + exp(-s->p[10]));
    if (c->reach * c->reach * ref_factor(s, c, p, n) > p[2] * p[2] || !ref_footprint(c, n, o))
        return 0;
    ref_colour(s, degree, centre, o->rgb);
    return 1;
}

static inline int ref_nearer(const void *pa, const void *pb)
{
    const struct ref_2d *a = pa, *b = pb;
    float za = (float)a->z, zb = (float)b->z;
    return za < zb ? -1 : za > zb ? 1 : a->index - b->index;
}

/* 0 where the splat does not reach the pixel. */
static inline double ref_alpha(const struct ref_2d *g, int x, int y)
{
    if (x / 16 < g->tx0 || x / 16 >= g->tx1 || y / 16 < g->ty0 || y / 16 >= g->ty1)
        return 0;
    double dx = g->u - (x + .5), dy = g->v - (y + .5);
    double sigma = .5 * (g->a * dx * dx + g->c * dy * dy) + g->b * dx * dy;
    if (sigma < 0 || sigma > 6) // e^-6 < 1/255
        return 0;
    double alpha = fmin(.999, g->o * exp(-sigma));
    return alpha < 1 / 255. ? 0 : alpha;
}

/* A camera and splats of the program; reach: as in struct ref_camera. */
static inline struct ref_camera ref_camera_of(const struct camera *cam, double reach)
{
    struct ref_camera c = {.fx = (double)cam->fx,
                           .fy = (double)cam->fy,
                           .cx = (double)cam->cx,
                           .cy = (double)cam->cy,
                           .w = cam->w,
                           .h = cam->h,
                           .reach = reach};
    double q[4];
    for (int k = 0; k < 4; k++)
        q[k] = (double)cam->q[k];
    ref_rotation(q, c.r);
    for (int k = 0; k < 3; k++)
        c.t[k] = (double)cam->t[k];
    return c;
}

static inline void ref_splats_of(const struct gaussians *g, struct ref_splat *out)
{
    for (int i = 0; i < g->n; i++)
        for (int p = 0; p < gaussians_planes(g->degree); p++)
            out[i].p[p] = (double)g->plane[p][i];
}

/* The n splats front to back. out: r, g, b, depth, alpha. */
static inline void ref_blend(const struct ref_2d *g, int n, int x, int y, double out[5])
{
    double t = 1;
    memset(out, 0, 5 * sizeof *out);
    for (int i = 0; i < n; i++, g++) {
        double alpha = ref_alpha(g, x, y);
        if (alpha == 0)
            continue;
        if (t * (1 - alpha) <= 1e-4)
            break;
        for (int k = 0; k < 3; k++)
            out[k] += g->rgb[k] * alpha * t;
        out[3] += g->z * alpha * t;
        t *= 1 - alpha;
    }
    out[4] = 1 - t;
}

/* out: per pixel r, g, b, depth, alpha: (h, w, 5). */
static inline void ref_render(const struct ref_splat *s, int n, int degree,
                              const struct ref_camera *c, const double bg[3], double *out)
{
    struct ref_2d *v = calloc((size_t)n + 1, sizeof *v);
    int m = 0;
    for (int i = 0; v && i < n; i++)
        if (ref_project(&s[i], degree, c, &v[m]))
            v[m++].index = i;
    qsort(v, (size_t)m, sizeof *v, ref_nearer);
    for (int i = 0; i < c->w * c->h; i++) {
        double *px = out + 5 * i;
        ref_blend(v, m, i % c->w, i / c->w, px);
        for (int k = 0; k < 3; k++)
            px[k] += (1 - px[4]) * bg[k];
    }
    free(v);
}

#endif
