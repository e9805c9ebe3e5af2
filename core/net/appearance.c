/* Legend: V views, M patches of a view, P = M + 5 tokens of a view, d width of the branch; n = M
 * times the views of this rank, V M without a team.
 *
 * Attention (shared_attention.h) comes in blocks of query rows; the columns of the special tokens
 * are left out, and the others are multiplied by the values view by view, so that no (V M)^2 matrix
 * exists. Rows are divided by their sum after these products, which are linear. */
#include "core/net/appearance.h"

#include "core/base/num.h"
#include "core/net/finite.h"
#include "core/net/shared_attention.h"
#include "core/net/tap.h"
#include "core/photo/prep.h"

#include <math.h>
#include <string.h>

enum { ROWS = SHARED_ATTENTION_ROWS }; // queries of a block

#define NORM_EPS 1e-5f  // core/net/README.md 2.6, 2.8
#define SHARE_EPS 1e-6f // core/net/README.md 2.7, 2.8
#define RANGE_MIN 0.5f  // log2, core/photo/README.md 1.2

struct fusion {
    const struct run *r;
    const struct appearance_weights *w;
    const struct views *v;
    const struct tokens *t;
    struct shared_attention a;
    int d;    // width of the branch
    int m, n; // M, n
    int value_panels;
    struct irradiance *out;
    float *norm;       // (n, d) xn, later a hidden layer
    float *film;       // (views of this rank, 2 d) gamma, beta
    float *values;     // per view (value_panels, M, PANEL): d of the mean, d of the variance
    float *mean, *var; // (n, d)
    float *vis;        // (n, V)
    struct fusion_room *rooms;
};

/* Scratch of one worker. */
struct fusion_room {
    struct shared_attention_workspace attend;
    float *part;  // per view (ROWS, value_panels PANEL)
    double *mass; // (V)
};

static size_t value_pitch(const struct fusion *f)
{
    return (size_t)f->value_panels * PANEL;
}

static int panels_of(int n)
{
    return (n + PANEL - 1) / PANEL;
}

/* ---- exposures ---- */

void appearance_code(float stops, int n, float *out)
{
    double a = (double)stops * NUM_PI / 8;
    for (int i = 0; i < n; i += 2) {
        double angle = a * exp2((double)i / n);
        out[i] = (float)sin(angle);
        out[i + 1] = (float)cos(angle);
    }
}

float appearance_range(const struct views *v)
{
    float lo = v->log2t[0], hi = lo;
    for (int i = 1; i < v->n; i++) {
        lo = fminf(lo, v->log2t[i]);
        hi = fmaxf(hi, v->log2t[i]);
    }
    return fmaxf(hi - lo, RANGE_MIN);
}

static void tap_exposures(const struct fusion *f)
{
    int n = f->v->n;
    float *rel = f->mean; // not yet in use; n_views of it
    if (!tap_on(f->r))
        return;
    for (int i = 0; i < n; i++)
        rel[i] = f->v->log2t[i] - f->v->mid_log2t;
    tap_put(f->r,
            &(struct tap_tensor){.name = "hdr.rel_logt", .rank = 2, .shape = {1, n}, .data = rel});
    tap_put(f->r,
            &(struct tap_tensor){
                .name = "hdr.exp_embed", .rank = 3, .shape = {1, n, f->d}, .data = f->out->code});
    tap_put(f->r,
            &(struct tap_tensor){
                .name = "hdr.mid_log2t", .rank = 2, .shape = {1, 1}, .data = &f->v->mid_log2t});
}

/* Check, then tap. */
static err_t check_tokens(const struct fusion *f, const char *name, const float *px)
{
    err_t e = finite_check(f->r, name, FINITE_MAX, px, (size_t)f->n * (size_t)f->d);
    if (!e)
        tap_put(f->r, &(struct tap_tensor){
                          .name = name, .rank = 3, .shape = {1, f->n, f->d}, .data = px});
    return e;
}

/* ---- tokens ---- */

void appearance_fetch(const void *ctx, int y, int x, int n, float *restrict out)
{
    const struct appearance_picture *p = ctx;
    size_t plane = (size_t)p->size * (size_t)p->size;
    const float *px = p->planes + (size_t)y * (size_t)p->size + (size_t)x;
    for (size_t i = 0; i < (size_t)n; i++)
        for (size_t c = 0; c < 3; c++)
            out[3 * i + c] = px[c * plane + i];
}

