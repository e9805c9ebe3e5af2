/* A block of at most LAYER_ROWS rows is multiplied by a few panels of weights at a time: the sums
 * of the block (at most 16 kB) stay in the first-level cache between product and epilogue, the rows
 * in the second-level cache.
 * A convolution is the same product: a tile of the input is copied with its zero border, then each
 * row of output pixels is a block whose rows overlap (gemm.h). */
#include "core/net/layer.h"

#include "core/base/num.h"
#include "core/net/fftconv.h"

#include <float.h>
#include <string.h>

enum {
    GROUP = 4,      // panels a product takes at once
    GROUP_DEEP = 2, // where k is above DEEP_K: keeps the weights in the second-level cache
    DEEP_K = 2048,
    ROTATED = 8,            // float rows that are rotated at a time
    PANEL_K = 512,          // inputs of weights that are turned to floats at a time
    TILE_FLOATS = 320 << 10 // largest input tile, unless one row of pixels has more
};

/* A block of rows and the weights that multiply it. */
struct block {
    const struct gemm_kernels *k;
    const struct weight *w;
    int m;
    const float *x;  // rows as floats, or NULL:
    const int8_t *q; // quantised
    size_t lda, seg_stride;
};

static size_t panel_stride(const struct weight *w)
{
    return (size_t)weight_k(w) * PANEL;
}

static int count_panels(const struct weight *w)
{
    return (w->n + PANEL - 1) / PANEL;
}

static int group_of(const struct weight *w)
{
    return weight_k(w) > DEEP_K ? GROUP_DEEP : GROUP;
}

/* Panels [p, p + count) as floats, inputs [at, at + k). */
static void unpack_panels(const struct block *b, int p, int count, int at, int k, float *out)
{
    for (int i = 0; i < count; i++, out += (size_t)k * PANEL) {
        size_t from = (size_t)(p + i) * panel_stride(b->w) + (size_t)at * PANEL;
        if (b->w->type == PRECISION_S8)
            b->k->unpack_s8((const int8_t *)b->w->panels + from, k, out);
        else
            b->k->unpack_bf16((const uint16_t *)b->w->panels + from, k, out);
    }
}

/* Float rows times weights of another type: a chunk of inputs at a time. */
static void multiply_unpacked(const struct block *b, int p, int count, struct layer_workspace *room)
{
    const struct weight *w = b->w;
    struct gemm_f32 g = {.m = b->m,
                         .panels = count,
                         .segs = 1,
                         .lda = b->lda,
                         .w = room->panel,
                         .c = room->cf,
                         .ldc = GROUP * PANEL};
    for (int s = 0; s < w->segs; s++)
        for (int at = 0; at < w->seg; at += PANEL_K) {
            int left = w->seg - at;
            g.seg = left < PANEL_K ? left : PANEL_K;
            g.ldw = (size_t)g.seg * PANEL;
            g.a = b->x + (size_t)s * b->seg_stride + at;
            unpack_panels(b, p, count, s * w->seg + at, g.seg, room->panel);
            b->k->f32(&g);
            g.add = true;
        }
}

static void multiply_panels(const struct block *b, int p, int count, struct layer_workspace *room)
{
    const struct weight *w = b->w;
    size_t from = (size_t)p * panel_stride(w);
    if (b->q) {
        const struct gemm_s8 g = {.m = b->m,
                                  .panels = count,
                                  .segs = w->segs,
                                  .seg = w->seg,
                                  .a = b->q,
                                  .lda = b->lda,
                                  .seg_stride = b->seg_stride,
                                  .w = (const int8_t *)w->panels + from,
                                  .ldw = panel_stride(w),
                                  .c = room->c,
                                  .ldc = GROUP * PANEL};
        b->k->s8(&g);
    } else if (w->type == PRECISION_F32) {
        const struct gemm_f32 g = {.m = b->m,
                                   .panels = count,
                                   .segs = w->segs,
                                   .seg = w->seg,
                                   .a = b->x,
                                   .lda = b->lda,
                                   .seg_stride = b->seg_stride,
                                   .w = (const float *)w->panels + from,
                                   .ldw = panel_stride(w),
                                   .c = room->cf,
                                   .ldc = GROUP * PANEL};
        b->k->f32(&g);
    } else {
        multiply_unpacked(b, p, count, room);
    }
}

