/* heads_ref.h - a tiny network with random inputs for the tests of its heads, and the operators of
 * core/net/README.md 1.1 in double precision, as plainly as they can be written. */
#ifndef NET_HEADS_REF_H
#define NET_HEADS_REF_H

#include "core/base/cpu.h"
#include "core/net/net.h"
#include "tests/unit/small_model.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

enum { REF_GRID = 3, REF_SIZE = REF_GRID * NET_PATCH, REF_VIEWS = 3, REF_NAMES = 96 };

/* A grid that is odd, widths that are no multiples of the panels. */
static const struct net_dims ref_dims = {
    .embed = 32,
    .heads = 2,
    .dino_depth = 1,
    .dino_heads = 2,
    .depth = 4,
    .keep = {0, 1, 2, 3},
    .cam_depth = 1,
    .cam_heads = 2,
    .depth_feat = 24,
    .gs_feat = 24,
    .depth_oc = {8, 12, 4, 20},
    .gs_oc = {12, 8, 16, 4},
    .hdr = 12,
    .size = REF_SIZE,
    .voxel = 0.1f,
    .gauss = true,
    .appearance = true,
};

static struct {
    struct small_model model;
    struct net net;
    struct kernels kernels;
    struct arena inputs, maps, keep, tmp; // maps: of the reference
    struct pool *pool;
    atomic_bool cancel;
    struct run r;
    struct views views;
    struct tokens tokens;
    uint32_t rng;
} ref;

static inline float ref_uniform(void)
{
    ref.rng = ref.rng * 1664525u + 1013904223u;
    return (float)(ref.rng >> 8) * 0x1p-23f - 1;
}

static inline float *ref_random(size_t n, float scale)
{
    float *p;
    assert_int_equal(arena_alloc(&ref.inputs, n, sizeof *p, &p), OK);
    for (size_t i = 0; i < n; i++)
        p[i] = scale * ref_uniform();
    return p;
}

/* Random tokens and pictures; exposures a stop and a half apart. */
static inline void ref_inputs(void)
{
    static float log2t[REF_VIEWS] = {-1, 0.5f, 2};
    int m = REF_GRID * REF_GRID, c = ref.net.d.embed;
    ref.tokens = (struct tokens){.n_views = REF_VIEWS,
                                 .grid = REF_GRID,
                                 .n_tokens = NET_SPECIAL + m,
                                 .embed = c,
                                 .n_own = REF_VIEWS};
    size_t n = (size_t)REF_VIEWS * (size_t)(NET_SPECIAL + m) * (size_t)c;
    for (int k = 0; k < NET_KEEP; k++)
        ref.tokens.keep[k] = ref_random(2 * n, 1);
    ref.tokens.q = ref_random(n, 3);
    ref.tokens.k = ref_random(n, 3);
    size_t px = 3 * REF_VIEWS * REF_SIZE * REF_SIZE;
    ref.views = (struct views){.n = REF_VIEWS, .size = REF_SIZE, .log2t = log2t, .mid_log2t = 0.5f};
    assert_int_equal(arena_alloc(&ref.inputs, px, 1, &ref.views.rgb), OK);
    for (size_t i = 0; i < px; i++)
        ref.views.rgb[i] = (uint8_t)(128 + 127 * ref_uniform());
}

static inline void ref_open(const struct net_dims *d, enum precision precision, int threads)
{
    memset(&ref, 0, sizeof ref);
    small_model_init(&ref.model, d, precision);
    assert_int_equal(net_bind(&ref.model.model, 0, &ref.net), OK);
    kernels_init(&ref.kernels, cpu_detect());
    assert_int_equal(pool_open(&ref.pool, threads), OK);
    assert_int_equal(arena_init(&ref.inputs, "inputs", 8 << 20), OK);
    assert_int_equal(arena_init(&ref.maps, "maps", 64 << 20), OK);
    ref.r = (struct run){.k = &ref.kernels,
                         .pool = ref.pool,
                         .keep = &ref.keep,
                         .tmp = &ref.tmp,
                         .cancel = &ref.cancel};
    ref_inputs();
}