static struct layer_conv patch_conv(const struct weight *w, int size, const void *ctx)
{
    return (struct layer_conv){.w = w,
                               .kh = NET_PATCH,
                               .kw = NET_PATCH,
                               .stride = NET_PATCH,
                               .pad = 0,
                               .channels = 3,
                               .h = size,
                               .w_px = size,
                               .fetch = appearance_fetch,
                               .ctx = ctx,
                               .floats = true};
}

static err_t layout_planes(float **planes, struct arena *tmp, int size)
{
    return arena_alloc(tmp, 3 * (size_t)size * (size_t)size, sizeof **planes, planes);
}

/* Appearance tokens, into out->scene, where they stay as the residual. */
static err_t embed_pictures(const struct fusion *f)
{
    size_t px = (size_t)f->v->size * (size_t)f->v->size, mark = arena_mark(f->r->tmp);
    float *planes;
    err_t e = layout_planes(&planes, f->r->tmp, f->v->size);
    for (int v = 0; v < f->t->n_own && !e; v++) {
        const struct appearance_picture picture = {planes, f->v->size};
        const struct layer_conv c = patch_conv(&f->w->patch_embed, f->v->size, &picture);
        float *out = f->out->scene + (size_t)v * (size_t)f->m * (size_t)f->d;
        prep_to_float(f->v->rgb + 3 * px * (size_t)(f->t->first + v), f->v->size, planes);
        e = layer_conv_run(f->r, &c, &(struct layer_out){.out = out, .ldo = (size_t)f->d});
    }
    arena_reset(f->r->tmp, mark);
    return e ? e : check_tokens(f, "hdr.patch_tokens", f->out->scene);
}

static void norm_rows(const struct fusion *f, const float *in, const float *g, const float *b,
                      float *out)
{
    const struct norm norm = {f->d, NORM_EPS, g, b};
    for (size_t i = 0; i < (size_t)f->n; i++)
        f->r->k->net.norm(&norm, in + i * (size_t)f->d, out + i * (size_t)f->d);
}

/* Mean tokens of the views of this rank, in their rows of (V, d). */
static void mean_tokens(const struct fusion *f, double *means)
{
    const size_t d = (size_t)f->d, m = (size_t)f->m;
    for (size_t v = 0; v < (size_t)f->t->n_own; v++)
        for (size_t c = 0; c < d; c++) {
            double sum = 0;
            for (size_t i = 0; i < m; i++)
                sum += f->norm[(v * m + i) * d + c];
            means[((size_t)f->t->first + v) * d + c] = sum / (double)m;
        }
}

/* Inputs of the modulation for each view of this rank: (.., 3 d) code, mean token, mean of the
 * means of all views. */
static void film_inputs(const struct fusion *f, const double *means, float *out)
{
    const size_t d = (size_t)f->d, n_views = (size_t)f->v->n;
    for (size_t c = 0; c < d; c++) {
        double all = 0;
        for (size_t v = 0; v < n_views; v++)
            all += means[v * d + c];
        for (size_t v = 0; v < (size_t)f->t->n_own; v++) {
            const size_t view = (size_t)f->t->first + v;
            out[v * 3 * d + c] = f->out->code[view * d + c];
            out[v * 3 * d + d + c] = (float)means[view * d + c];
            out[v * 3 * d + 2 * d + c] = (float)(all / (double)n_views);
        }
    }
}

static void tap_film(const struct fusion *f)
{
    size_t d = (size_t)f->d;
    for (int half = 0; half < 2; half++)
        tap_put(f->r, &(struct tap_tensor){.name = half ? "hdr.film_beta" : "hdr.film_gamma",
                                           .rank = 3,
                                           .shape = {1, f->v->n, f->d},
                                           .data = f->film + (half ? d : 0),
                                           .stride = {2 * d * (size_t)f->v->n, 2 * d, 1}});
}

/* out = b(relu(a(in))) over rows of d_in values; hidden: (m, d). */
static err_t run_mlp(const struct fusion *f, const struct mlp_weights *w, const struct layer_in *in,
                     float *hidden, const struct layer_out *out)
{
    size_t n = (size_t)w->a.n;
    err_t e =
        layer_run(f->r, &w->a, in, &(struct layer_out){.out = hidden, .ldo = n, .act = ACT_RELU});
    return e ? e : layer_run(f->r, &w->b, &(struct layer_in){hidden, n, in->m, true}, out);
}

/* Scratch of the modulation of `own` of the n_views. */
struct film_room {
    double *means; // (n_views, d)
    float *in;     // (own, 3 d)
    float *hidden; // (own, d)
};