static const float *offset_or_null(const float *p, int n)
{
    return p ? p + n : NULL;
}

/* Panels [p, p + count) of the block: product and epilogue. */
static void finish_panels(const struct block *b, int p, int count, const struct layer_out *out,
                          struct layer_workspace *room)
{
    const struct weight *w = b->w;
    int first = p * PANEL, left = w->n - first;
    multiply_panels(b, p, count, room);
    const struct epilogue e = {.m = b->m,
                               .n = left < count * PANEL ? left : count * PANEL,
                               .ci = b->q ? room->c : NULL,
                               .cf = room->cf,
                               .ldc = GROUP * PANEL,
                               .row_scale = b->q ? room->scale : NULL,
                               .scale = offset_or_null(w->scale, first),
                               .bias = offset_or_null(w->bias, first),
                               .gamma = offset_or_null(out->gamma, first),
                               .act = out->act,
                               .add = out->add,
                               .out = out->out + first,
                               .ldo = out->ldo};
    b->k->epilogue(&e);
}

/* ---- rooms ---- */

err_t layer_workspace_init(struct layer_workspace *room, struct arena *a, int k)
{
    err_t e = arena_alloc(a, (size_t)LAYER_ROWS * (size_t)k, 1, &room->q);
    if (!e)
        e = arena_alloc(a, ROTATED * (size_t)k, sizeof(float), &room->rotated);
    if (!e)
        e = arena_alloc(a, LAYER_ROWS, sizeof(float), &room->scale);
    if (!e)
        e = arena_alloc(a, LAYER_ROWS * GROUP * PANEL, sizeof(int32_t), &room->c);
    if (!e)
        e = arena_alloc(a, PANEL_K * GROUP * PANEL, sizeof(float), &room->panel);
    return e;
}

err_t layer_workspaces_init(struct arena *a, int threads, int k, struct layer_workspace **out)
{
    err_t e = arena_alloc(a, (size_t)threads, sizeof **out, out);
    for (int i = 0; !e && i < threads; i++) {
        struct layer_workspace one;
        e = layer_workspace_init(&one, a, k);
        if (!e && !a->counts)
            (*out)[i] = one;
    }
    return e;
}

/* ---- rows ---- */

static void quantise_row(const struct gemm_kernels *k, const struct weight *w, const float *x,
                         float *scale, struct layer_workspace *room, int8_t *q)
{
    size_t n = (size_t)weight_k(w);
    if (w->rotate) {
        memcpy(room->rotated, x, n * sizeof *x);
        k->hadamard(room->rotated, (int)n, w->rotate);
        x = room->rotated;
    }
    float top = k->absmax(x, n);
    *scale = top < FLT_MIN ? 0 : top / 127;
    k->quant(x, n, top < FLT_MIN ? 0 : 127 / top, q);
}

/* Rotated weights need rotated rows, also where these stay floats. */
static void rows_rotated(const struct block *whole, const struct layer_out *out,
                         struct layer_workspace *room)
{
    struct block b = *whole;
    size_t n = (size_t)weight_k(b.w);
    int panels = count_panels(b.w), group = group_of(b.w);
    for (int i = 0; i < whole->m; i += ROTATED) {
        struct layer_out o = *out;
        o.out += (size_t)i * out->ldo;
        b.m = whole->m - i < ROTATED ? whole->m - i : ROTATED;
        for (int j = 0; j < b.m; j++)
            memcpy(room->rotated + (size_t)j * n, whole->x + (size_t)(i + j) * whole->lda,
                   n * sizeof(float));
        b.k->hadamard(room->rotated, b.m * (int)n, b.w->rotate);
        b.x = room->rotated;
        b.lda = n;
        for (int p = 0; p < panels; p += group)
            finish_panels(&b, p, panels - p < group ? panels - p : group, &o, room);
    }
}

