/* From the coarsest level to the finest: patch tokens of a kept layer are normalised, projected,
 * given a position code and brought to the level's edge; then they are joined with the coarser
 * levels by residual units (Ranftl et al. 2021, "Vision Transformers for Dense Prediction").
 *
 * Two facts save memory and time. The residual unit adds relu(x), not x, because the reference's
 * ReLU works in place (core/net/README.md 2.5), so maps are stored after their ReLU. The 1x1
 * convolution after an upsampling is computed before it, since weights of an interpolation sum to
 * one. */
#include "core/net/dpt.h"

#include "core/base/num.h"
#include "core/net/tap.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { FINEST = 0, COARSEST = NET_KEEP - 1, NAME = 32 };

#define NORM_EPS 1e-5f // core/net/README.md 2.5

struct trunk {
    const struct run *r;
    const struct dpt_job *j;
    bool floats;
    int feat, grid;
};

/* Pixels per patch edge of a level; the coarsest has half as many as the grid, rounded up. */
static int level_up(int k)
{
    return k == 0 ? 4 : k == 1 ? 2 : 1;
}

static int level_edge(int grid, int k)
{
    return k == COARSEST ? (grid + 1) / 2 : grid * level_up(k);
}

static size_t pixels_of_square(int edge)
{
    return (size_t)edge * (size_t)edge;
}

/* ---- position code and blending ---- */

void dpt_code(int n, int channels, float *out)
{
    int m = channels / 4;
    for (int j = 0; j < n; j++, out += 2 * m) {
        double u = (2.0 * j - (n - 1)) / (n * sqrt(2.0));
        for (int i = 0; i < m; i++) {
            double a = u * pow(100, -(double)i / m);
            out[i] = 0.1f * (float)sin(a);
            out[m + i] = 0.1f * (float)cos(a);
        }
    }
}

static void add_code(const float *code, int channels, int y, int x, float *px)
{
    size_t half = (size_t)channels / 2;
    const float *cx = code + (size_t)x * half, *cy = code + (size_t)y * half;
    for (size_t c = 0; c < half; c++) {
        px[c] += cx[c];
        px[half + c] += cy[c];
    }
}

void dpt_blend_fetch(const void *ctx, int y, int x, int n, float *restrict out)
{
    const struct dpt_blend *b = ctx;
    size_t c = (size_t)b->map.c;
    layer_resize_fetch(&b->map, y, x, n, out);
    if (b->plus) {
        const float *plus = b->plus + ((size_t)y * (size_t)b->map.out_w + (size_t)x) * c;
        for (size_t i = 0; i < (size_t)n * c; i++)
            out[i] += plus[i];
    }
    for (int i = 0; b->code && i < n; i++)
        add_code(b->code, b->map.c, y, x + i, out + (size_t)i * c);
}

/* ---- tokens of a layer to a map ---- */

struct project {
    const struct trunk *t;
    int k;
    struct layer_workspace *rooms;
    float *rows; // per worker (LAYER_ROWS, width) after the norm
    float *out;  // (grid^2, oc)
};

static int token_width(const struct trunk *t)
{
    return 2 * t->j->tokens->embed;
}

static err_t project_chunk(void *ctx, int chunk, int worker)
{
    const struct project *p = ctx;
    const struct dpt_job *j = p->t->j;
    const struct tokens *tokens = j->tokens;
    size_t width = (size_t)token_width(p->t);
    int first = chunk * LAYER_ROWS, left = p->t->grid * p->t->grid - first;
    const struct norm norm = {(int)width, NORM_EPS, j->w->norm_g, j->w->norm_b};
    const struct weight *w = j->w->project + p->k;
    const struct layer_in in = {p->rows + (size_t)worker * LAYER_ROWS * width, width,
                                num_min(left, LAYER_ROWS), p->t->floats};
    const struct layer_out out = {.out = p->out + (size_t)first * (size_t)w->n,
                                  .ldo = (size_t)w->n};
    size_t from =
        (size_t)(j->view - tokens->first) * (size_t)tokens->n_tokens + NET_SPECIAL + (size_t)first;
    for (int i = 0; i < in.m; i++)
        p->t->r->k->net.norm(&norm, tokens->keep[p->k] + (from + (size_t)i) * width,
                             p->rows + ((size_t)worker * LAYER_ROWS + (size_t)i) * width);
    layer_rows(&p->t->r->k->net, w, &in, &out, p->rooms + worker);
    return run_check(p->t->r, "network");
}