/* Bytes that a stage may use. */
static inline void ref_arenas(size_t keep, size_t tmp)
{
    assert_int_equal(arena_init(&ref.keep, "keep", keep), OK);
    assert_int_equal(arena_init(&ref.tmp, "tmp", tmp), OK);
}

static inline void ref_close(void)
{
    pool_close(ref.pool);
    arena_free(&ref.inputs);
    arena_free(&ref.maps);
    arena_free(&ref.keep);
    arena_free(&ref.tmp);
    small_model_free(&ref.model);
}

/* ---- operators ---- */

struct ref_map { // channels last
    int h, w, c;
    double *px;
};

static inline double *ref_doubles(size_t n)
{
    double *p;
    assert_int_equal(arena_zalloc(&ref.maps, n, sizeof *p, &p), OK);
    return p;
}

static inline struct ref_map ref_new(int h, int w, int c)
{
    return (struct ref_map){h, w, c, ref_doubles((size_t)(h * w * c))};
}

static inline double *ref_at(const struct ref_map *m, int y, int x)
{
    return m->px + (size_t)((y * m->w + x) * m->c);
}

static inline struct ref_map ref_floats(const float *px, int h, int w, int c)
{
    struct ref_map m = ref_new(h, w, c);
    for (int i = 0; i < h * w * c; i++)
        m.px[i] = px[i];
    return m;
}

/* Values of tensor HEAD.NAME in the order of the checkpoint; NULL if the network has none. */
static inline float *ref_tensor(const char *head, const char *name, struct tensor_spec *spec)
{
    char full[4 * REF_NAMES];
    snprintf(full, sizeof full, "encoder.%s%s", head, name);
    const struct model_tensor *t = model_find(&ref.model.model, full);
    if (!t)
        return NULL;
    *spec = t->spec;
    float *p;
    assert_int_equal(arena_alloc(&ref.maps, table_count(spec), sizeof *p, &p), OK);
    hashed_fill(spec, 1, 0, table_count(spec), p);
    return p;
}

static inline float *ref_part(const char *head, const char *layer, const char *part,
                              struct tensor_spec *spec)
{
    char name[2 * REF_NAMES];
    snprintf(name, sizeof name, "%s.%s", layer, part);
    return ref_tensor(head, name, spec);
}

/* One output of a convolution; w: (c, edge, edge). */
static inline double ref_dot(const struct ref_map *in, const float *w, int edge, int y, int x)
{
    double sum = 0;
    for (int i = 0; i < edge * edge; i++) {
        int v = y + i / edge, u = x + i % edge;
        for (int c = 0; c < in->c && v >= 0 && v < in->h && u >= 0 && u < in->w; c++)
            sum += ref_at(in, v, u)[c] * (double)w[c * edge * edge + i];
    }
    return sum;
}

/* Convolution or, with a tensor of rank 2, a product per pixel. */
static inline struct ref_map ref_conv(const struct ref_map *in, const char *head, const char *layer,
                                      int stride, int pad)
{
    struct tensor_spec s, ignored;
    const float *w = ref_part(head, layer, "weight", &s);
    const float *bias = ref_part(head, layer, "bias", &ignored);
    assert_non_null(w);
    int edge = s.rank == 4 ? s.shape[2] : 1;
    assert_int_equal(s.shape[1], in->c);
    struct ref_map out = ref_new((in->h + 2 * pad - edge) / stride + 1,
                                 (in->w + 2 * pad - edge) / stride + 1, s.shape[0]);
    size_t one = (size_t)(in->c * edge * edge);
    for (int y = 0; y < out.h; y++)
        for (int x = 0; x < out.w; x++)
            for (int o = 0; o < out.c; o++)
                ref_at(&out, y, x)[o] =
                    (bias ? bias[o] : 0) +
                    ref_dot(in, w + (size_t)o * one, edge, y * stride - pad, x * stride - pad);
    return out;
}

