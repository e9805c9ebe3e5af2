/* Legend: V views of this rank (of all without a team), P = NET_SPECIAL + grid^2 tokens of a view,
 * C = embed. One residual stream of floats x (V, P, C) goes through everything; five special tokens
 * come first in each view, those of DINOv2 (class, registers) and then those of the aggregator
 * (camera, registers). */
#include "core/net/backbone.h"

#include "core/base/num.h"
#include "core/net/block.h"
#include "core/net/finite.h"
#include "core/net/layer.h"
#include "core/net/tap.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { TAP_NAME = 32 };

static const float DINO_EPS = 1e-6f, AGG_EPS = 1e-5f; // core/net/README.md 2.1, 2.3
static const float ROPE_BASE = 100;                   // core/net/README.md 2.3
/* ImageNet, core/net/README.md 2.1 */
static const float PIXEL_MEAN[3] = {0.485f, 0.456f, 0.406f};
static const float PIXEL_STD[3] = {0.229f, 0.224f, 0.225f};

struct stage {
    const struct run *r;
    const struct net *net;
    const struct views *v;
    struct tokens *t;
    float *x;                   // (V, P, C), the views of this rank
    const float *cosine, *sine; // (P, C / heads / 2)
    int done, total;            // blocks
};

/* ---- positions ---- */

/* Keys' cubic with a = -0.5. */
static double cubic_weight(double t)
{
    const double a = -0.5;
    t = fabs(t);
    if (t < 1)
        return ((a + 2) * t - (a + 3)) * t * t + 1;
    return t < 2 ? (((t - 5) * t + 8) * t - 4) * a : 0;
}

/* Taps of output i of an axis of n: weight[j] belongs to input *first + j. returns: their number.
 * */
static int axis_taps(int n, int i, int *first, float weight[NET_POS_GRID])
{
    double scale = (double)NET_POS_GRID / n, f = scale > 1 ? scale : 1, centre = (i + 0.5) * scale;
    double w[NET_POS_GRID] = {0}, sum = 0;
    int lo = (int)(centre - 2 * f + 0.5), hi = (int)(centre + 2 * f + 0.5);
    lo = lo > 0 ? lo : 0;
    hi = hi < NET_POS_GRID ? hi : NET_POS_GRID;
    for (int j = lo; j < hi; j++)
        sum += w[j - lo] = cubic_weight((j - centre + 0.5) / f);
    for (int j = lo; j < hi; j++)
        weight[j - lo] = (float)(w[j - lo] / sum);
    *first = lo;
    return hi - lo;
}

void backbone_positions(const float *grid, int width, int n, float *out)
{
    float down[NET_POS_GRID], across[NET_POS_GRID];
    size_t c = (size_t)width;
    memset(out, 0, (size_t)n * (size_t)n * c * sizeof *out);
    for (int at = 0; at < n * n; at++) {
        int y, x, rows = axis_taps(n, at / n, &y, down), columns = axis_taps(n, at % n, &x, across);
        float *to = out + (size_t)at * c;
        for (int tap = 0; tap < rows * columns; tap++) {
            int row = y + tap / columns, column = x + tap % columns;
            const float *from = grid + (size_t)(row * NET_POS_GRID + column) * c;
            const float w = down[tap / columns] * across[tap % columns];
            for (size_t i = 0; i < c; i++)
                to[i] += w * from[i];
        }
    }
}

/* ---- rotary embedding ---- */

static float round_bf16(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = (bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000;
    memcpy(&x, &bits, sizeof x);
    return x;
}

void backbone_angles(int n, int head, bool bf16, float *cosine, float *sine)
{
    int quarter = head / 4;
    for (int token = 0; token < NET_SPECIAL + n * n; token++) {
        int at = token - NET_SPECIAL, pos[2] = {at < 0 ? 0 : at / n + 1, at < 0 ? 0 : at % n + 1};
        for (int i = 0; i < 2 * quarter; i++) {
            float exponent = (float)(i % quarter) / (float)quarter;
            float frequency = 1 / powf(ROPE_BASE, exponent);
            float angle = (float)pos[i / quarter] * (bf16 ? round_bf16(frequency) : frequency);
            angle = bf16 ? round_bf16(angle) : angle;
            *cosine++ = cosf(angle);
            *sine++ = sinf(angle);
        }
    }
}

/* ---- patches ---- */

/* A view as input of the network: values of prep_to_float, normalised. */
struct pixels {
    const uint8_t *rgb; // (size, size, 3)
    int size;
    float value[3][256];
};

static void pixels_init(struct pixels *p, int size)
{
    p->size = size;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < 256; i++) {
            float v = ((float)i / 255.0f * 2.0f - 1.0f + 1.0f) * 0.5f;
            p->value[c][i] = (v - PIXEL_MEAN[c]) / PIXEL_STD[c];
        }
}