static err_t layout_film(struct film_room *o, struct arena *tmp, const struct fusion *f,
                         int n_views)
{
    const size_t d = (size_t)f->d, own = (size_t)(f->n / f->m);
    err_t e = arena_alloc(tmp, (size_t)n_views * d, sizeof *o->means, &o->means);
    if (!e)
        e = arena_alloc(tmp, own * 3 * d, sizeof *o->in, &o->in);
    return e ? e : arena_alloc(tmp, own * d, sizeof *o->hidden, &o->hidden);
}

/* Gains and offsets of the values of each view of this rank. */
static err_t run_modulation(const struct fusion *f)
{
    size_t mark = arena_mark(f->r->tmp), d = (size_t)f->d;
    struct film_room o;
    err_t e = layout_film(&o, f->r->tmp, f, f->v->n);
    if (!e) {
        mean_tokens(f, o.means);
        e = team_gather(f->r->team, o.means, d * sizeof *o.means, f->v->n);
    }
    if (!e) {
        film_inputs(f, o.means, o.in);
        e = run_mlp(f, &f->w->film, &(struct layer_in){o.in, 3 * d, f->t->n_own, true}, o.hidden,
                    &(struct layer_out){.out = f->film, .ldo = 2 * d});
    }
    arena_reset(f->r->tmp, mark);
    if (!e)
        tap_film(f);
    return e;
}

/* ---- panels ---- */

/* Values of one view of this rank to panels; the mean's are modulated. flat: (M, d) each. */
static void pack_values(const struct fusion *f, int view, const float *mean, const float *var,
                        float *out)
{
    size_t d = (size_t)f->d, m = (size_t)f->m;
    const float *gamma = f->film + (size_t)view * 2 * d, *beta = gamma + d;
    for (size_t c = 0; c < value_pitch(f); c++) {
        float *to = out + c / PANEL * PANEL * m + c % PANEL;
        for (size_t i = 0; i < m; i++, to += PANEL)
            if (c < d)
                *to = mean[i * d + c] * (1 + gamma[c]) + beta[c];
            else
                *to = c < 2 * d ? var[i * d + c - d] : 0;
    }
}

static err_t layout_values(float **mean, float **var, struct arena *tmp, const struct fusion *f)
{
    const size_t n = (size_t)f->m * (size_t)f->d;
    err_t e = arena_alloc(tmp, n, sizeof **mean, mean);
    return e ? e : arena_alloc(tmp, n, sizeof **var, var);
}

/* Values of all views. */
static err_t project_values(const struct fusion *f)
{
    size_t d = (size_t)f->d, m = (size_t)f->m, each = m * value_pitch(f),
           mark = arena_mark(f->r->tmp);
    float *mean, *var;
    err_t e = layout_values(&mean, &var, f->r->tmp, f);
    for (int v = 0; v < f->t->n_own && !e; v++) {
        const struct layer_in in = {f->norm + (size_t)v * m * d, d, f->m, true};
        e = layer_run(f->r, &f->w->v_mean, &in, &(struct layer_out){.out = mean, .ldo = d});
        if (!e)
            e = layer_run(f->r, &f->w->v_var, &in, &(struct layer_out){.out = var, .ldo = d});
        if (!e)
            pack_values(f, v, mean, var, f->values + (size_t)(f->t->first + v) * each);
    }
    arena_reset(f->r->tmp, mark);
    return e ? e : team_gather(f->r->team, f->values, each * sizeof *f->values, f->v->n);
}

/* ---- attention ---- */

/* Row `row` of the attention map, without special tokens; overwrites the logits. */
static void tap_attention(const struct fusion *f, int row, const float *sum, float factor,
                          float *line)
{
    size_t m = (size_t)f->m;
    if (!tap_on(f->r))
        return;
    for (size_t v = 0; v < (size_t)f->v->n; v++)
        for (size_t i = 0; i < m; i++)
            line[v * m + i] = factor * sum[v * (m + NET_SPECIAL) + NET_SPECIAL + i];
    tap_put(f->r, &(struct tap_tensor){.name = "hdr.attn",
                                       .rank = 3,
                                       .shape = {1, f->n, f->n},
                                       .part = row,
                                       .parts = f->n,
                                       .data = line});
}

/* Mean and variance over the views of the values for query `row` (core/net/README.md 2.8).
 * sum: its attention; part: its products with the values of view 0, the next view `step` on. */
