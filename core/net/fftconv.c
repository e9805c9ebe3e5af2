/* Overlap-save: a tile of 16 x 16 inputs gives (17 - kernel)^2 outputs. A row of tiles is a chunk:
 * its tiles are transformed, every frequency is a product (tiles, channels) x (channels, outputs)
 * of gemm_f32, and the sums are transformed back. A complex product is three real ones (Gauss):
 *   y0 = re (Wi - Wr), y1 = im (Wr + Wi), y2 = (re + im) Wr; result y2 - y1 + i (y2 + y0).
 * The weights are transformed at each call, 16 outputs at a time as if they were channels; that is
 * below 1 % of the work, and 25 MB for 128 x 128 need not be kept. They are conjugated, because the
 * network correlates, and carry the 1/256 of the inverse. */
#include "core/net/fftconv.h"

#include "core/base/num.h"

#include <string.h>

enum { WEIGHT_TILE = FFT_EDGE * FFT_EDGE * PANEL, KERNEL_MIN = 5, KERNEL_MAX = 9 };

struct room {        // per worker
    float *strip;    // (FFT_EDGE, width, channels) input of a row of tiles
    float *in, *out; // (FFT_PLANES, tiles, channels), (FFT_PLANES, tiles, n)
    float *px;       // (edge, edge, n)
};

struct job {
    const struct run *r;
    const struct layer_conv *c;
    const struct layer_out *out;
    int edge;         // outputs of a tile
    int out_h, out_w; // px
    int tiles, width; // in a row; px of its input
    int n;            // outputs, a multiple of PANEL
    float *weights;   // (FFT_PLANES, n / PANEL, channels, PANEL)
    struct room *rooms;
    float **panels; // (workers) scratch of the transform of weights
};

static struct job job_of_layer(const struct layer_conv *c)
{
    struct job j = {.c = c, .edge = FFT_EDGE + 1 - c->kh, .n = c->w->n};
    j.out_h = conv_size(c->h, c->kh, 1, c->pad);
    j.out_w = conv_size(c->w_px, c->kw, 1, c->pad);
    j.tiles = (j.out_w + j.edge - 1) / j.edge;
    j.width = (j.tiles - 1) * j.edge + FFT_EDGE;
    return j;
}

bool fftconv_possible(const struct layer_conv *c)
{
    return c->stride == 1 && c->kh == c->kw && c->kh >= KERNEL_MIN && c->kh <= KERNEL_MAX &&
           c->channels % PANEL == 0 && c->w->n % PANEL == 0 && !c->w->rotate;
}

/* ---- memory ---- */

static size_t panel_floats(const struct layer_conv *c)
{
    return (size_t)weight_k(c->w) * PANEL;
}

/* From plane to plane: an odd number of cache lines, so that a tile's frequencies do not share a
 * few sets of the cache. */
static size_t plane_floats(const struct job *j, int channels)
{
    size_t n = (size_t)j->tiles * (size_t)channels;
    return n / PANEL % 2 ? n : n + PANEL;
}

static size_t row_floats(const struct job *j, int channels)
{
    return FFT_PLANES * plane_floats(j, channels);
}

static size_t strip_floats(const struct job *j)
{
    return (size_t)FFT_EDGE * (size_t)j->width * (size_t)j->c->channels;
}

static size_t weight_floats(const struct job *j)
{
    return (size_t)FFT_PLANES * (size_t)j->n * (size_t)j->c->channels;
}

static err_t layout_room(const struct job *j, struct arena *a, struct room *o, float **panels)
{
    err_t e = arena_alloc(a, strip_floats(j), sizeof(float), &o->strip);
    if (!e)
        e = arena_alloc(a, row_floats(j, j->c->channels), sizeof(float), &o->in);
    if (!e)
        e = arena_alloc(a, row_floats(j, j->n), sizeof(float), &o->out);
    if (!e)
        e = arena_alloc(a, (size_t)(j->edge * j->edge) * (size_t)j->n, sizeof(float), &o->px);
    return e ? e : arena_alloc(a, panel_floats(j->c) + WEIGHT_TILE, sizeof(float), panels);
}