static void fetch_pixels(const void *ctx, int y, int x, int n, float *out)
{
    const struct pixels *p = ctx;
    const uint8_t *rgb = p->rgb + 3 * ((size_t)y * (size_t)p->size + (size_t)x);
    for (int i = 0; i < 3 * n; i++)
        out[i] = p->value[i % 3][rgb[i]];
}

static struct layer_conv patch_conv(const struct net *net, int size)
{
    return (struct layer_conv){.w = &net->patch_embed,
                               .kh = NET_PATCH,
                               .kw = NET_PATCH,
                               .stride = NET_PATCH,
                               .channels = 3,
                               .h = size,
                               .w_px = size,
                               .fetch = fetch_pixels};
}

/* view: among those of this rank. */
static float *view_tokens(const struct stage *s, int view)
{
    return s->x + (size_t)view * (size_t)s->t->n_tokens * (size_t)s->t->embed;
}

/* Special tokens: the first of each view, then its registers. */
static void set_special(const struct stage *s, int view, const float *first, const float *registers)
{
    size_t c = (size_t)s->t->embed;
    float *to = view_tokens(s, view);
    memcpy(to, first, c * sizeof *to);
    memcpy(to + c, registers, (NET_SPECIAL - 1) * c * sizeof *to);
}

/* ---- results of each step: checked, then tapped ---- */

/* The patches of all views. */
static err_t check_patches(const struct stage *s, const char *name)
{
    const struct tokens *t = s->t;
    size_t c = (size_t)t->embed;
    err_t e = OK;
    for (int v = 0; v < t->n_own && !e; v++)
        e = finite_check(s->r, name, FINITE_MAX, view_tokens(s, v) + NET_SPECIAL * c,
                         (size_t)t->grid * (size_t)t->grid * c);
    if (e)
        return e;
    tap_put(s->r, &(struct tap_tensor){.name = name,
                                       .rank = 3,
                                       .shape = {t->n_views, t->grid * t->grid, t->embed},
                                       .data = s->x + NET_SPECIAL * c,
                                       .stride = {(size_t)t->n_tokens * c, c, 1}});
    return OK;
}

static void tap_positions(const struct stage *s, const float *table)
{
    tap_put(s->r, &(struct tap_tensor){.name = "dino.pos_embed_interpolated",
                                       .rank = 3,
                                       .shape = {1, 1 + s->t->grid * s->t->grid, s->t->embed},
                                       .data = table});
}

static err_t check_stream(const struct stage *s, const char *stem, int i, bool global)
{
    const struct tokens *t = s->t;
    char name[TAP_NAME];
    struct tap_tensor whole = {.name = name, .rank = 3, .data = s->x};
    snprintf(name, sizeof name, "%s%02d", stem, i);
    err_t e = finite_check(s->r, name, FINITE_MAX, s->x,
                           (size_t)t->n_own * (size_t)t->n_tokens * (size_t)t->embed);
    if (e)
        return e;
    whole.shape[0] = global ? 1 : t->n_views;
    whole.shape[1] = global ? t->n_views * t->n_tokens : t->n_tokens;
    whole.shape[2] = t->embed;
    tap_put(s->r, &whole);
    return OK;
}

static void tap_keep(const struct stage *s, int layer, const float *keep)
{
    const struct tokens *t = s->t;
    char name[TAP_NAME];
    snprintf(name, sizeof name, "agg.keep%d", layer);
    tap_put(s->r, &(struct tap_tensor){.name = name,
                                       .rank = 4,
                                       .shape = {1, t->n_views, t->n_tokens, 2 * t->embed},
                                       .data = keep});
}

static void tap_fusion(const struct stage *s)
{
    const struct tokens *t = s->t;
    const int heads = s->net->d.heads;
    struct tap_tensor q = {.name = "fusion.q",
                           .rank = 4,
                           .shape = {1, heads, t->n_views * t->n_tokens, t->embed / heads},
                           .data = t->q};
    struct tap_tensor k = q;
    k.name = "fusion.k";
    k.data = t->k;
    tap_put(s->r, &q);
    tap_put(s->r, &k);
}

/* ---- stages ---- */

static struct block block_of(const struct net *net, const struct tokens *t, bool dino)
{
    return (struct block){.n_views = t->n_views,
                          .view_tokens = t->n_tokens,
                          .width = t->embed,
                          .heads = dino ? net->d.dino_heads : net->d.heads,
                          .floats = net->floats,
                          .eps = dino ? DINO_EPS : AGG_EPS};
}

static err_t run_block(struct stage *s, const struct block *b)
{
    err_t e = block_run(s->r, b);
    s->done++;
    if (!e && s->r->progress)
        s->r->progress(s->r->progress_ctx, "backbone", s->done, s->total, NULL);
    return e;
}

