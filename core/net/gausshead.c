/* Per view, with two maps a and b at full size (core/net/README.md 2.9):
 *   a = G, the guide; its share of the hypernetwork; low = G at half the patch grid
 *   b = relu(proj_guide(G - low)), the detail finer than patches
 *   a = relu(proj_out(Z + b)), Z = the fused appearance
 *   b = relu(head(D + a)), D = the trunk
 * and a product per pixel. Resizes and sums are computed tile by tile for the convolutions. In
 * AnySplat mode a = relu(input_merger(picture)) and b = relu(head(D + a)). */
#include "core/net/gausshead.h"

#include "core/net/appearance.h"
#include "core/net/dpt.h"
#include "core/net/finite.h"
#include "core/net/metanet.h"
#include "core/net/tap.h"
#include "core/photo/prep.h"

#include <string.h>

enum { RAW = NET_RAW + NET_SENSITIVITY };

struct head {
    const struct run *r;
    const struct net *net;
    const struct gausshead_in *in;
    struct prediction *io;
    struct metanet meta;
    int view, size, grid, d;
    float *trunk, *code;  // (edge, edge, d); position code
    float *a, *b;         // (size, size, d)
    float *planes;        // (3, size, size) the picture
    float *scene;         // (grid, grid, d) Z
    float *low;           // (low_edge, low_edge, d), minus the guide
    float *hidden, *sens; // (grid, grid, hidden), (grid, grid, NET_SENSITIVITY)
    float *sums;          // (grid, grid, d) of the hypernetwork
    float *rows;          // per worker (size, NET_RAW)
    struct layer_workspace *rooms;
};

static size_t pixels_of_square(int edge)
{
    return (size_t)edge * (size_t)edge;
}

/* Half the grid, rounded down as in the reference; a single patch keeps one. */
static int low_edge(int grid)
{
    return grid > 1 ? grid / 2 : 1;
}

static struct layer_conv conv_of(const struct weight *w, int kernel, int edge, bool floats)
{
    return (struct layer_conv){.w = w,
                               .kh = kernel,
                               .kw = kernel,
                               .stride = 1,
                               .pad = kernel / 2,
                               .channels = w->seg / kernel,
                               .h = edge,
                               .w_px = edge,
                               .floats = floats};
}

/* out = relu(w * blend), (edge, edge, w->n). */
static err_t convolve_blend(const struct head *h, const struct weight *w, int kernel,
                            const struct dpt_blend *b, float *out)
{
    struct layer_conv c = conv_of(w, kernel, b->map.out_h, (h->net->floats & NET_FLOAT_HEADS) != 0);
    c.fetch = dpt_blend_fetch;
    c.ctx = b;
    return layer_conv_run(h->r, &c,
                          &(struct layer_out){.out = out, .ldo = (size_t)w->n, .act = ACT_RELU});
}

static void tap_view_map(const struct head *h, const char *name, int edge, int channels,
                         const float *px)
{
    tap_map(h->r, name, h->view, h->in->views->n, (int[]){edge, edge, channels}, px);
}

static struct dpt_blend full_size_blend(const float *px, int edge, const struct head *h, bool align)
{
    return (struct dpt_blend){.map = {px, edge, edge, h->d, h->size, h->size, align}};
}

/* The trunk's map at full size, with its position code. */
static struct dpt_blend trunk_blend(const struct head *h)
{
    struct dpt_blend b = full_size_blend(h->trunk, dpt_edge(h->grid), h, true);
    b.code = h->code;
    return b;
}

static err_t alloc_floats(struct arena *a, size_t n, float **out)
{
    return arena_alloc(a, n, sizeof(float), out);
}

static err_t layout_large(struct head *h, struct arena *tmp)
{
    const size_t n = pixels_of_square(h->size) * (size_t)h->d;
    err_t e = alloc_floats(tmp, n, &h->a);
    return e ? e : alloc_floats(tmp, n, &h->b);
}

/* The trunk's map, then room for the large ones. */
static err_t run_trunk(struct head *h)
{
    const struct dpt_job j = {h->net, &h->net->gauss, h->in->tokens, h->view, "gs"};
    err_t e = dpt_run(h->r, &j, h->trunk);
    if (!e)
        e = layout_large(h, h->r->tmp);
    if (!e && tap_on(h->r) && h->in->irr) {
        const struct dpt_blend b = trunk_blend(h);
        e = dpt_blend_run(h->r, &b, false, h->a);
        if (!e)
            tap_view_map(h, "gs.features", h->size, h->d, h->a);
    }
    return e;
}