/* Transposed convolution with stride = kernel. */
static inline struct ref_map ref_spread(const struct ref_map *in, const char *head,
                                        const char *layer)
{
    struct tensor_spec s, ignored;
    const float *w = ref_part(head, layer, "weight", &s);
    const float *bias = ref_part(head, layer, "bias", &ignored);
    int up = s.shape[2], n = s.shape[1];
    struct ref_map out = ref_new(in->h * up, in->w * up, n);
    for (int i = 0; i < out.h * out.w * n; i++) {
        int y = i / n / out.w, x = i / n % out.w, o = i % n;
        out.px[i] = bias[o];
        for (int c = 0; c < in->c; c++)
            out.px[i] += ref_at(in, y / up, x / up)[c] *
                         (double)w[((c * n + o) * up + y % up) * up + x % up];
    }
    return out;
}

static inline struct ref_map ref_relu(struct ref_map m)
{
    for (int i = 0; i < m.h * m.w * m.c; i++)
        m.px[i] = fmax(m.px[i], 0);
    return m;
}

/* a += scale b. */
static inline void ref_add(struct ref_map *a, const struct ref_map *b, double scale)
{
    assert_true(a->h == b->h && a->w == b->w && a->c == b->c);
    for (int i = 0; i < a->h * a->w * a->c; i++)
        a->px[i] += scale * b->px[i];
}

static inline double ref_source(int i, int in, int out, bool align)
{
    if (align)
        return out > 1 ? (double)i * (in - 1) / (out - 1) : 0;
    return fmax((i + 0.5) * in / out - 0.5, 0);
}

static inline struct ref_map ref_resize_to(const struct ref_map *in, int h, int w, bool align)
{
    struct ref_map out = ref_new(h, w, in->c);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            double v = ref_source(y, in->h, h, align), u = ref_source(x, in->w, w, align);
            int y0 = (int)v, x0 = (int)u;
            int y1 = y0 + 1 < in->h ? y0 + 1 : y0, x1 = x0 + 1 < in->w ? x0 + 1 : x0;
            for (int c = 0; c < in->c; c++)
                ref_at(&out, y, x)[c] = (1 - (v - y0)) * ((1 - (u - x0)) * ref_at(in, y0, x0)[c] +
                                                          (u - x0) * ref_at(in, y0, x1)[c]) +
                                        (v - y0) * ((1 - (u - x0)) * ref_at(in, y1, x0)[c] +
                                                    (u - x0) * ref_at(in, y1, x1)[c]);
        }
    return out;
}

static inline struct ref_map ref_resize(const struct ref_map *in, int edge, bool align)
{
    return ref_resize_to(in, edge, edge, align);
}

/* Layer norm over the channels, eps 1e-5. */
static inline struct ref_map ref_norm(const struct ref_map *in, const char *head, const char *layer)
{
    struct tensor_spec s;
    const float *g = ref_part(head, layer, "weight", &s), *b = ref_part(head, layer, "bias", &s);
    struct ref_map out = ref_new(in->h, in->w, in->c);
    for (int i = 0; i < in->h * in->w; i++) {
        const double *x = in->px + i * in->c;
        double mean = 0, var = 0;
        for (int c = 0; c < in->c; c++)
            mean += x[c] / in->c;
        for (int c = 0; c < in->c; c++)
            var += (x[c] - mean) * (x[c] - mean) / in->c;
        for (int c = 0; c < in->c; c++)
            out.px[i * in->c + c] = (x[c] - mean) / sqrt(var + 1e-5) * g[c] + b[c];
    }
    return out;
}

