/* First layer: 14x14 stride 14, one output pixel per patch, of [guide | raw Gaussians | code]. In
 * packed weights the channels of one tap lie side by side, so the weights of each part are copied
 * out tap by tap. The code is constant over the view: its weights are summed over the kernel. */
#include "core/net/metanet.h"

#include "core/net/finite.h"
#include "core/net/layer.h"
#include "core/net/tap.h"

#include <math.h>
#include <string.h>

enum { TAPS = NET_PATCH * NET_PATCH, RAW = NET_RAW + NET_SENSITIVITY, CONFIDENCE = NET_RAW - 1 };

static size_t panels_of(const struct weight *w)
{
    return ((size_t)w->n + PANEL - 1) / PANEL;
}

static size_t element_bytes(const struct weight *w)
{
    return w->type == PRECISION_F32 ? 4 : w->type == PRECISION_BF16 ? 2 : 1;
}

static int channels_of(const struct net *net)
{
    return 2 * net->d.hdr + RAW;
}

static int grid_of(int size)
{
    return size / NET_PATCH;
}

/* ---- the first layer in parts ---- */

/* The part of the first layer for channels [first, first + n). */
static void split_weight(const struct net *net, int first, int n, void *room, struct weight *out)
{
    const struct weight *w = &net->meta.enc0;
    size_t one = element_bytes(w) * PANEL, run = (size_t)n * one,
           from = (size_t)channels_of(net) * one;
    unsigned char *to = room;
    *out = *w;
    out->seg = NET_PATCH * n;
    out->bias = NULL;
    out->panels = to;
    for (size_t i = 0; i < panels_of(w) * TAPS; i++, to += run)
        memcpy(to, (const unsigned char *)w->panels + i * from + (size_t)first * one, run);
}

static err_t layout_sum(float **one, double **sum, struct arena *tmp, const struct net *net)
{
    const size_t n = (size_t)net->d.hdr * PANEL;
    err_t e = arena_alloc(tmp, n, sizeof **one, one);
    return e ? e : arena_alloc(tmp, n, sizeof **sum, sum);
}

/* out: (panels, hdr, PANEL) weights of the exposure channels, summed over the kernel. */
static err_t sum_code(const struct run *r, const struct net *net, float *out)
{
    const struct weight *w = &net->meta.enc0;
    size_t d = (size_t)net->d.hdr, c = (size_t)channels_of(net), n = d * PANEL;
    size_t mark = arena_mark(r->tmp);
    float *one;
    double *sum;
    err_t e = layout_sum(&one, &sum, r->tmp, net);
    for (size_t p = 0; p < panels_of(w) && !e; p++) {
        memset(sum, 0, n * sizeof *sum);
        for (size_t i = 0; i < TAPS; i++) {
            size_t at = ((p * TAPS + i) * c + c - d) * PANEL;
            if (w->type == PRECISION_S8)
                r->k->net.unpack_s8((const int8_t *)w->panels + at, (int)d, one);
            else if (w->type == PRECISION_BF16)
                r->k->net.unpack_bf16((const uint16_t *)w->panels + at, (int)d, one);
            else
                memcpy(one, (const float *)w->panels + at, n * sizeof *one);
            for (size_t k = 0; k < n; k++)
                sum[k] += one[k];
        }
        for (size_t k = 0; k < n; k++) {
            size_t o = p * PANEL + k % PANEL;
            float scale = w->scale && o < (size_t)w->n ? w->scale[o] : 1;
            out[p * n + k] = scale * (float)sum[k];
        }
    }
    arena_reset(r->tmp, mark);
    return e;
}

struct parts {
    void *guide, *raw; // panels
};

static err_t layout(struct metanet *m, struct parts *parts, struct arena *tmp,
                    const struct net *net)
{
    const struct weight *w = &net->meta.enc0;
    const size_t d = (size_t)net->d.hdr, panels = panels_of(w), one = element_bytes(w) * PANEL;
    err_t e = arena_alloc(tmp, panels * d * PANEL, sizeof *m->code, &m->code);
    if (!e)
        e = arena_alloc(tmp, panels * TAPS, d * one, &parts->guide);
    return e ? e : arena_alloc(tmp, panels * TAPS, RAW * one, &parts->raw);
}

err_t metanet_init(const struct run *r, const struct net *net, struct metanet *out)
{
    const struct weight *w = &net->meta.enc0;
    int d = net->d.hdr;
    *out = (struct metanet){.net = net};
    if (w->rotate && (d % w->rotate || RAW % w->rotate))
        return err_fail(ERR_FORMAT,
                        "enc.0 is rotated by blocks of %d, which do not divide %d and %d",
                        w->rotate, d, RAW);
    struct parts parts;
    err_t e = layout(out, &parts, r->tmp, net);
    if (!e)
        e = sum_code(r, net, out->code);
    if (e)
        return e;
    split_weight(net, 0, d, parts.guide, &out->guide);
    split_weight(net, d, RAW, parts.raw, &out->raw);
    return OK;
}