/* a = relu(w * picture). */
static err_t convolve_picture(const struct head *h, const struct weight *w)
{
    const struct appearance_picture picture = {h->planes, h->size};
    struct layer_conv c = conv_of(w, 7, h->size, true);
    c.fetch = appearance_fetch;
    c.ctx = &picture;
    prep_to_float(h->in->views->rgb + 3 * pixels_of_square(h->size) * (size_t)h->view, h->size,
                  h->planes);
    return layer_conv_run(h->r, &c,
                          &(struct layer_out){.out = h->a, .ldo = (size_t)w->n, .act = ACT_RELU});
}

/* b = the detail of the guide a that is finer than patches. */
static err_t guide_detail(const struct head *h)
{
    int edge = low_edge(h->grid);
    const struct dpt_blend down = {.map = {h->a, h->size, h->size, h->d, edge, edge, false}};
    err_t e = dpt_blend_run(h->r, &down, false, h->low);
    if (e)
        return e;
    tap_view_map(h, "hdr.guide_low", edge, h->d, h->low);
    for (size_t i = 0; i < pixels_of_square(edge) * (size_t)h->d; i++)
        h->low[i] = -h->low[i];
    struct dpt_blend fine = full_size_blend(h->low, edge, h, false);
    fine.plus = h->a;
    e = convolve_blend(h, &h->net->appearance.proj_guide, 7, &fine, h->b);
    if (!e)
        tap_view_map(h, "hdr.guide_high", h->size, h->d, h->b);
    return e;
}

/* A 3x3 convolution with ReLU of the view's tokens. out: (grid, grid, w->n). */
static err_t convolve_tokens(const struct head *h, const struct weight *w, const float *tokens,
                             float *out)
{
    const size_t own = (size_t)(h->view - h->in->tokens->first);
    const float *px = tokens + own * pixels_of_square(h->grid) * (size_t)h->d;
    const struct layer_map map = {px, h->grid, h->d, false};
    struct layer_conv c = conv_of(w, 3, h->grid, (h->net->floats & NET_FLOAT_HEADS) != 0);
    c.fetch = layer_map_fetch;
    c.ctx = &map;
    return layer_conv_run(h->r, &c,
                          &(struct layer_out){.out = out, .ldo = (size_t)w->n, .act = ACT_RELU});
}

/* a = the fused appearance at full size. */
static err_t upsample_appearance(const struct head *h)
{
    err_t e = convolve_tokens(h, &h->net->appearance.scene_conv, h->in->irr->scene, h->scene);
    if (e)
        return e;
    tap_view_map(h, "hdr.scene_conv", h->grid, h->d, h->scene);
    struct dpt_blend sum = full_size_blend(h->scene, h->grid, h, false);
    sum.plus = h->b;
    e = convolve_blend(h, &h->net->appearance.proj_out, 7, &sum, h->a);
    if (!e)
        tap_view_map(h, "hdr.scene_features", h->size, h->d, h->a);
    return e;
}

static err_t run_sensitivity(const struct head *h)
{
    const struct mlp_weights *w = &h->net->appearance.sensitivity;
    size_t n = (size_t)w->a.n;
    err_t e = convolve_tokens(h, &w->a, h->in->irr->sens, h->hidden);
    if (!e)
        e = layer_run(h->r, &w->b, &(struct layer_in){h->hidden, n, h->grid * h->grid, true},
                      &(struct layer_out){.out = h->sens, .ldo = NET_SENSITIVITY});
    if (!e)
        tap_view_map(h, "hdr.sensitivity_lowres", h->grid, NET_SENSITIVITY, h->sens);
    return e;
}

/* Raw channels from `first` on of one row of pixels, (size, n), to their planes. */
static void scatter_row(const struct head *h, int y, int first, int n, const float *row)
{
    for (int c = 0; c < n; c++) {
        float *to = metanet_plane(h->io, first + c, h->view, h->size) + (size_t)y * (size_t)h->size;
        for (int x = 0; x < h->size; x++)
            to[x] = row[x * n + c];
    }
}

