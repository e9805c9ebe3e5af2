/* Per view: the trunk at 8 px per patch, resized to full size for a 3x3 convolution, then a product
 * per pixel. Its first output is the logarithm of the depth; the second, a confidence, is computed
 * only for a tap. */
#include "core/net/depth.h"

#include "core/base/rotation.h"
#include "core/net/dpt.h"
#include "core/net/finite.h"
#include "core/net/tap.h"

#include <math.h>

#define LOG_MAX 80.0f // bounds a depth and its inverse

struct tail {
    const struct run *r;
    const struct net *net;
    const struct tokens *t;
    int size, outputs; // outputs: 1, or 2 where the confidence is tapped
    struct weight last;
    float *trunk;  // (edge, edge, feat / 2)
    float *hidden; // (size, size, hidden)
    float *raw;    // (size, size, outputs)
};

static size_t pixel_count(int size)
{
    return (size_t)size * (size_t)size;
}

static struct layer_conv tail_conv(const struct net *net, int size, const struct dpt_blend *b)
{
    struct layer_conv c = conv_3x3(&net->depth_out.a, size, size, 1);
    c.fetch = dpt_blend_fetch;
    c.ctx = b;
    c.floats = net->floats & NET_FLOAT_HEADS;
    return c;
}

static err_t layout_code(float **code, struct arena *tmp, const struct net *net, int size)
{
    return arena_alloc(tmp, (size_t)size * (size_t)(net->depth.feat / 2) / 2, sizeof **code, code);
}

/* Trunk to raw outputs. */
static err_t run_tail(const struct tail *s)
{
    int edge = dpt_edge(s->t->grid), c = s->net->depth.feat / 2;
    struct dpt_blend b = {.map = {s->trunk, edge, edge, c, s->size, s->size, true}};
    size_t mark = arena_mark(s->r->tmp), hidden = (size_t)s->net->depth_out.a.n;
    float *code;
    err_t e = layout_code(&code, s->r->tmp, s->net, s->size);
    if (!e) {
        dpt_code(s->size, c, code);
        b.code = code;
        const struct layer_conv conv = tail_conv(s->net, s->size, &b);
        e = layer_conv_run(s->r, &conv,
                           &(struct layer_out){.out = s->hidden, .ldo = hidden, .act = ACT_RELU});
    }
    if (!e)
        e = layer_run(s->r, &s->last,
                      &(struct layer_in){s->hidden, hidden, s->size * s->size, true},
                      &(struct layer_out){.out = s->raw, .ldo = (size_t)s->outputs});
    arena_reset(s->r->tmp, mark);
    return e;
}

static float clamped_exp(float a)
{
    return expf(fminf(fmaxf(a, -LOG_MAX), LOG_MAX));
}

/* Overwrites the hidden map. */
static void tap_view(const struct tail *s, int view, const float *depth)
{
    int size = s->size, v = s->t->n_views;
    size_t n = pixel_count(size);
    float *conf = s->hidden;
    if (!tap_on(s->r))
        return;
    for (size_t i = 0; i < n; i++)
        conf[i] = 1 + clamped_exp(s->raw[i * (size_t)s->outputs + 1]);
    tap_map(s->r, "depth.raw", view, v, (int[]){size, size, s->outputs}, s->raw);
    tap_put(s->r, &(struct tap_tensor){.name = "depth.depth",
                                       .rank = 5,
                                       .shape = {1, v, size, size, 1},
                                       .part = view,
                                       .parts = v,
                                       .data = depth});
    tap_put(s->r, &(struct tap_tensor){.name = "depth.conf",
                                       .rank = 4,
                                       .shape = {1, v, size, size},
                                       .part = view,
                                       .parts = v,
                                       .data = conf});
}

static err_t run_view(const struct tail *s, int view, float *depth)
{
    const struct dpt_job j = {s->net, &s->net->depth, s->t, view, "depth"};
    err_t e = dpt_run(s->r, &j, s->trunk);
    if (!e)
        e = run_tail(s);
    if (!e)
        e = finite_check(s->r, "depth.raw", FINITE_MAX, s->raw,
                         pixel_count(s->size) * (size_t)s->outputs);
    if (e)
        return e;
    for (size_t i = 0; i < pixel_count(s->size); i++)
        depth[i] = clamped_exp(s->raw[i * (size_t)s->outputs]);
    tap_view(s, view, depth);
    if (s->r->progress)
        s->r->progress(s->r->progress_ctx, "depth", view - s->t->first + 1, s->t->n_own, NULL);
    return OK;
}

static int outputs_of(const struct run *r)
{
    return tap_on(r) ? 2 : 1;
}

static err_t layout(struct tail *s, struct arena *tmp, int grid)
{
    const size_t n = pixel_count(s->size), c = (size_t)s->net->depth.feat / 2;
    err_t e = arena_alloc(tmp, pixel_count(dpt_edge(grid)) * c, sizeof(float), &s->trunk);
    if (!e)
        e = arena_alloc(tmp, n * (size_t)s->net->depth_out.a.n, sizeof(float), &s->hidden);
    return e ? e : arena_alloc(tmp, n * (size_t)s->outputs, sizeof(float), &s->raw);
}

static err_t layout_result(struct geometry *g, struct arena *keep, int n_views, int size)
{
    return arena_alloc(keep, (size_t)n_views * pixel_count(size), sizeof *g->depth, &g->depth);
}

void depth_plan(struct plan *p, const struct net *net, int n_views, int size)
{
    const struct layer_conv conv = tail_conv(net, size, NULL);
    struct tail s = {.net = net, .size = size, .outputs = 2};
    struct geometry g;
    float *code;
    const int grid = size / NET_PATCH;
    const size_t mark = arena_mark(&p->tmp);
    err_t e = layout_result(&g, &p->keep, n_views, size);
    if (!e)
        e = layout(&s, &p->tmp, grid);
    dpt_plan(p, &net->depth, grid);
    if (!e)
        e = layout_code(&code, &p->tmp, net, size);
    layer_conv_plan(p, &conv);
    layer_plan(p, net->depth_out.a.n);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t depth_run(const struct run *r, const struct net *net, const struct tokens *t,
                struct geometry *io)
{
    struct tail s = {.r = r,
                     .net = net,
                     .t = t,
                     .size = io->size,
                     .outputs = outputs_of(r),
                     .last = net->depth_out.b};
    size_t n = pixel_count(io->size), mark = arena_mark(r->tmp);
    s.last.n = s.outputs;
    err_t e = layout_result(io, r->keep, t->n_views, io->size);
    if (!e)
        e = layout(&s, r->tmp, t->grid);
    for (int v = t->first; v < t->first + t->n_own && !e; v++)
        e = run_view(&s, v, io->depth + (size_t)v * n);
    arena_reset(r->tmp, mark);
    return e ? e : team_gather(r->team, io->depth, n * sizeof *io->depth, t->n_views);
}

void depth_unproject(const struct geometry *g, int view, float *points)
{
    const struct camera *cam = g->cams + view;
    const float *depth = g->depth + (size_t)view * pixel_count(g->size);
    double r[9];
    rotation_of_camera(cam, r);
    for (int j = 0; j < g->size; j++)
        for (int i = 0; i < g->size; i++, depth++, points += 3) {
            double d = *depth;
            const double p[3] = {((double)i - cam->cx) * d / cam->fx - cam->t[0],
                                 ((double)j - cam->cy) * d / cam->fy - cam->t[1], d - cam->t[2]};
            for (int k = 0; k < 3; k++)
                points[k] = (float)(r[k] * p[0] + r[3 + k] * p[1] + r[6 + k] * p[2]);
        }
}