static void combine_views(const struct fusion *f, int row, const float *sum, const float *part,
                          const struct fusion_room *room)
{
    size_t d = (size_t)f->d, n_views = (size_t)f->v->n, step = ROWS * value_pitch(f);
    float *vis = f->vis + (size_t)row * n_views, *mean = f->mean + (size_t)row * d;
    float *var = f->var + (size_t)row * d, range = appearance_range(f->v);
    double all = 0;
    for (size_t v = 0; v < n_views; v++) {
        const float *from = sum + v * ((size_t)f->m + NET_SPECIAL) + NET_SPECIAL;
        room->mass[v] = 0;
        for (int i = 0; i < f->m; i++)
            room->mass[v] += from[i];
        all += room->mass[v];
    }
    float factor = (float)(1 / (all + SHARE_EPS));
    for (size_t v = 0; v < n_views; v++)
        vis[v] = (float)(room->mass[v] * factor / (all * factor + SHARE_EPS));
    for (size_t c = 0; c < d; c++) {
        float a = 0, centre = 0, spread = 0;
        for (size_t v = 0; v < n_views; v++) {
            a += vis[v] * factor * part[v * step + c];
            centre += vis[v] * factor * part[v * step + d + c];
        }
        for (size_t v = 0; v < n_views; v++) {
            float off = factor * part[v * step + d + c] - centre;
            spread += vis[v] * off * off;
        }
        mean[c] = a;
        var[c] = spread / range;
    }
    tap_attention(f, row, sum, factor, room->attend.logits);
}

static int blocks_of_view(const struct fusion *f)
{
    return (f->m + ROWS - 1) / ROWS;
}

static err_t fuse_block(void *ctx, int chunk, int worker)
{
    const struct fusion *f = ctx;
    const struct fusion_room *room = f->rooms + worker;
    int view = chunk / blocks_of_view(f), first = chunk % blocks_of_view(f) * ROWS;
    int rows = f->m - first < ROWS ? f->m - first : ROWS;
    size_t p = (size_t)f->m + NET_SPECIAL, pitch = shared_attention_pitch(&f->a),
           values = value_pitch(f);
    const float *sum = room->attend.sum;
    err_t e = shared_attention_rows(&f->a, view, first, rows, &room->attend);
    if (e)
        return e;
    for (size_t v = 0; v < (size_t)f->v->n; v++)
        f->r->k->net.f32(&(struct gemm_f32){.m = rows,
                                            .panels = f->value_panels,
                                            .segs = 1,
                                            .seg = f->m,
                                            .a = sum + v * p + NET_SPECIAL,
                                            .lda = pitch,
                                            .w = f->values + v * (size_t)f->m * values,
                                            .ldw = PANEL * (size_t)f->m,
                                            .c = room->part + v * ROWS * values,
                                            .ldc = values});
    for (int i = 0; i < rows; i++)
        combine_views(f, view * f->m + first + i, sum + (size_t)i * pitch,
                      room->part + (size_t)i * values, room);
    return OK;
}

static err_t layout_fuse(struct fusion *f, struct arena *tmp, int views, int threads)
{
    const size_t n_views = (size_t)views;
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *f->rooms, &f->rooms);
    for (int i = 0; i < threads && !e; i++) {
        struct fusion_room o;
        e = shared_attention_workspace_init(&f->a, tmp, &o.attend);
        if (!e)
            e = arena_alloc(tmp, n_views * ROWS * value_pitch(f), sizeof(float), &o.part);
        if (!e)
            e = arena_alloc(tmp, n_views, sizeof(double), &o.mass);
        if (!e && !tmp->counts)
            f->rooms[i] = o;
    }
    return e ? e : shared_attention_layout(&f->a, tmp);
}

static err_t fuse_views(struct fusion *f)
{
    size_t mark = arena_mark(f->r->tmp);
    err_t e = layout_fuse(f, f->r->tmp, f->v->n, pool_size(f->r->pool));
    if (!e)
        e = shared_attention_init(f->r, f->t, &f->a);
    if (!e)
        e = pool_for(f->r->pool, f->t->n_own * blocks_of_view(f), fuse_block, f);
    arena_reset(f->r->tmp, mark);
    return e;
}

/* ---- the stage ---- */

/* Fused statistics to tokens; the statistics are used up. */
static err_t finish_tokens(const struct fusion *f)
{
    size_t d = (size_t)f->d;
    const struct appearance_weights *w = f->w;
    tap_put(f->r, &(struct tap_tensor){
                      .name = "hdr.vis_w", .rank = 3, .shape = {1, f->n, f->v->n}, .data = f->vis});
    err_t e = check_tokens(f, "hdr.weighted_mean", f->mean);
    if (!e)
        e = check_tokens(f, "hdr.weighted_var", f->var);
    if (e)
        return e;
    norm_rows(f, f->mean, w->mean_g, w->mean_b, f->mean);
    norm_rows(f, f->var, w->var_g, w->var_b, f->var);
    e = run_mlp(f, &w->mean_out, &(struct layer_in){f->mean, d, f->n, true}, f->norm,
                &(struct layer_out){.out = f->out->scene, .ldo = d, .add = true});
    if (!e)
        e = run_mlp(f, &w->var_out, &(struct layer_in){f->var, d, f->n, true}, f->norm,
                    &(struct layer_out){.out = f->out->sens, .ldo = d});
    if (!e)
        e = check_tokens(f, "hdr.scene_tokens", f->out->scene);
    return e ? e : check_tokens(f, "hdr.sensitivity_tokens", f->out->sens);
}