/* Position code of core/net/README.md 2.5 on a square map. */
static inline double ref_code(int n, int channels, int y, int x, int c)
{
    int quarter = channels / 4, kind = c / quarter;
    double u = (2.0 * (kind < 2 ? x : y) - (n - 1)) / (n * sqrt(2.0));
    double a = u * pow(100, -(double)(c % quarter) / quarter);
    return kind % 2 == 0 ? sin(a) : cos(a);
}

static inline void ref_add_code(struct ref_map *m)
{
    for (int y = 0; y < m->h; y++)
        for (int x = 0; x < m->w; x++)
            for (int c = 0; c < m->c; c++)
                ref_at(m, y, x)[c] += 0.1 * ref_code(m->w, m->c, y, x, c);
}

/* ---- the DPT trunk, as core/net/README.md 2.5 tells it ---- */

static inline void ref_unit(struct ref_map *x, const char *head, int level, int unit)
{
    char conv1[REF_NAMES], conv2[REF_NAMES];
    snprintf(conv1, sizeof conv1, ".scratch.refinenet%d.resConfUnit%d.conv1", level, unit);
    snprintf(conv2, sizeof conv2, ".scratch.refinenet%d.resConfUnit%d.conv2", level, unit);
    ref_relu(*x);
    struct ref_map a = ref_relu(ref_conv(x, head, conv1, 1, 1));
    struct ref_map b = ref_conv(&a, head, conv2, 1, 1);
    ref_add(x, &b, 1);
}

/* Map of kept layer k of a view. */
static inline struct ref_map ref_features(const char *head, int view, int k)
{
    char project[REF_NAMES], resize[REF_NAMES], rn[REF_NAMES];
    int m = REF_GRID * REF_GRID, c = 2 * ref.tokens.embed;
    const float *from = ref.tokens.keep[k] + (view * (m + NET_SPECIAL) + NET_SPECIAL) * c;
    struct ref_map x = ref_floats(from, REF_GRID, REF_GRID, c);
    snprintf(project, sizeof project, ".projects.%d", k);
    snprintf(resize, sizeof resize, ".resize_layers.%d", k);
    snprintf(rn, sizeof rn, ".scratch.layer%d_rn", k + 1);
    x = ref_norm(&x, head, ".norm");
    x = ref_conv(&x, head, project, 1, 0);
    ref_add_code(&x);
    if (k < 2)
        x = ref_spread(&x, head, resize);
    else if (k == 3)
        x = ref_conv(&x, head, resize, 2, 1);
    return ref_conv(&x, head, rn, 1, 1);
}

/* Up to step 5. */
static inline struct ref_map ref_trunk(const char *head, int view)
{
    struct ref_map o = {0};
    for (int k = NET_KEEP - 1; k >= 0; k--) {
        char out_conv[REF_NAMES];
        struct ref_map l = ref_features(head, view, k);
        if (k == NET_KEEP - 1) {
            o = l;
        } else {
            ref_unit(&l, head, k + 1, 1);
            ref_add(&o, &l, 1);
        }
        ref_unit(&o, head, k + 1, 2);
        snprintf(out_conv, sizeof out_conv, ".scratch.refinenet%d.out_conv", k + 1);
        o = ref_resize(&o, k == 0 ? 2 * o.h : REF_GRID * (k == 1 ? 4 : k == 2 ? 2 : 1), true);
        o = ref_conv(&o, head, out_conv, 1, 0);
    }
    return ref_conv(&o, head, ".scratch.output_conv1", 1, 1);
}

/* ---- comparing ---- */

/* rms of the difference over rms of `want`. */
static inline double ref_apart(const float *got, const double *want, size_t n)
{
    double error = 0, size = 0;
    for (size_t i = 0; i < n; i++) {
        error += ((double)got[i] - want[i]) * ((double)got[i] - want[i]);
        size += want[i] * want[i];
    }
    return sqrt(error / (size > 0 ? size : 1));
}

static inline bool ref_finite(const float *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!isfinite(p[i]))
            return false;
    return true;
}

#endif