static int chunks_of(int rows)
{
    return (rows + LAYER_ROWS - 1) / LAYER_ROWS;
}

static void tap_level(const struct trunk *t, const char *what, int k, const int hwc[3],
                      const float *px)
{
    char name[NAME];
    if (k < 0)
        snprintf(name, sizeof name, "%s.%s", t->j->head, what);
    else
        snprintf(name, sizeof name, "%s.%s%d", t->j->head, what, k);
    tap_map(t->r, name, t->j->view, t->j->tokens->n_views, hwc, px);
}

static err_t layout_map(float **px, struct arena *tmp, int edge, int channels)
{
    return arena_alloc(tmp, pixels_of_square(edge) * (size_t)channels, sizeof **px, px);
}

static err_t layout_project(struct project *p, float **code, struct arena *tmp,
                            const struct weight *w, const int grid_threads[2])
{
    const size_t width = (size_t)weight_k(w), threads = (size_t)grid_threads[1];
    err_t e = layer_workspaces_init(tmp, grid_threads[1], (int)width, &p->rooms);
    if (!e)
        e = arena_alloc(tmp, threads * LAYER_ROWS * width, sizeof(float), &p->rows);
    return e ? e
             : arena_alloc(tmp, (size_t)grid_threads[0] * (size_t)w->n / 2, sizeof **code, code);
}

/* Projected tokens with their position code. out: (grid, grid, oc). */
static err_t project_tokens(const struct trunk *t, int k, float *out)
{
    struct project p = {.t = t, .k = k, .out = out};
    int m = t->grid * t->grid, n = t->j->w->project[k].n;
    size_t mark = arena_mark(t->r->tmp);
    float *code;
    err_t e = layout_project(&p, &code, t->r->tmp, t->j->w->project + k,
                             (int[2]){t->grid, pool_size(t->r->pool)});
    if (!e)
        e = pool_for(t->r->pool, chunks_of(m), project_chunk, &p);
    if (!e) {
        tap_level(t, "project", k, (int[]){t->grid, t->grid, n}, out);
        dpt_code(t->grid, n, code);
        for (int i = 0; i < m; i++)
            add_code(code, n, i / t->grid, i % t->grid, out + (size_t)i * (size_t)n);
    }
    arena_reset(t->r->tmp, mark);
    return e;
}

struct upsample {
    const struct trunk *t;
    struct weight w; // without bias: it has one entry per channel, not per output
    const float *bias;
    int up, channels;
    const float *in; // (grid^2, channels)
    float *out;      // (up grid, up grid, channels)
    struct layer_workspace *rooms;
    float *rows; // per worker (LAYER_ROWS, w.n)
};

/* Outputs of one token, (up, up, channels), to their pixels. */
static void upsample_token(const struct upsample *s, int token, const float *from)
{
    int y = token / s->t->grid * s->up, x = token % s->t->grid * s->up;
    size_t run = (size_t)s->up * (size_t)s->channels;
    for (int a = 0; a < s->up; a++, from += run) {
        size_t at = (size_t)(y + a) * (size_t)(s->up * s->t->grid) + (size_t)x;
        float *to = s->out + at * (size_t)s->channels;
        for (int b = 0, i = 0; b < s->up; b++)
            for (int c = 0; c < s->channels; c++, i++)
                to[i] = from[i] + s->bias[c];
    }
}

