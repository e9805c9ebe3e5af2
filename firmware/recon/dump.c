#include "firmware/recon/dump.h"

#include "firmware/result/draw.h"

#include "core/base/gaussians.h"
#include "core/base/rotation.h"
#include "core/net/tap.h"
#include "core/photo/prep.h"
#include "core/splat/raster.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { EXTRA = 4, COLOURS = 3 };

static const float MU = 5000; // core/photo/README.md 6

static size_t padded_bytes(size_t n)
{
    return n < 16 ? 16 : (n + 15) / 16 * 16;
}

err_t dump_views(const struct run *r, const struct views *v)
{
    const size_t values = 3 * (size_t)v->size * (size_t)v->size, mark = arena_mark(r->tmp);
    float *px;
    if (!tap_on(r))
        return OK;
    err_t e = arena_alloc(r->tmp, values, sizeof *px, &px);
    for (int i = 0; i < v->n && !e; i++) {
        prep_to_float(v->rgb + values * (size_t)i, v->size, px);
        tap_put(r, &(struct tap_tensor){.name = "input.image",
                                        .rank = 5,
                                        .shape = {1, v->n, 3, v->size, v->size},
                                        .part = i,
                                        .parts = v->n,
                                        .data = px});
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- Gaussians ---- */

/* (1, n, k) of which this is piece `part`; value k of Gaussian i lies at data[k step + i]. */
struct list {
    const char *prefix;
    int n, part, parts;
    size_t step;
};

static void put_tensor(const struct run *r, const struct list *l, const char *name, int k,
                       const float *data)
{
    char full[32];
    snprintf(full, sizeof full, "%s.%s", l->prefix, name);
    tap_put(r, &(struct tap_tensor){.name = full,
                                    .rank = k > 1 ? 3 : 2,
                                    .shape = {1, l->n, k},
                                    .part = l->part,
                                    .parts = l->parts,
                                    .data = data,
                                    .stride = {l->step, 1, l->step}});
}

/* The tensors that pix.* and vox.* share. g: by voxel_adapt, so its planes are l->step apart.
 * scratch: (4, l->step). */
static void put_gaussians(const struct run *r, const struct list *l, const struct gaussians *g,
                          float *scratch)
{
    char full[32];
    for (int i = 0; i < g->n; i++)
        scratch[i] = 1 / (1 + expf(-g->plane[G_LOGIT][i]));
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < g->n; i++)
            scratch[(size_t)(k + 1) * l->step + (size_t)i] = expf(g->plane[G_LOG_SCALE + k][i]);
    put_tensor(r, l, "opacities", 1, scratch);
    put_tensor(r, l, "scales", 3, scratch + l->step);
    put_tensor(r, l, "rotations", 4, g->plane[G_QUAT + 1]); // x,y,z,w
    snprintf(full, sizeof full, "%s.harmonics", l->prefix);
    tap_put(r, &(struct tap_tensor){.name = full,
                                    .rank = 4,
                                    .shape = {1, l->n, COLOURS, SH_COEFS_MAX},
                                    .part = l->part,
                                    .parts = l->parts,
                                    .data = g->plane[G_SH],
                                    .stride = {0, 1, SH_COEFS_MAX * l->step, l->step}});
}

/* The Gaussians of one view, as if no two shared a cell. */
static err_t put_pixels(const struct run *r, const struct prediction *p, int view, float *work)
{
    const int pixels = p->geom.size * p->geom.size;
    const size_t n = (size_t)pixels, cap = padded_bytes(n), all = (size_t)p->n;
    struct voxels v = {.n = pixels, .cap = (int)cap, .points = work, .features = work + 3 * cap};
    struct list l = {"pix", p->n, view, p->geom.n_views, cap};
    struct gaussians g;
    for (size_t k = 0; k < VOXEL_FEATURES; k++)
        memcpy(v.features + k * cap, p->features + k * all + n * (size_t)view, n * sizeof(float));
    err_t e = voxel_adapt(r, &v, &g);
    if (!e)
        put_gaussians(r, &l, &g, work + (3 + VOXEL_FEATURES) * cap);
    return e;
}

static void put_cameras(const struct run *r, const struct geometry *g)
{
    const float side = (float)g->size;
    for (int i = 0; i < g->n_views; i++) {
        const struct camera *c = &g->cams[i];
        float m[9], c2w[16] = {0};
        const float k[9] = {c->fx / side, 0, c->cx / side, 0, c->fy / side, c->cy / side, 0, 0, 1};
        rotation_from_unit(c->q, m);
        for (int a = 0; a < 3; a++) {
            for (int b = 0; b < 3; b++) {
                c2w[4 * a + b] = m[3 * b + a];
                c2w[4 * a + 3] -= m[3 * b + a] * c->t[b];
            }
        }
        c2w[15] = 1;
        tap_put(r, &(struct tap_tensor){.name = "camera.extrinsic_c2w",
                                        .rank = 4,
                                        .shape = {1, g->n_views, 4, 4},
                                        .part = i,
                                        .parts = g->n_views,
                                        .data = c2w});
        tap_put(r, &(struct tap_tensor){.name = "camera.intrinsic_norm",
                                        .rank = 4,
                                        .shape = {1, g->n_views, 3, 3},
                                        .part = i,
                                        .parts = g->n_views,
                                        .data = k});
    }
}

/* Mean distance of the points from the origin. */
static void put_scale(const struct run *r, const struct prediction *p)
{
    double sum = 0;
    for (size_t i = 0; i < (size_t)p->n; i++) {
        const float *x = p->points + 3 * i;
        sum += sqrt((double)x[0] * (double)x[0] + (double)x[1] * (double)x[1] +
                    (double)x[2] * (double)x[2]);
    }
    const float mean = (float)(sum / p->n);
    tap_put(r, &(struct tap_tensor){.name = "scene_scale", .rank = 1, .shape = {1}, .data = &mean});
}

static err_t layout_pixels(float **work, struct arena *tmp, int size)
{
    return arena_alloc(tmp, padded_bytes((size_t)size * (size_t)size),
                       (3 + VOXEL_FEATURES + 4) * sizeof **work, work);
}

err_t dump_prediction(const struct run *r, const struct prediction *p)
{
    const size_t mark = arena_mark(r->tmp);
    float *work;
    err_t e = OK;
    if (!tap_on(r))
        return OK;
    put_cameras(r, &p->geom);
    if (p->points)
        put_scale(r, p);
    if (!p->features)
        return OK;
    e = layout_pixels(&work, r->tmp, p->geom.size);
    for (int i = 0; i < p->geom.n_views && !e; i++)
        e = put_pixels(r, p, i, work);
    arena_reset(r->tmp, mark);
    return e;
}

void dump_cells(const struct run *r, const struct voxels *v)
{
    const size_t cap = (size_t)v->cap;
    if (!tap_on(r) || v->n == 0)
        return;
    tap_put(r, &(struct tap_tensor){
                   .name = "vox.index", .rank = 2, .shape = {v->n, 3}, .ints = v->key});
    tap_put(
        r, &(struct tap_tensor){.name = "vox.count", .rank = 1, .shape = {v->n}, .ints = v->count});
    tap_put(r, &(struct tap_tensor){.name = "vox.feats87",
                                    .rank = 2,
                                    .shape = {v->n, VOXEL_FEATURES},
                                    .data = v->features,
                                    .stride = {1, cap}});
    put_tensor(r, &(struct list){"vox", v->n, 0, 1, cap}, "extra", EXTRA,
               v->features + VOXEL_EXTRA * cap);
}

/* R diag(s^2) R^T of splat i, with s2 = 2 / (q q + 1e-8) (core/splat/README.md 6). */
static void covariance(const struct gaussians *g, int i, float out[9])
{
    const float w = g->plane[G_QUAT][i], x = g->plane[G_QUAT + 1][i], y = g->plane[G_QUAT + 2][i],
                z = g->plane[G_QUAT + 3][i];
    const float s = 2 / (w * w + x * x + y * y + z * z + 1e-8f);
    const float m[9] = {1 - s * (y * y + z * z), s * (x * y - z * w),     s * (x * z + y * w),
                        s * (x * y + z * w),     1 - s * (x * x + z * z), s * (y * z - x * w),
                        s * (x * z - y * w),     s * (y * z + x * w),     1 - s * (x * x + y * y)};
    float v[3];
    for (int k = 0; k < 3; k++)
        v[k] = expf(2 * g->plane[G_LOG_SCALE + k][i]);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            out[3 * a + b] = m[3 * a] * v[0] * m[3 * b] + m[3 * a + 1] * v[1] * m[3 * b + 1] +
                             m[3 * a + 2] * v[2] * m[3 * b + 2];
}

static err_t layout_gaussians(float **work, struct arena *tmp, int cap)
{
    return arena_alloc(tmp, (size_t)cap, 13 * sizeof **work, work);
}

err_t dump_gaussians(const struct run *r, const struct gaussians *g)
{
    const size_t cap = (size_t)g->cap, mark = arena_mark(r->tmp);
    const struct list l = {"vox", g->n, 0, 1, cap};
    float *work;
    if (!tap_on(r) || g->n == 0)
        return OK;
    err_t e = layout_gaussians(&work, r->tmp, g->cap);
    if (e)
        return e;
    put_tensor(r, &l, "means", 3, g->plane[G_MU]);
    put_gaussians(r, &l, g, work + 9 * cap);
    for (int i = 0; i < g->n; i++)
        covariance(g, i, work + 9 * (size_t)i);
    tap_put(r, &(struct tap_tensor){
                   .name = "vox.covariances", .rank = 4, .shape = {1, g->n, 3, 3}, .data = work});
    arena_reset(r->tmp, mark);
    return OK;
}

/* ---- a picture ---- */

/* Planes (k, size, size) become the tensor (size, size, k). */
static void put_map(const struct run *r, const char *name, int size, int k, const float *px)
{
    tap_put(r, &(struct tap_tensor){.name = name,
                                    .rank = k > 1 ? 3 : 2,
                                    .shape = {size, size, k},
                                    .data = px,
                                    .stride = {(size_t)size, 1, (size_t)size * (size_t)size}});
}

/* Blend the extra channels. The rasteriser blends exponentials, so the positive and the negative
 * part of each channel are drawn as colours of their own: out = positive - negative.
 * colour: (3, cap) scratch. */
static err_t draw_extra(const struct run *r, const struct dump_picture *p, struct draw *d,
                        float *colour, float *out)
{
    const size_t cap = (size_t)p->g->cap, pixels = (size_t)d->maps.w * (size_t)d->maps.h;
    struct scene s = {.g = *p->g, .tone = *p->tone};
    err_t e = OK;
    s.g.degree = 0;
    for (size_t i = 0; i < pixels * EXTRA; i++)
        out[i] = 1 - d->maps.alpha[i % pixels]; // the background
    for (size_t k = 0; k < COLOURS; k++)
        s.g.plane[G_SH + k] = colour + k * cap;
    for (size_t first = 0; first < 2 * EXTRA && !e; first += COLOURS) {
        for (size_t k = 0; k < COLOURS * cap; k++) {
            size_t part = first + k / cap, i = k % cap;
            float v = part < 2 * EXTRA && i < (size_t)p->g->n ? p->extra[part / 2 * cap + i] : 0;
            colour[k] = logf(fmaxf(part % 2 ? -v : v, 1e-30f)) / (float)SH_BASIS0;
        }
        e = draw_run(r, d, &s, p->cam);
        for (size_t i = 0; i < COLOURS * pixels && !e && first + i / pixels < 2 * EXTRA; i++) {
            size_t part = first + i / pixels;
            float v = d->maps.radiance[i];
            out[part / 2 * pixels + i % pixels] += part % 2 ? -v : v;
        }
    }
    return e;
}

static void put_preview(const struct run *r, struct draw *d)
{
    const size_t values = COLOURS * (size_t)d->maps.w * (size_t)d->maps.h;
    float top = 1e-6f;
    for (size_t i = 0; i < values; i++)
        top = fmaxf(top, d->maps.radiance[i]);
    for (size_t i = 0; i < values; i++)
        d->display.px[i] = logf(1 + MU * fminf(d->maps.radiance[i] / top, 1)) / logf(1 + MU);
    put_map(r, "render.preview_mu", d->maps.w, COLOURS, d->display.px);
}

static err_t draw_all(const struct run *r, const struct dump_picture *p, struct draw *d,
                      float *work)
{
    const int size = p->cam->w;
    const struct scene s = {.g = *p->g, .tone = *p->tone, .background = {1, 1, 1}};
    err_t e = draw_run(r, d, &s, p->cam);
    if (e)
        return e;
    put_map(r, "render.hdr", size, COLOURS, d->maps.radiance);
    put_map(r, "render.depth", size, 1, d->maps.depth);
    put_map(r, "render.alpha", size, 1, d->maps.alpha);
    put_preview(r, d);
    for (int i = 0; i < DUMP_EXPOSURES; i++) {
        char name[16];
        snprintf(name, sizeof name, "render.ldr%d", i);
        draw_display(d, NULL, p->log2t[i]);
        put_map(r, name, size, COLOURS, d->display.px);
    }
    float *extra = work + COLOURS * (size_t)p->g->cap;
    e = draw_extra(r, p, d, work, extra);
    if (!e)
        put_map(r, "render.extra", size, EXTRA, extra);
    return e;
}

static err_t layout_picture(struct draw *d, float **work, struct arena *tmp, int cap,
                            const int size[2])
{
    const size_t pixels = (size_t)size[0] * (size_t)size[1];
    err_t e = draw_init(d, tmp, cap, size[0], size[1]);
    return e ? e : arena_alloc(tmp, COLOURS * (size_t)cap + EXTRA * pixels, sizeof **work, work);
}

size_t dump_plan(int size, int cap)
{
    struct arena planes = arena_counter(), tmp = arena_counter();
    struct gaussians g;
    struct draw d;
    float *work;
    err_t e = gaussians_init(&g, &planes, cap, 0);
    if (!e)
        e = layout_pixels(&work, &tmp, size);
    arena_reset(&tmp, 0);
    if (!e)
        e = layout_gaussians(&work, &tmp, g.cap);
    arena_reset(&tmp, 0);
    if (!e)
        e = layout_picture(&d, &work, &tmp, g.cap, (int[2]){size, size});
    return e ? SIZE_MAX : tmp.peak;
}

err_t dump_picture(const struct run *r, const struct dump_picture *p)
{
    const size_t mark = arena_mark(r->tmp);
    struct draw d;
    float *work;
    if (!tap_on(r))
        return OK;
    err_t e = layout_picture(&d, &work, r->tmp, p->g->cap, (int[2]){p->cam->w, p->cam->h});
    if (!e)
        e = draw_all(r, p, &d, work);
    arena_reset(r->tmp, mark);
    return e;
}