/* At most LAYER_ROWS rows. */
static void rows_block(const struct gemm_kernels *k, const struct weight *w,
                       const struct layer_in *in, const struct layer_out *out,
                       struct layer_workspace *room)
{
    struct block b = {.k = k, .w = w, .m = in->m, .x = in->x, .lda = in->ldx};
    size_t n = (size_t)weight_k(w);
    b.seg_stride = (size_t)w->seg;
    if (w->type == PRECISION_S8 && !in->floats) {
        for (int i = 0; i < in->m; i++)
            quantise_row(k, w, in->x + (size_t)i * in->ldx, room->scale + i, room,
                         room->q + (size_t)i * n);
        b.q = room->q;
        b.lda = n;
    } else if (w->rotate) {
        rows_rotated(&b, out, room);
        return;
    }
    int panels = count_panels(w), group = group_of(w);
    for (int p = 0; p < panels; p += group)
        finish_panels(&b, p, panels - p < group ? panels - p : group, out, room);
}

void layer_rows(const struct gemm_kernels *k, const struct weight *w, const struct layer_in *in,
                const struct layer_out *out, struct layer_workspace *room)
{
    for (int i = 0; i < in->m; i += LAYER_ROWS) {
        struct layer_in some = *in;
        struct layer_out o = *out;
        some.x += (size_t)i * in->ldx;
        some.m = in->m - i < LAYER_ROWS ? in->m - i : LAYER_ROWS;
        o.out += (size_t)i * out->ldo;
        rows_block(k, w, &some, &o, room);
    }
}

struct rows_job {
    const struct run *r;
    const struct weight *w;
    const struct layer_in *in;
    const struct layer_out *out;
    struct layer_workspace *rooms;
};

static err_t rows_chunk(void *ctx, int chunk, int worker)
{
    const struct rows_job *j = ctx;
    struct layer_in in = *j->in;
    struct layer_out out = *j->out;
    int first = chunk * LAYER_ROWS, left = in.m - first;
    in.x += (size_t)first * in.ldx;
    in.m = left < LAYER_ROWS ? left : LAYER_ROWS;
    out.out += (size_t)first * out.ldo;
    rows_block(&j->r->k->net, j->w, &in, &out, j->rooms + worker);
    return run_check(j->r, "network");
}

err_t layer_run(const struct run *r, const struct weight *w, const struct layer_in *in,
                const struct layer_out *out)
{
    struct rows_job j = {.r = r, .w = w, .in = in, .out = out};
    size_t mark = arena_mark(r->tmp);
    err_t e = layer_workspaces_init(r->tmp, pool_size(r->pool), weight_k(w), &j.rooms);
    if (!e)
        e = pool_for(r->pool, (in->m + LAYER_ROWS - 1) / LAYER_ROWS, rows_chunk, &j);
    arena_reset(r->tmp, mark);
    return e;
}