static err_t layout_table(float **table, struct arena *tmp, const struct tokens *t)
{
    const size_t patches = (size_t)t->grid * (size_t)t->grid;
    return arena_alloc(tmp, (1 + patches) * (size_t)t->embed, sizeof **table, table);
}

/* x = patches + positions, after the special tokens of DINOv2. */
static err_t embed_patches(struct stage *s)
{
    const struct net *net = s->net;
    const struct tokens *t = s->t;
    size_t c = (size_t)t->embed, patches = (size_t)t->grid * (size_t)t->grid;
    size_t mark = arena_mark(s->r->tmp);
    struct pixels px;
    struct layer_conv conv = patch_conv(net, s->v->size);
    float *table;
    conv.ctx = &px;
    pixels_init(&px, s->v->size);
    err_t e = layout_table(&table, s->r->tmp, t);
    for (int v = 0; v < t->n_own && !e; v++) {
        const struct layer_out out = {.out = view_tokens(s, v) + NET_SPECIAL * c, .ldo = c};
        px.rgb = s->v->rgb + 3 * (size_t)(t->first + v) * (size_t)s->v->size * (size_t)s->v->size;
        e = layer_conv_run(s->r, &conv, &out);
    }
    if (!e)
        e = check_patches(s, "dino.patch_embed");
    if (!e) {
        memcpy(table, net->pos_embed, c * sizeof *table);
        backbone_positions(net->pos_embed + c, t->embed, t->grid, table + c);
        tap_positions(s, table);
    }
    for (int v = 0; v < t->n_own && !e; v++) {
        float *x = view_tokens(s, v);
        set_special(s, v, net->cls_token, net->dino_registers);
        for (size_t i = 0; i < c; i++)
            x[i] += table[i];
        for (size_t i = 0; i < patches * c; i++)
            x[NET_SPECIAL * c + i] += table[c + i];
    }
    arena_reset(s->r->tmp, mark);
    return e;
}

static err_t norm_chunk(void *ctx, int chunk, int worker)
{
    const struct stage *s = ctx;
    const struct norm n = {s->t->embed, DINO_EPS, s->net->dino_norm_g, s->net->dino_norm_b};
    size_t c = (size_t)s->t->embed;
    float *x = view_tokens(s, chunk);
    (void)worker;
    for (size_t i = NET_SPECIAL; i < (size_t)s->t->n_tokens; i++)
        s->r->k->net.norm(&n, x + i * c, x + i * c);
    return OK;
}

static err_t run_dino(struct stage *s)
{
    const struct net *net = s->net;
    err_t e = embed_patches(s);
    for (int i = 0; i < net->d.dino_depth && !e; i++) {
        struct block b = block_of(net, s->t, true);
        b.w = net->dino + i;
        b.x = s->x;
        e = run_block(s, &b);
        if (!e)
            e = check_stream(s, "dino.block", i, false);
    }
    if (!e)
        e = pool_for(s->r->pool, s->t->n_own, norm_chunk, s);
    return e ? e : check_patches(s, "dino.patch_tokens");
}

/* Keys of block qk_layer, of all ranks. */
static err_t gather_keys(const struct stage *s)
{
    const struct tokens *t = s->t;
    const size_t heads = (size_t)s->net->d.heads;
    const size_t view = (size_t)t->n_tokens * (size_t)t->embed / heads;
    err_t e = OK;
    for (size_t h = 0; h < heads && !e; h++)
        e = team_gather(s->r->team, t->k + h * (size_t)t->n_views * view, view * sizeof *t->k,
                        t->n_views);
    return e;
}

/* Frame and global block i. */
static err_t run_pair(struct stage *s, int i)
{
    const struct net *net = s->net;
    struct tokens *t = s->t;
    struct block b = block_of(net, t, false);
    int kept = 0;
    while (kept < NET_KEEP && net->d.keep[kept] != i)
        kept++;
    float *keep = kept < NET_KEEP ? t->keep[kept] : NULL;
    b.x = s->x;
    b.cosine = s->cosine;
    b.sine = s->sine;
    b.ld_copy = 2 * (size_t)t->embed;
    b.copy = keep;
    b.w = net->frame + i;
    err_t e = run_block(s, &b);
    if (!e)
        e = check_stream(s, "agg.frame", i, false);
    if (e)
        return e;
    b.copy = keep ? keep + t->embed : NULL;
    b.w = net->global + i;
    b.global = true;
    b.q = i == net->d.qk_layer ? t->q : NULL;
    b.k = i == net->d.qk_layer ? t->k : NULL;
    e = run_block(s, &b);
    if (!e)
        e = check_stream(s, "agg.global", i, true);
    if (!e && b.k)
        e = gather_keys(s);
    if (e)
        return e;
    if (keep)
        tap_keep(s, i, keep);
    if (b.q)
        tap_fusion(s);
    return OK;
}