static err_t upsample_chunk(void *ctx, int chunk, int worker)
{
    const struct upsample *s = ctx;
    int first = chunk * LAYER_ROWS, left = s->t->grid * s->t->grid - first;
    size_t c = (size_t)s->channels, n = (size_t)s->w.n;
    float *rows = s->rows + (size_t)worker * LAYER_ROWS * n;
    const struct layer_in in = {s->in + (size_t)first * c, c, num_min(left, LAYER_ROWS),
                                s->t->floats};
    const struct layer_out out = {.out = rows, .ldo = n};
    layer_rows(&s->t->r->k->net, &s->w, &in, &out, s->rooms + worker);
    for (int i = 0; i < in.m; i++)
        upsample_token(s, first + i, rows + (size_t)i * n);
    return run_check(s->t->r, "network");
}

static err_t layout_spread(struct upsample *s, struct arena *tmp, int threads)
{
    err_t e = layer_workspaces_init(tmp, threads, s->channels, &s->rooms);
    return e ? e
             : arena_alloc(tmp, (size_t)threads * LAYER_ROWS * (size_t)s->w.n, sizeof(float),
                           &s->rows);
}

/* Transposed convolution with stride = kernel: a product per token. */
static err_t upsample_tokens(const struct trunk *t, int k, const float *in, float *out)
{
    const struct weight *w = t->j->w->resize + k;
    struct upsample s = {.t = t,
                         .w = *w,
                         .bias = w->bias,
                         .up = level_up(k),
                         .channels = t->j->w->oc[k],
                         .in = in,
                         .out = out};
    s.w.bias = NULL;
    size_t mark = arena_mark(t->r->tmp);
    err_t e = layout_spread(&s, t->r->tmp, pool_size(t->r->pool));
    if (!e)
        e = pool_for(t->r->pool, chunks_of(t->grid * t->grid), upsample_chunk, &s);
    arena_reset(t->r->tmp, mark);
    return e;
}

/* ---- convolutions ---- */

static struct layer_conv map_conv(const struct weight *w, int edge, int stride, const void *map)
{
    struct layer_conv c = conv_3x3(w, edge, edge, stride);
    c.fetch = layer_map_fetch;
    c.ctx = map;
    return c;
}

/* out:  (edge', edge', w->n), edge' = edge / stride rounded up. */
static err_t run_conv3x3(const struct trunk *t, const struct weight *w, int edge, int stride,
                         const float *px, const struct layer_out *out)
{
    const struct layer_map map = {px, edge, w->seg / 3, false};
    struct layer_conv c = map_conv(w, edge, stride, &map);
    c.floats = t->floats;
    return layer_conv_run(t->r, &c, out);
}

/* The level's own map at its edge, after the ReLU with which all of its readers begin.
 * out: (edge, edge, feat). */
static err_t level_features(const struct trunk *t, int k, float *out)
{
    const struct dpt_weights *w = t->j->w;
    int edge = level_edge(t->grid, k), oc = w->oc[k];
    size_t mark = arena_mark(t->r->tmp);
    float *flat, *full;
    err_t e = layout_map(&flat, t->r->tmp, t->grid, oc);
    if (!e)
        e = project_tokens(t, k, flat);
    full = flat;
    if (!e && edge != t->grid)
        e = layout_map(&full, t->r->tmp, edge, oc);
    if (!e && k == COARSEST)
        e = run_conv3x3(t, w->resize + k, t->grid, 2, flat,
                        &(struct layer_out){.out = full, .ldo = (size_t)oc});
    else if (!e && level_up(k) > 1)
        e = upsample_tokens(t, k, flat, full);
    if (!e) {
        tap_level(t, "resize", k, (int[]){edge, edge, oc}, full);
        e = run_conv3x3(t, w->rn + k, edge, 1, full,
                        &(struct layer_out){.out = out, .ldo = (size_t)t->feat, .act = ACT_RELU});
    }
    arena_reset(t->r->tmp, mark);
    return e;
}