static err_t layout(struct job *j, struct arena *tmp, int threads)
{
    err_t e = arena_alloc(tmp, weight_floats(j), sizeof(float), &j->weights);
    if (!e)
        e = arena_alloc(tmp, (size_t)threads, sizeof *j->rooms, &j->rooms);
    if (!e)
        e = arena_alloc(tmp, (size_t)threads, sizeof *j->panels, &j->panels);
    for (int i = 0; !e && i < threads; i++) {
        struct room o;
        float *panels;
        e = layout_room(j, tmp, &o, &panels);
        if (!e && !tmp->counts) {
            j->rooms[i] = o;
            j->panels[i] = panels;
        }
    }
    return e;
}

void fftconv_plan(struct plan *p, const struct layer_conv *c)
{
    struct job j = job_of_layer(c);
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&j, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- weights ---- */

/* Panel p as floats with its scales. */
static const float *float_panel(const struct job *j, int p, float *scratch)
{
    const struct gemm_kernels *k = &j->r->k->net;
    const struct weight *w = j->c->w;
    size_t n = panel_floats(j->c), from = (size_t)p * n;
    if (w->type == PRECISION_F32)
        return (const float *)w->panels + from;
    if (w->type == PRECISION_BF16) {
        k->unpack_bf16((const uint16_t *)w->panels + from, weight_k(w), scratch);
        return scratch;
    }
    k->unpack_s8((const int8_t *)w->panels + from, weight_k(w), scratch);
    for (size_t i = 0; i < n; i++)
        scratch[i] *= w->scale[p * PANEL + (int)(i % PANEL)];
    return scratch;
}

/* Turn planes of one input channel and 16 outputs into the factors of re, im and their sum. */
static void prepare_planes(float *w, size_t plane)
{
    const float unit = 1.0f / (FFT_EDGE * FFT_EDGE);
    for (int b = 0; b < FFT_BINS; b++, w += 3 * plane)
        for (int o = 0; o < PANEL; o++) {
            float re = w[o] * unit, im = -w[plane + (size_t)o] * unit;
            w[o] = im - re;
            w[plane + (size_t)o] = re + im;
            w[2 * plane + (size_t)o] = re;
        }
    for (int r = 0; r < FFT_REALS; r++, w += plane)
        for (int o = 0; o < PANEL; o++)
            w[o] *= unit;
}

static err_t weights_chunk(void *ctx, int p, int worker)
{
    const struct job *j = ctx;
    const struct layer_conv *c = j->c;
    float *tile = j->panels[worker] + panel_floats(c);
    const float *panel = float_panel(j, p, j->panels[worker]);
    struct fft_tile t = {.n = PANEL, .px = tile, .row = FFT_EDGE * PANEL, .step = PANEL};
    t.plane = (size_t)j->n * (size_t)c->channels;
    for (int i = 0; i < c->channels; i++) {
        memset(tile, 0, WEIGHT_TILE * sizeof *tile);
        for (int k = 0; k < c->kh * c->kw; k++)
            memcpy(tile + (k / c->kw * FFT_EDGE + k % c->kw) * PANEL,
                   panel + ((size_t)k * (size_t)c->channels + (size_t)i) * PANEL,
                   PANEL * sizeof *tile);
        t.planes = j->weights + ((size_t)p * (size_t)c->channels + (size_t)i) * PANEL;
        j->r->k->net.fft_forward(&t);
        prepare_planes(t.planes, t.plane);
    }
    return OK;
}

/* ---- rows of tiles ---- */

static void fetch_strip(const struct job *j, int y0, float *strip)
{
    const struct layer_conv *c = j->c;
    size_t ch = (size_t)c->channels, pitch = (size_t)j->width * ch;
    int n = num_min(c->w_px, j->width - c->pad);
    size_t before = (size_t)c->pad * ch, filled = before + (size_t)n * ch;
    for (int y = y0; y < y0 + FFT_EDGE; y++, strip += pitch) {
        bool inside = y >= 0 && y < c->h;
        memset(strip, 0, (inside ? before : pitch) * sizeof *strip);
        if (!inside)
            continue;
        c->fetch(c->ctx, y, 0, n, strip + before);
        memset(strip + filled, 0, (pitch - filled) * sizeof *strip);
    }
}

static void multiply_planes(const struct job *j, const struct room *o)
{
    size_t in = plane_floats(j, j->c->channels), out = plane_floats(j, j->n);
    size_t w = (size_t)j->n * (size_t)j->c->channels;
    for (int p = 0; p < FFT_PLANES; p++) {
        const struct gemm_f32 g = {.m = j->tiles,
                                   .panels = j->n / PANEL,
                                   .segs = 1,
                                   .seg = j->c->channels,
                                   .a = o->in + (size_t)p * in,
                                   .lda = (size_t)j->c->channels,
                                   .w = j->weights + (size_t)p * w,
                                   .ldw = (size_t)j->c->channels * PANEL,
                                   .c = o->out + (size_t)p * out,
                                   .ldc = (size_t)j->n};
        j->r->k->net.f32(&g);
    }
}

/* Outputs of tile i of the row that starts at y, as far as they lie in the map. */
static void finish_tile(const struct job *j, int y, int i, const float *px)
{
    const struct layer_out *to = j->out;
    int x = i * j->edge, rows = num_min(j->edge, j->out_h - y);
    for (int k = 0; k < rows; k++) {
        size_t at = ((size_t)(y + k) * (size_t)j->out_w + (size_t)x) * to->ldo;
        const struct epilogue e = {.m = num_min(j->edge, j->out_w - x),
                                   .n = j->n,
                                   .cf = px + (size_t)(k * j->edge) * (size_t)j->n,
                                   .ldc = (size_t)j->n,
                                   .bias = j->c->w->bias,
                                   .gamma = to->gamma,
                                   .act = to->act,
                                   .add = to->add,
                                   .out = to->out + at,
                                   .ldo = to->ldo};
        j->r->k->net.epilogue(&e);
    }
}

static err_t row_chunk(void *ctx, int chunk, int worker)
{
    const struct job *j = ctx;
    const struct room *o = j->rooms + worker;
    size_t ch = (size_t)j->c->channels, n = (size_t)j->n;
    int y = chunk * j->edge;
    fetch_strip(j, y - j->c->pad, o->strip);
    for (int i = 0; i < j->tiles; i++) {
        const struct fft_tile t = {.n = j->c->channels,
                                   .px = o->strip + (size_t)(i * j->edge) * ch,
                                   .row = (size_t)j->width * ch,
                                   .step = ch,
                                   .planes = o->in + (size_t)i * ch,
                                   .plane = plane_floats(j, j->c->channels)};
        j->r->k->net.fft_forward(&t);
    }
    multiply_planes(j, o);
    for (int i = 0; i < j->tiles; i++) {
        const struct fft_tile t = {.n = j->n,
                                   .px = o->px,
                                   .row = (size_t)j->edge * n,
                                   .step = n,
                                   .edge = j->edge,
                                   .planes = o->out + (size_t)i * n,
                                   .plane = plane_floats(j, j->n)};
        j->r->k->net.fft_inverse(&t);
        finish_tile(j, y, i, o->px);
    }
    return run_check(j->r, "network");
}

err_t fftconv_run(const struct run *r, const struct layer_conv *c, const struct layer_out *out)
{
    struct job j = job_of_layer(c);
    size_t mark = arena_mark(r->tmp);
    j.r = r;
    j.out = out;
    err_t e = layout(&j, r->tmp, pool_size(r->pool));
    if (!e)
        e = pool_for(r->pool, j.n / PANEL, weights_chunk, &j);
    if (!e)
        e = pool_for(r->pool, (j.out_h + j.edge - 1) / j.edge, row_chunk, &j);
    arena_reset(r->tmp, mark);
    return e;
}