static err_t layout_angles(float **cosine, float **sine, struct arena *tmp, const struct net *net,
                           int n_tokens)
{
    const size_t n = (size_t)n_tokens * (size_t)(net->d.embed / net->d.heads / 2);
    err_t e = arena_alloc(tmp, n, sizeof **cosine, cosine);
    return e ? e : arena_alloc(tmp, n, sizeof **sine, sine);
}

static err_t run_aggregator(struct stage *s)
{
    const struct net *net = s->net;
    size_t c = (size_t)s->t->embed, head = c / (size_t)net->d.heads;
    float *cosine, *sine;
    err_t e = layout_angles(&cosine, &sine, s->r->tmp, net, s->t->n_tokens);
    if (e)
        return e;
    backbone_angles(s->t->grid, (int)head, net->d.rope_bf16, cosine, sine);
    s->cosine = cosine;
    s->sine = sine;
    for (int v = 0; v < s->t->n_own; v++) { // the first of all views is the reference
        size_t slot = s->t->first + v > 0;
        set_special(s, v, net->camera_token + slot * c,
                    net->register_token + slot * (NET_SPECIAL - 1) * c);
    }
    for (int i = 0; i < net->d.depth && !e; i++)
        e = run_pair(s, i);
    return e;
}

/* ---- memory ---- */

static struct tokens tokens_of(const struct net *net, const struct team *team, int n_views,
                               int size)
{
    int grid = size / NET_PATCH;
    return (struct tokens){.n_views = n_views,
                           .grid = grid,
                           .n_tokens = NET_SPECIAL + grid * grid,
                           .embed = net->d.embed,
                           .first = team_first(team, n_views, team_rank(team)),
                           .n_own = team_own(team, n_views)};
}

static size_t stream_floats(const struct tokens *t, int n_views)
{
    return (size_t)n_views * (size_t)t->n_tokens * (size_t)t->embed;
}

static err_t layout_tokens(struct tokens *t, struct arena *keep, const struct net *net)
{
    const size_t n = stream_floats(t, t->n_own);
    err_t e = OK;
    for (int k = 0; k < NET_KEEP && !e; k++)
        e = arena_alloc(keep, 2 * n, sizeof(float), &t->keep[k]);
    if (!e && net->d.appearance)
        e = arena_alloc(keep, n, sizeof(float), &t->q);
    if (!e && net->d.appearance)
        e = arena_alloc(keep, stream_floats(t, t->n_views), sizeof(float), &t->k);
    return e;
}

static err_t layout_stream(struct stage *s, struct arena *tmp, const struct tokens *t,
                           const struct team *team)
{
    const size_t rows = block_rows(team, t->n_views, t->n_tokens);
    return arena_alloc(tmp, rows * (size_t)t->embed, sizeof *s->x, &s->x);
}

void backbone_plan(struct plan *p, const struct net *net, int n_views, int size)
{
    struct tokens t = tokens_of(net, p->team, n_views, size);
    const struct layer_conv conv = patch_conv(net, size);
    const struct block dino = block_of(net, &t, true);
    struct block agg = block_of(net, &t, false);
    struct stage s;
    float *table, *cosine, *sine;
    const size_t mark = arena_mark(&p->tmp);
    err_t e = layout_tokens(&t, &p->keep, net);
    if (!e)
        e = layout_stream(&s, &p->tmp, &t, p->team);
    const size_t stream = arena_mark(&p->tmp);
    if (!e)
        e = layout_table(&table, &p->tmp, &t);
    layer_conv_plan(p, &conv);
    arena_reset(&p->tmp, stream);
    block_plan(p, &dino);
    if (!e)
        e = layout_angles(&cosine, &sine, &p->tmp, net, t.n_tokens);
    for (int i = 0; i < 2; i++) {
        agg.global = i;
        block_plan(p, &agg);
    }
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t backbone_run(const struct run *r, const struct net *net, const struct views *v,
                   struct tokens *out)
{
    *out = tokens_of(net, r->team, v->n, v->size);
    struct stage s = {.r = r, .net = net, .v = v, .t = out};
    err_t e = layout_tokens(out, r->keep, net);
    size_t mark = arena_mark(r->tmp);
    s.total = net->d.dino_depth + 2 * net->d.depth;
    if (!e)
        e = layout_stream(&s, r->tmp, out, r->team);
    if (!e)
        e = run_dino(&s);
    if (!e)
        e = run_aggregator(&s);
    arena_reset(r->tmp, mark);
    return e;
}