void layer_plan(struct plan *p, int k)
{
    const size_t mark = arena_mark(&p->tmp);
    struct layer_workspace *rooms;
    if (layer_workspaces_init(&p->tmp, p->threads, k, &rooms))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

/* ---- convolutions ---- */

/* Sizes of the output and of the tiles. They depend on the shape alone: a tile has one scale. */
struct tiling {
    int out_h, out_w, tile_h, tile_w; // px
    int in_h, in_w;                   // px, of the input of a tile
    int rows, columns;                // in tiles
};

static size_t tile_floats(const struct tiling *t, const struct layer_conv *c)
{
    return (size_t)t->in_h * (size_t)t->in_w * (size_t)c->channels;
}

static void size_tile(struct tiling *t, const struct layer_conv *c)
{
    t->in_h = (t->tile_h - 1) * c->stride + c->kh;
    t->in_w = (t->tile_w - 1) * c->stride + c->kw;
}

static struct tiling plan_tiles(const struct layer_conv *c)
{
    struct tiling t = {.out_h = conv_size(c->h, c->kh, c->stride, c->pad),
                       .out_w = conv_size(c->w_px, c->kw, c->stride, c->pad)};
    t.tile_h = num_min(t.out_h, LAYER_TILE_H);
    t.tile_w = num_min(t.out_w, LAYER_TILE_W);
    for (size_tile(&t, c); tile_floats(&t, c) > TILE_FLOATS; size_tile(&t, c)) {
        if (t.tile_h > 1)
            t.tile_h = (t.tile_h + 1) / 2;
        else if (t.tile_w > 1)
            t.tile_w = (t.tile_w + 1) / 2;
        else
            break;
    }
    t.rows = (t.out_h + t.tile_h - 1) / t.tile_h;
    t.columns = (t.out_w + t.tile_w - 1) / t.tile_w;
    return t;
}

struct conv_room {
    struct layer_workspace room; // its q is that of the tile
    float *tile;                 // (in_h, in_w, channels)
};

struct conv_job {
    const struct run *r;
    const struct layer_conv *c;
    const struct layer_out *out;
    struct tiling t;
    struct conv_room *rooms;
};

static err_t layout_rooms(struct conv_job *j, struct arena *tmp, int threads)
{
    size_t n = tile_floats(&j->t, j->c);
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *j->rooms, &j->rooms);
    for (int i = 0; !e && i < threads; i++) {
        struct conv_room o;
        e = layer_workspace_init(&o.room, tmp, 1);
        if (!e)
            e = arena_alloc(tmp, n, sizeof(float), &o.tile);
        if (!e)
            e = arena_alloc(tmp, n, 1, &o.room.q);
        if (!e && !tmp->counts)
            j->rooms[i] = o;
    }
    return e;
}