/* x += conv2(relu(conv1(x))). x: (edge, edge, feat) >= 0; room: as large. */
static err_t residual_unit(const struct trunk *t, const struct rcu_weights *w, int edge, float *x,
                           float *room)
{
    size_t ldo = (size_t)t->feat;
    err_t e = run_conv3x3(t, &w->conv1, edge, 1, x,
                          &(struct layer_out){.out = room, .ldo = ldo, .act = ACT_RELU});
    if (!e)
        e = run_conv3x3(t, &w->conv2, edge, 1, room,
                        &(struct layer_out){.out = x, .ldo = ldo, .add = true});
    return e;
}

/* ---- levels ---- */

struct rows {
    const struct run *r;
    const struct dpt_blend *blend;
    bool relu;
    float *out; // (out_h, out_w, c)
};

static err_t blend_row(void *ctx, int y, int worker)
{
    const struct rows *s = ctx;
    const struct layer_resize *m = &s->blend->map;
    size_t n = (size_t)m->out_w * (size_t)m->c;
    float *out = s->out + (size_t)y * n;
    (void)worker;
    dpt_blend_fetch(s->blend, y, 0, m->out_w, out);
    for (size_t i = 0; s->relu && i < n; i++)
        out[i] = out[i] < 0 ? 0 : out[i]; // NaN stays
    return run_check(s->r, "network");
}

err_t dpt_blend_run(const struct run *r, const struct dpt_blend *b, bool relu, float *out)
{
    struct rows s = {r, b, relu, out};
    return pool_for(r->pool, b->map.out_h, blend_row, &s);
}

static struct layer_resize resize_of(const float *px, int edge, int c, int to)
{
    return (struct layer_resize){px, edge, edge, c, to, to, true};
}

/* The reference's tensor is the output of this level at the edge of the next one. */
static err_t tap_refined(const struct trunk *t, int k, const float *px)
{
    int edge = level_edge(t->grid, k), to = k == FINEST ? 2 * edge : level_edge(t->grid, k - 1);
    const struct dpt_blend b = {.map = resize_of(px, edge, t->feat, to)};
    size_t mark = arena_mark(t->r->tmp);
    float *full;
    if (!tap_on(t->r))
        return OK;
    err_t e = layout_map(&full, t->r->tmp, to, t->feat);
    if (!e)
        e = dpt_blend_run(t->r, &b, false, full);
    if (!e)
        tap_level(t, "refinenet", k + 1, (int[]){to, to, t->feat}, full);
    arena_reset(t->r->tmp, mark);
    return e;
}

/* coarse: result of the level before, NULL for the coarsest.
 * out:  (edge, edge, feat), before the upsampling; in r->tmp. */
static err_t run_level(const struct trunk *t, int k, const float *coarse, float **out)
{
    const struct dpt_weights *w = t->j->w;
    int edge = level_edge(t->grid, k);
    float *x, *room;
    err_t e = layout_map(&x, t->r->tmp, edge, t->feat);
    if (!e)
        e = level_features(t, k, x);
    if (!e)
        e = layout_map(&room, t->r->tmp, edge, t->feat);
    if (!e && coarse)
        e = residual_unit(t, w->unit1 + k, edge, x, room);
    if (!e && coarse) {
        const struct dpt_blend b = {
            .map = resize_of(coarse, level_edge(t->grid, k + 1), t->feat, edge), .plus = x};
        float *sum = room;
        e = dpt_blend_run(t->r, &b, true, sum);
        room = x;
        x = sum;
    }
    if (!e)
        e = residual_unit(t, w->unit2 + k, edge, x, room);
    if (!e)
        e = layer_run(t->r, w->out_conv + k,
                      &(struct layer_in){x, (size_t)t->feat, edge * edge, t->floats},
                      &(struct layer_out){.out = room, .ldo = (size_t)t->feat});
    if (!e)
        e = tap_refined(t, k, room);
    *out = e ? NULL : room;
    return e;
}