static err_t last_row(void *ctx, int y, int worker)
{
    const struct head *h = ctx;
    size_t d = (size_t)h->d;
    float *row = h->rows + (size_t)worker * (size_t)h->size * NET_RAW;
    layer_rows(&h->r->k->net, &h->net->gauss_out.b,
               &(struct layer_in){h->b + (size_t)y * (size_t)h->size * d, d, h->size, true},
               &(struct layer_out){.out = row, .ldo = NET_RAW}, h->rooms + worker);
    scatter_row(h, y, 0, NET_RAW, row);
    if (h->in->irr) {
        const struct layer_resize up = {h->sens, h->grid, h->grid, NET_SENSITIVITY,
                                        h->size, h->size, false};
        layer_resize_fetch(&up, y, 0, h->size, row);
    } else {
        memset(row, 0, (size_t)h->size * NET_SENSITIVITY * sizeof *row);
    }
    scatter_row(h, y, NET_RAW, NET_SENSITIVITY, row);
    return run_check(h->r, "network");
}

static void tap_raw(const struct head *h)
{
    int n = h->in->views->n;
    for (int c = 0; c < RAW; c++) {
        struct tap_tensor t = {.name = "gs.raw88",
                               .rank = 4,
                               .shape = {n, RAW, h->size, h->size},
                               .part = h->view * RAW + c,
                               .parts = n * RAW,
                               .data = metanet_plane(h->io, c, h->view, h->size)};
        tap_put(h->r, &t);
        if (c < NET_RAW || !h->in->irr)
            continue;
        t.name = "hdr.sensitivity";
        t.shape[1] = NET_SENSITIVITY;
        t.part = h->view * NET_SENSITIVITY + c - NET_RAW;
        t.parts = n * NET_SENSITIVITY;
        tap_put(h->r, &t);
    }
}

static err_t layout_rows(struct head *h, struct arena *tmp, int threads)
{
    err_t e = alloc_floats(tmp, (size_t)threads * (size_t)h->size * NET_RAW, &h->rows);
    return e ? e : layer_workspaces_init(tmp, threads, h->d, &h->rooms);
}

/* Trunk plus a, to raw Gaussians. */
static err_t combine_maps(struct head *h)
{
    struct dpt_blend sum = trunk_blend(h);
    size_t mark = arena_mark(h->r->tmp);
    sum.plus = h->a;
    err_t e = convolve_blend(h, &h->net->gauss_out.a, 3, &sum, h->b);
    if (!e)
        e = layout_rows(h, h->r->tmp, pool_size(h->r->pool));
    if (!e)
        e = pool_for(h->r->pool, h->size, last_row, h);
    if (!e)
        tap_raw(h);
    arena_reset(h->r->tmp, mark);
    return e;
}

/* AnySplat mode. */
static err_t run_plain(struct head *h)
{
    err_t e = run_trunk(h);
    if (!e)
        e = convolve_picture(h, &h->net->input_merger);
    return e ? e : combine_maps(h);
}

static err_t run_hdr(struct head *h, float *summary)
{
    const struct metanet_view v = {&h->meta, h->view, h->in->views->n, h->size, h->sums};
    err_t e = run_trunk(h);
    if (!e)
        e = convolve_picture(h, &h->net->appearance.guide);
    if (!e) {
        tap_view_map(h, "hdr.guide", h->size, h->d, h->a);
        e = metanet_guide(h->r, &v, h->a, h->in->irr->code + (size_t)h->view * (size_t)h->d);
    }
    if (!e)
        e = guide_detail(h);
    if (!e)
        e = upsample_appearance(h);
    if (!e)
        e = run_sensitivity(h);
    if (!e)
        e = combine_maps(h);
    if (!e)
        e = metanet_summarise(h->r, &v, h->io, summary + (size_t)h->view * 2 * (size_t)h->d);
    return e;
}

static err_t run_view(struct head *h, float *summary)
{
    size_t mark = arena_mark(h->r->tmp);
    err_t e = h->in->irr ? run_hdr(h, summary) : run_plain(h);
    arena_reset(h->r->tmp, mark);
    return e;
}

static err_t layout_result(struct prediction *out, struct arena *keep)
{
    err_t e = alloc_floats(keep, (size_t)out->n * (RAW - 1), &out->features);
    return e ? e : alloc_floats(keep, (size_t)out->n, &out->confidence);
}