static err_t layout(struct fusion *f, struct arena *keep, struct arena *tmp, int views)
{
    size_t n = (size_t)f->n, d = (size_t)f->d, n_views = (size_t)views;
    size_t own = n / (size_t)f->m;
    err_t e = arena_alloc(keep, n_views * d, sizeof(float), &f->out->code);
    if (!e)
        e = arena_alloc(keep, n * d, sizeof(float), &f->out->scene);
    if (!e)
        e = arena_alloc(keep, n * d, sizeof(float), &f->out->sens);
    if (!e)
        e = arena_alloc(tmp, n * d, sizeof(float), &f->norm);
    if (!e)
        e = arena_alloc(tmp, own * 2 * d, sizeof(float), &f->film);
    if (!e)
        e = arena_alloc(tmp, n_views * (size_t)f->m * value_pitch(f), sizeof(float), &f->values);
    if (!e)
        e = arena_alloc(tmp, n * d, sizeof(float), &f->mean);
    if (!e)
        e = arena_alloc(tmp, n * d, sizeof(float), &f->var);
    if (!e)
        e = arena_alloc(tmp, n * n_views, sizeof(float), &f->vis);
    return e;
}

static struct fusion fusion_of(const struct net *net, const struct team *team, int n_views,
                               int grid)
{
    int m = grid * grid, d = net->d.hdr;
    return (struct fusion){.w = &net->appearance,
                           .a = shared_attention_shape(&net->d, n_views, grid),
                           .d = d,
                           .m = m,
                           .n = team_own(team, n_views) * m,
                           .value_panels = panels_of(2 * d)};
}

void appearance_plan(struct plan *p, const struct net *net, int n_views, int size)
{
    struct fusion f = fusion_of(net, p->team, n_views, size / NET_PATCH);
    struct irradiance out;
    struct film_room film;
    const struct layer_conv conv = patch_conv(&f.w->patch_embed, size, NULL);
    float *x, *y;
    const size_t begin = arena_mark(&p->tmp);
    f.out = &out;
    err_t e = layout(&f, &p->keep, &p->tmp, n_views);
    const size_t mark = arena_mark(&p->tmp);
    if (!e)
        e = layout_planes(&x, &p->tmp, size);
    layer_conv_plan(p, &conv);
    arena_reset(&p->tmp, mark);
    if (!e)
        e = layout_film(&film, &p->tmp, &f, n_views);
    layer_plan(p, 3 * f.d);
    arena_reset(&p->tmp, mark);
    if (!e)
        e = layout_values(&x, &y, &p->tmp, &f);
    layer_plan(p, f.d);
    arena_reset(&p->tmp, mark);
    if (!e)
        e = layout_fuse(&f, &p->tmp, n_views, p->threads);
    arena_reset(&p->tmp, mark);
    layer_plan(p, f.d);
    if (e)
        plan_refuse(p);
    arena_reset(&p->tmp, begin);
}

err_t appearance_run(const struct run *r, const struct net *net, const struct views *v,
                     const struct tokens *t, struct irradiance *out)
{
    struct fusion f = fusion_of(net, r->team, v->n, t->grid);
    size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    f.r = r;
    f.v = v;
    f.t = t;
    f.out = out;
    err_t e = layout(&f, r->keep, r->tmp, v->n);
    if (!e) {
        for (int i = 0; i < v->n; i++)
            appearance_code(v->log2t[i] - v->mid_log2t, f.d, out->code + (size_t)i * (size_t)f.d);
        tap_exposures(&f);
        e = embed_pictures(&f);
    }
    if (!e) {
        norm_rows(&f, out->scene, f.w->ln_g, f.w->ln_b, f.norm);
        e = run_modulation(&f);
    }
    if (!e)
        e = project_values(&f);
    if (!e)
        e = fuse_views(&f);
    if (!e)
        e = finish_tokens(&f);
    arena_reset(r->tmp, tmp);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    } else if (r->progress) {
        r->progress(r->progress_ctx, "fusion", 1, 1, NULL);
    }
    return e;
}