err_t dpt_run(const struct run *r, const struct dpt_job *j, float *out)
{
    const struct trunk t = {.r = r,
                            .j = j,
                            .floats = j->net->floats & NET_FLOAT_HEADS,
                            .feat = j->w->feat,
                            .grid = j->tokens->grid};
    size_t mark = arena_mark(r->tmp);
    float *px = NULL;
    err_t e = OK;
    for (int k = COARSEST; k >= FINEST && !e; k--)
        e = run_level(&t, k, px, &px);
    if (!e) {
        int edge = dpt_edge(t.grid), half = t.feat / 2;
        const struct dpt_blend b = {.map = resize_of(px, level_edge(t.grid, FINEST), t.feat, edge)};
        struct layer_conv c = map_conv(&j->w->output_conv1, edge, 1, &b);
        c.fetch = dpt_blend_fetch;
        c.floats = t.floats;
        e = layer_conv_run(r, &c, &(struct layer_out){.out = out, .ldo = (size_t)half});
        if (!e)
            tap_level(&t, "output_conv1", -1, (int[]){edge, edge, half}, out);
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- plan ---- */

static void plan_conv(struct plan *p, const struct weight *w, int edge, int stride)
{
    const struct layer_conv c = map_conv(w, edge, stride, NULL);
    layer_conv_plan(p, &c);
}

/* As `features` does. */
static err_t plan_features(struct plan *p, const struct dpt_weights *w, int grid, int k)
{
    const int edge = level_edge(grid, k);
    struct upsample s = {.w = w->resize[k], .channels = w->oc[k]};
    struct project project;
    float *px, *code;
    const size_t mark = arena_mark(&p->tmp);
    err_t e = layout_map(&px, &p->tmp, grid, w->oc[k]);
    const size_t flat = arena_mark(&p->tmp);
    e = e ? e
          : layout_project(&project, &code, &p->tmp, w->project + k, (int[2]){grid, p->threads});
    arena_reset(&p->tmp, flat);
    if (!e && edge != grid)
        e = layout_map(&px, &p->tmp, edge, w->oc[k]);
    const size_t full = arena_mark(&p->tmp);
    if (k == COARSEST)
        plan_conv(p, w->resize + k, grid, 2);
    else if (!e && level_up(k) > 1)
        e = layout_spread(&s, &p->tmp, p->threads);
    arena_reset(&p->tmp, full);
    plan_conv(p, w->rn + k, edge, 1);
    arena_reset(&p->tmp, mark);
    return e;
}

/* As `level` does. */
static err_t plan_level(struct plan *p, const struct dpt_weights *w, int grid, int k)
{
    const int edge = level_edge(grid, k), next = k == FINEST ? 2 * edge : level_edge(grid, k - 1);
    float *px;
    err_t e = layout_map(&px, &p->tmp, edge, w->feat);
    if (!e)
        e = plan_features(p, w, grid, k);
    if (!e)
        e = layout_map(&px, &p->tmp, edge, w->feat);
    plan_conv(p, &w->unit2[k].conv1, edge, 1);
    layer_plan(p, w->feat);
    const size_t mark = arena_mark(&p->tmp);
    if (!e)
        e = layout_map(&px, &p->tmp, next, w->feat); // if it is tapped
    arena_reset(&p->tmp, mark);
    return e;
}

void dpt_plan(struct plan *p, const struct dpt_weights *w, int grid)
{
    const size_t mark = arena_mark(&p->tmp);
    err_t e = OK;
    for (int k = COARSEST; k >= FINEST && !e; k--)
        e = plan_level(p, w, grid, k);
    plan_conv(p, &w->output_conv1, dpt_edge(grid), 1);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}