void metanet_init_plan(struct plan *p, const struct net *net)
{
    struct metanet m;
    struct parts parts;
    float *one;
    double *sum;
    err_t e = layout(&m, &parts, &p->tmp, net);
    const size_t mark = arena_mark(&p->tmp);
    if (!e)
        e = layout_sum(&one, &sum, &p->tmp, net);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- one view ---- */

static struct layer_conv patch_conv(const struct net *net, const struct weight *w, int channels,
                                    int size, layer_fetch_fn *fetch)
{
    return (struct layer_conv){.w = w,
                               .kh = NET_PATCH,
                               .kw = NET_PATCH,
                               .stride = NET_PATCH,
                               .channels = channels,
                               .h = size,
                               .w_px = size,
                               .fetch = fetch,
                               .floats = net->floats & NET_FLOAT_HEADS};
}

static err_t layout_bias(float **bias, float **x, struct arena *tmp, const struct net *net)
{
    err_t e = arena_alloc(tmp, (size_t)net->meta.enc0.n, sizeof **bias, bias);
    return e ? e : arena_alloc(tmp, (size_t)net->d.hdr, sizeof **x, x);
}

/* bias + weights times the projected code. x: (hdr) scratch. */
static err_t fold_code(const struct run *r, const struct metanet *m, const float *code, float *x,
                       float *bias)
{
    const struct weight *w = &m->net->meta.enc0;
    size_t d = (size_t)m->net->d.hdr;
    err_t e = layer_run(r, &m->net->meta.exp_proj, &(struct layer_in){code, d, 1, true},
                        &(struct layer_out){.out = x, .ldo = d});
    if (e)
        return e;
    if (w->rotate)
        r->k->net.hadamard(x, (int)d, w->rotate);
    for (size_t o = 0; o < (size_t)w->n; o++) {
        const float *sums = m->code + o / PANEL * d * PANEL + o % PANEL;
        double sum = w->bias ? w->bias[o] : 0;
        for (size_t c = 0; c < d; c++)
            sum += (double)sums[c * PANEL] * x[c];
        bias[o] = (float)sum;
    }
    return OK;
}

err_t metanet_guide(const struct run *r, const struct metanet_view *v, const float *guide,
                    const float *code)
{
    const struct net *net = v->m->net;
    const struct layer_map map = {guide, v->size, net->d.hdr, false};
    struct weight w = v->m->guide;
    struct layer_conv c = patch_conv(net, &w, net->d.hdr, v->size, layer_map_fetch);
    size_t mark = arena_mark(r->tmp);
    float *bias, *x;
    err_t e = layout_bias(&bias, &x, r->tmp, net);
    if (!e)
        e = fold_code(r, v->m, code, x, bias);
    if (!e) {
        w.bias = bias;
        c.ctx = &map;
        e = layer_conv_run(r, &c, &(struct layer_out){.out = v->sums, .ldo = (size_t)w.n});
    }
    arena_reset(r->tmp, mark);
    return e;
}

float *metanet_plane(const struct prediction *p, int c, int view, int size)
{
    size_t px = (size_t)size * (size_t)size, at = (size_t)view * px;
    if (c == CONFIDENCE)
        return p->confidence + at;
    return p->features + (size_t)(c < CONFIDENCE ? c : c - 1) * (size_t)p->n + at;
}

struct raw_map {
    const struct prediction *p;
    int view, size;
};

static void fetch_raw(const void *ctx, int y, int x, int n, float *restrict out)
{
    const struct raw_map *m = ctx;
    size_t at = (size_t)y * (size_t)m->size + (size_t)x;
    for (int c = 0; c < RAW; c++) {
        const float *px = metanet_plane(m->p, c, m->view, m->size) + at;
        for (int i = 0; i < n; i++)
            out[i * RAW + c] = px[i];
    }
}

static struct layer_conv second_conv(const struct net *net, int grid, const struct layer_map *map)
{
    return (struct layer_conv){.w = &net->meta.enc2,
                               .kh = 3,
                               .kw = 3,
                               .stride = 2,
                               .pad = 1,
                               .channels = net->d.hdr,
                               .h = grid,
                               .w_px = grid,
                               .fetch = layer_map_fetch,
                               .ctx = map,
                               .floats = net->floats & NET_FLOAT_HEADS};
}

static void pool_map(const float *px, int edge, int d, float *summary)
{
    size_t n = (size_t)edge * (size_t)edge;
    for (size_t c = 0; c < (size_t)d; c++) {
        double sum = 0;
        float top = -INFINITY;
        for (size_t i = 0; i < n; i++) {
            sum += px[i * (size_t)d + c];
            top = fmaxf(top, px[i * (size_t)d + c]);
        }
        summary[c] = (float)(sum / (double)n);
        summary[(size_t)d + c] = top;
    }
}

static err_t layout_map(float **px, struct arena *tmp, const struct net *net, int edge)
{
    return arena_alloc(tmp, (size_t)(edge * edge * net->d.hdr), sizeof **px, px);
}

err_t metanet_summarise(const struct run *r, const struct metanet_view *v,
                        const struct prediction *p, float *summary)
{
    const struct net *net = v->m->net;
    const struct raw_map map = {p, v->view, v->size};
    int d = net->d.hdr, grid = grid_of(v->size), edge = conv_size(grid, 3, 2, 1);
    struct layer_conv c = patch_conv(net, &v->m->raw, RAW, v->size, fetch_raw);
    c.ctx = &map;
    size_t mark = arena_mark(r->tmp);
    float *px;
    err_t e = layout_map(&px, r->tmp, net, edge);
    if (!e)
        e = layer_conv_run(r, &c,
                           &(struct layer_out){.out = v->sums, .ldo = (size_t)d, .add = true});
    if (!e) {
        const struct layer_map first = {v->sums, grid, d, true};
        c = second_conv(net, grid, &first);
        e = layer_conv_run(r, &c,
                           &(struct layer_out){.out = px, .ldo = (size_t)d, .act = ACT_RELU});
    }
    if (!e) {
        tap_map(r, "hyper.enc", v->view, v->n_views, (int[]){edge, edge, d}, px);
        pool_map(px, edge, d, summary);
    }
    arena_reset(r->tmp, mark);
    return e;
}

void metanet_view_plan(struct plan *p, const struct net *net, int size)
{
    const int grid = grid_of(size), d = net->d.hdr;
    const struct layer_conv guide = patch_conv(net, &net->meta.enc0, d, size, NULL);
    const struct layer_conv raw = patch_conv(net, &net->meta.enc0, RAW, size, NULL);
    const struct layer_conv second = second_conv(net, grid, NULL);
    float *px, *x;
    const size_t mark = arena_mark(&p->tmp);
    err_t e = layout_bias(&px, &x, &p->tmp, net);
    layer_plan(p, d);
    layer_conv_plan(p, &guide);
    arena_reset(&p->tmp, mark);
    if (!e)
        e = layout_map(&px, &p->tmp, net, conv_size(grid, 3, 2, 1));
    layer_conv_plan(p, &raw);
    layer_conv_plan(p, &second);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- all views ---- */

/* out: (4 d) mean and maximum over views. */
static void pool_views(const float *summary, int n_views, size_t d, float *out)
{
    for (size_t c = 0; c < 2 * d; c++) {
        double sum = 0;
        float top = -INFINITY;
        for (size_t v = 0; v < (size_t)n_views; v++) {
            sum += summary[v * 2 * d + c];
            top = fmaxf(top, summary[v * 2 * d + c]);
        }
        out[c] = (float)(sum / n_views);
        out[2 * d + c] = top;
    }
}

static err_t layout_pooled(float **pooled, float **hidden, struct arena *tmp, const struct net *net)
{
    err_t e = arena_alloc(tmp, 4 * (size_t)net->d.hdr, sizeof **pooled, pooled);
    return e ? e : arena_alloc(tmp, (size_t)net->meta.out.a.n, sizeof **hidden, hidden);
}

void metanet_plan(struct plan *p, const struct net *net)
{
    float *pooled, *hidden;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_pooled(&pooled, &hidden, &p->tmp, net))
        plan_refuse(p);
    layer_plan(p, 4 * net->d.hdr);
    layer_plan(p, net->meta.out.a.n);
    arena_reset(&p->tmp, mark);
}

err_t metanet_run(const struct run *r, const struct net *net, const float *summary, int n_views,
                  float mid_log2t, struct prediction *io)
{
    const struct mlp_weights *w = &net->meta.out;
    size_t d = (size_t)net->d.hdr, n = (size_t)w->a.n, mark = arena_mark(r->tmp);
    struct weight last = w->b;
    float *pooled, *hidden;
    last.n = tap_on(r) ? NET_THETA : TONE_PARAMS;
    memset(io->theta, 0, sizeof io->theta);
    err_t e = layout_pooled(&pooled, &hidden, r->tmp, net);
    if (!e) {
        pool_views(summary, n_views, d, pooled);
        tap_put(r,
                &(struct tap_tensor){
                    .name = "hyper.pooled", .rank = 2, .shape = {1, 4 * (int)d}, .data = pooled});
        e = layer_run(r, &w->a, &(struct layer_in){pooled, 4 * d, 1, true},
                      &(struct layer_out){.out = hidden, .ldo = n, .act = ACT_RELU});
    }
    if (!e)
        e = layer_run(r, &last, &(struct layer_in){hidden, n, 1, true},
                      &(struct layer_out){.out = io->theta, .ldo = NET_THETA});
    arena_reset(r->tmp, mark);
    if (!e)
        e = finite_check(r, "tone.params", FINITE_MAX, io->theta, (size_t)last.n);
    if (e)
        return e;
    tap_put(r, &(struct tap_tensor){
                   .name = "tone.params", .rank = 2, .shape = {1, NET_THETA}, .data = io->theta});
    memcpy(io->tone.p, io->theta, sizeof io->tone.p);
    io->tone.mid_log2t = mid_log2t;
    return OK;
}