/* Which way is taken depends on the machine. */
void layer_conv_plan(struct plan *p, const struct layer_conv *c)
{
    struct conv_job j = {.c = c, .t = plan_tiles(c)};
    const size_t mark = arena_mark(&p->tmp);
    if (layout_rooms(&j, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
    if (fftconv_possible(c))
        fftconv_plan(p, c);
}

/* The input of a tile of outputs from (y, x) on, zero beyond the map. */
static void fetch_tile(const struct conv_job *j, int y, int x, float *tile)
{
    const struct layer_conv *c = j->c;
    size_t ch = (size_t)c->channels, pitch = (size_t)j->t.in_w * ch;
    int y0 = y * c->stride - c->pad, x0 = x * c->stride - c->pad;
    int from = x0 < 0 ? 0 : x0, to = num_min(x0 + j->t.in_w, c->w_px);
    for (int i = 0; i < j->t.in_h; i++, tile += pitch) {
        if (y0 + i < 0 || y0 + i >= c->h || from >= to) {
            memset(tile, 0, pitch * sizeof *tile);
            continue;
        }
        size_t before = (size_t)(from - x0) * ch, n = (size_t)(to - from) * ch;
        memset(tile, 0, before * sizeof *tile);
        c->fetch(c->ctx, y0 + i, from, to - from, tile + before);
        memset(tile + before + n, 0, (pitch - before - n) * sizeof *tile);
    }
}

static void quantise_tile(const struct conv_job *j, struct conv_room *o)
{
    const struct gemm_kernels *k = &j->r->k->net;
    size_t n = tile_floats(&j->t, j->c);
    float top = k->absmax(o->tile, n);
    for (int i = 0; i < LAYER_ROWS; i++)
        o->room.scale[i] = top < FLT_MIN ? 0 : top / 127;
    k->quant(o->tile, n, top < FLT_MIN ? 0 : 127 / top, o->room.q);
}

static err_t conv_chunk(void *ctx, int chunk, int worker)
{
    const struct conv_job *j = ctx;
    const struct layer_conv *c = j->c;
    struct conv_room *o = j->rooms + worker;
    int y = chunk / j->t.columns * j->t.tile_h, x = chunk % j->t.columns * j->t.tile_w;
    int h = num_min(j->t.out_h - y, j->t.tile_h);
    int panels = count_panels(c->w), group = group_of(c->w);
    size_t ch = (size_t)c->channels, step = (size_t)c->stride * (size_t)j->t.in_w * ch;
    struct block b = {.k = &j->r->k->net,
                      .w = c->w,
                      .m = num_min(j->t.out_w - x, j->t.tile_w),
                      .lda = (size_t)c->stride * ch,
                      .seg_stride = (size_t)j->t.in_w * ch};
    bool s8 = c->w->type == PRECISION_S8 && !c->floats;
    fetch_tile(j, y, x, o->tile);
    if (c->w->rotate)
        b.k->hadamard(o->tile, (int)tile_floats(&j->t, c), c->w->rotate);
    if (s8)
        quantise_tile(j, o);
    for (int p = 0; p < panels; p += group)
        for (int i = 0; i < h; i++) {
            struct layer_out out = *j->out;
            out.out += ((size_t)(y + i) * (size_t)j->t.out_w + (size_t)x) * out.ldo;
            b.x = o->tile + (size_t)i * step;
            b.q = s8 ? o->room.q + (size_t)i * step : NULL;
            finish_panels(&b, p, num_min(panels - p, group), &out, &o->room);
        }
    return run_check(j->r, "network");
}

err_t layer_conv_run(const struct run *r, const struct layer_conv *c, const struct layer_out *out)
{
    bool s8 = c->w->type == PRECISION_S8 && !c->floats;
    if (fftconv_possible(c) && !(s8 && r->k->net.s8_beats_fft))
        return fftconv_run(r, c, out);
    struct conv_job j = {.r = r, .c = c, .out = out, .t = plan_tiles(c)};
    size_t mark = arena_mark(r->tmp);
    err_t e = layout_rooms(&j, r->tmp, pool_size(r->pool));
    if (!e)
        e = pool_for(r->pool, j.t.rows * j.t.columns, conv_chunk, &j);
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- inputs of convolutions ---- */

void layer_map_fetch(const void *ctx, int y, int x, int n, float *out)
{
    const struct layer_map *m = ctx;
    size_t count = (size_t)n * (size_t)m->c;
    const float *px = m->px + ((size_t)y * (size_t)m->w + (size_t)x) * (size_t)m->c;
    if (!m->relu) {
        memcpy(out, px, count * sizeof *out);
        return;
    }
    for (size_t i = 0; i < count; i++)
        out[i] = px[i] < 0 ? 0 : px[i]; // NaN stays
}

struct lerp { // between two samples
    int i0, i1;
    float t;
};

static struct lerp lerp_between(int i, int n_in, int n_out, bool align)
{
    float at;
    if (align)
        at = n_out > 1 ? (float)i * ((float)(n_in - 1) / (float)(n_out - 1)) : 0;
    else
        at = ((float)i + 0.5f) * ((float)n_in / (float)n_out) - 0.5f;
    at = at > 0 ? at : 0;
    int i0 = num_min((int)at, n_in - 1);
    return (struct lerp){i0, num_min(i0 + 1, n_in - 1), at - (float)i0};
}

void layer_resize_fetch(const void *ctx, int y, int x, int n, float *restrict out)
{
    const struct layer_resize *m = ctx;
    size_t c = (size_t)m->c, pitch = (size_t)m->w * c;
    struct lerp v = lerp_between(y, m->h, m->out_h, m->align);
    const float *upper = m->px + (size_t)v.i0 * pitch, *lower = m->px + (size_t)v.i1 * pitch;
    for (int i = 0; i < n; i++, out += c) {
        struct lerp u = lerp_between(x + i, m->w, m->out_w, m->align);
        const float *a = upper + (size_t)u.i0 * c, *b = upper + (size_t)u.i1 * c;
        const float *d = lower + (size_t)u.i0 * c, *e = lower + (size_t)u.i1 * c;
        for (size_t k = 0; k < c; k++) {
            float top = a[k] + u.t * (b[k] - a[k]), low = d[k] + u.t * (e[k] - d[k]);
            out[k] = top + v.t * (low - top);
        }
    }
}