/* hdr: there is an appearance branch. */
static err_t layout(struct head *h, struct arena *tmp, bool hdr)
{
    size_t px = pixels_of_square(h->size), d = (size_t)h->d, cells = pixels_of_square(h->grid);
    err_t e = alloc_floats(tmp, pixels_of_square(dpt_edge(h->grid)) * d, &h->trunk);
    if (!e)
        e = alloc_floats(tmp, (size_t)h->size * d / 2, &h->code);
    if (!e)
        e = alloc_floats(tmp, px * 3, &h->planes);
    if (e || !hdr)
        return e;
    e = alloc_floats(tmp, cells * d, &h->scene);
    if (!e)
        e = alloc_floats(tmp, pixels_of_square(low_edge(h->grid)) * d, &h->low);
    if (!e)
        e = alloc_floats(tmp, cells * (size_t)h->net->appearance.sensitivity.a.n, &h->hidden);
    if (!e)
        e = alloc_floats(tmp, cells * NET_SENSITIVITY, &h->sens);
    return e ? e : alloc_floats(tmp, cells * d, &h->sums);
}

static void plan_view(struct plan *p, const struct net *net, int size)
{
    const struct appearance_weights *w = &net->appearance;
    bool floats = net->floats & NET_FLOAT_HEADS;
    const struct layer_conv convs[] = {
        conv_of(net->d.appearance ? &w->guide : &net->input_merger, 7, size, true),
        conv_of(&net->gauss_out.a, 3, size, floats),
        conv_of(&w->proj_guide, 7, size, floats),
        conv_of(&w->proj_out, 7, size, floats),
        conv_of(&w->scene_conv, 3, size / NET_PATCH, floats),
        conv_of(&w->sensitivity.a, 3, size / NET_PATCH, floats),
    };
    int n = net->d.appearance ? 6 : 2;
    for (int i = 0; i < n; i++)
        layer_conv_plan(p, convs + i);
    if (!net->d.appearance)
        return;
    layer_plan(p, w->sensitivity.a.n);
    metanet_view_plan(p, net, size);
}

void gausshead_plan(struct plan *p, const struct net *net, int n_views, int size)
{
    struct head h = {.net = net, .size = size, .grid = size / NET_PATCH, .d = net->d.hdr};
    struct prediction out = {.n = n_views * size * size};
    const size_t begin = arena_mark(&p->tmp);
    err_t e = layout_result(&out, &p->keep);
    if (!e)
        e = layout(&h, &p->tmp, net->d.appearance);
    if (net->d.appearance)
        metanet_init_plan(p, net);
    dpt_plan(p, &net->gauss, h.grid);
    if (!e)
        e = layout_large(&h, &p->tmp);
    plan_view(p, net, size);
    if (!e)
        e = layout_rows(&h, &p->tmp, p->threads);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, begin);
}

/* The raw Gaussians and summaries of all views. */
static err_t gather_views(const struct head *h, float *summary)
{
    struct team *t = h->r->team;
    const size_t plane = pixels_of_square(h->size) * sizeof *h->io->features;
    err_t e = OK;
    for (int c = 0; c < RAW && !e; c++)
        e = team_gather(t, metanet_plane(h->io, c, 0, h->size), plane, h->in->views->n);
    if (!e && h->in->irr)
        e = team_gather(t, summary, 2 * (size_t)h->d * sizeof *summary, h->in->views->n);
    return e;
}

err_t gausshead_run(const struct run *r, const struct net *net, const struct gausshead_in *in,
                    struct prediction *io, float *summary)
{
    struct head h = {.r = r,
                     .net = net,
                     .in = in,
                     .io = io,
                     .size = in->views->size,
                     .grid = in->tokens->grid,
                     .d = net->d.hdr};
    const int first = in->tokens->first, own = in->tokens->n_own;
    size_t mark = arena_mark(r->tmp);
    io->n = in->views->n * h.size * h.size;
    io->linear = !in->irr;
    err_t e = layout_result(io, r->keep);
    if (!e)
        e = layout(&h, r->tmp, in->irr != NULL);
    if (!e && in->irr)
        e = metanet_init(r, net, &h.meta);
    if (!e)
        dpt_code(h.size, h.d, h.code);
    for (h.view = first; h.view < first + own && !e; h.view++) {
        e = run_view(&h, summary);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "gaussians", h.view - first + 1, own, NULL);
    }
    arena_reset(r->tmp, mark);
    if (!e)
        e = gather_views(&h, summary);
    if (!e)
        e = finite_check(r, "gs.raw88", FINITE_MAX, io->features, (size_t)io->n * (RAW - 1));
    return e ? e : finite_check(r, "gs.raw88", FINITE_MAX, io->confidence, (size_t)io->n);
}
