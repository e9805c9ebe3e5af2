/* Legend: V views, D = 2 embed. There are few rows (V) and many weights, so the pool divides the
 * outputs of a product, not its rows. */
#include "core/net/camera.h"

#include "core/base/rotation.h"
#include "core/net/finite.h"
#include "core/net/layer.h"
#include "core/net/tap.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum {
    ROUNDS = 4, // core/net/README.md 2.4
    MLP = 4,
    SLICE = 8 // panels of a product that a worker takes at a time
};

static const float EPS = 1e-5f, MODULATION_EPS = 1e-6f; // core/net/README.md 2.4
static const float FOV_FLOOR = 1e-3f;                   // added to the tangent
static const double FOV_MAX = 3.14059265358979323846;   // rad, pi - 1e-3

struct trunk {
    const struct run *r;
    const struct net *net;
    int n, width; // V, D
    struct layer_workspace *rooms;
    float *token; // (V, D) normalised camera tokens
    float *shift; // (V, 3 D) shift, scale, gate
    float *x;     // (V, D) residual stream
    float *y;     // (V, D) normalised, or result of attention
    float *wide;  // (V, 4 D)
    float *raw;   // (V, NET_POSE) before activation
    float *share; // (V) of one row of attention
};

/* ---- products ---- */

struct product {
    const struct trunk *t;
    const struct weight *w;
    const struct layer_in *in;
    const struct layer_out *out;
};

/* Outputs of panels [SLICE chunk, SLICE (chunk + 1)). */
static err_t product_chunk(void *ctx, int chunk, int worker)
{
    const struct product *p = ctx;
    const struct trunk *t = p->t;
    struct weight w = *p->w;
    struct layer_out out = *p->out;
    size_t elem = w.type == PRECISION_F32 ? 4 : w.type == PRECISION_BF16 ? 2 : 1;
    int first = chunk * SLICE * PANEL, left = w.n - first;
    if (t->r->cancel && atomic_load(t->r->cancel))
        return err_fail(ERR_CANCELLED, "cameras: cancelled");
    w.n = left < SLICE * PANEL ? left : SLICE * PANEL;
    w.panels = (const char *)w.panels + (size_t)first * (size_t)weight_k(&w) * elem;
    w.scale = w.scale ? w.scale + first : NULL;
    w.bias = w.bias ? w.bias + first : NULL;
    out.out += first;
    out.gamma = out.gamma ? out.gamma + first : NULL;
    layer_rows(&t->r->k->net, &w, p->in, &out, t->rooms + worker);
    return OK;
}

/* x: (V, k); out for all views, ldo is set here. */
static err_t run_product(const struct trunk *t, const struct weight *w, const float *x,
                         struct layer_out out)
{
    const struct layer_in in = {.x = x, .ldx = (size_t)weight_k(w), .m = t->n, .floats = true};
    struct product p = {t, w, &in, &out};
    out.ldo = (size_t)w->n;
    return pool_for(t->r->pool, (w->n + SLICE * PANEL - 1) / (SLICE * PANEL), product_chunk, &p);
}

static err_t check_rows(const struct trunk *t, const float *x, size_t each)
{
    return finite_check(t->r, "camera head", FINITE_MAX, x, (size_t)t->n * each);
}

static void normalise_rows(const struct trunk *t, const struct norm *s, const float *x, float *y)
{
    for (size_t i = 0; i < (size_t)t->n; i++)
        t->r->k->net.norm(s, x + i * (size_t)s->n, y + i * (size_t)s->n);
}

/* ---- blocks ---- */

/* Attention of view i over all views, one head, from t->wide (V, 3, D) to t->y. */
static void attend_view(const struct trunk *t, int i, size_t head, size_t width)
{
    size_t d = (size_t)t->width, n = (size_t)t->n;
    const float *q = t->wide + (size_t)i * 3 * d + head * width, *k = t->wide + d + head * width;
    const float *v = k + d, unit = 1 / sqrtf((float)width);
    float *out = t->y + (size_t)i * d + head * width, top = -INFINITY, sum = 0;
    for (size_t j = 0; j < n; j++) {
        float dot = 0;
        for (size_t c = 0; c < width; c++)
            dot += q[c] * k[j * 3 * d + c];
        t->share[j] = dot * unit;
        top = fmaxf(top, t->share[j]);
    }
    memset(out, 0, width * sizeof *out);
    for (size_t j = 0; j < n; j++) {
        float p = expf(t->share[j] - top);
        sum += p;
        for (size_t c = 0; c < width; c++)
            out[c] += p * v[j * 3 * d + c];
    }
    for (size_t c = 0; c < width; c++)
        out[c] /= sum;
}

static err_t run_block(const struct trunk *t, const struct block_weights *w)
{
    const struct norm norm1 = {t->width, EPS, w->norm1_g, w->norm1_b};
    const struct norm norm2 = {t->width, EPS, w->norm2_g, w->norm2_b};
    int heads = t->net->d.cam_heads;
    normalise_rows(t, &norm1, t->x, t->y);
    err_t e = run_product(t, &w->qkv, t->y, (struct layer_out){.out = t->wide});
    if (e)
        return e;
    for (int i = 0; i < t->n; i++)
        for (int h = 0; h < heads; h++)
            attend_view(t, i, (size_t)h, (size_t)(t->width / heads));
    e = run_product(t, &w->proj, t->y,
                    (struct layer_out){.out = t->x, .add = true, .gamma = w->gamma1});
    if (e)
        return e;
    normalise_rows(t, &norm2, t->x, t->y);
    e = run_product(t, &w->fc1, t->y, (struct layer_out){.out = t->wide, .act = ACT_GELU});
    if (!e)
        e = run_product(t, &w->fc2, t->wide,
                        (struct layer_out){.out = t->x, .add = true, .gamma = w->gamma2});
    return e ? e : check_rows(t, t->x, (size_t)t->width);
}

/* ---- rounds ---- */

/* x = token + gate (norm(token) (1 + scale) + shift); the pose so far gives these three. */
static err_t modulate_tokens(const struct trunk *t, bool first)
{
    const struct camera_weights *w = &t->net->camera;
    const struct norm plain = {t->width, MODULATION_EPS, NULL, NULL};
    size_t d = (size_t)t->width;
    for (size_t i = 0; i < (size_t)t->n && first; i++)
        memcpy(t->wide + i * NET_POSE, w->empty_pose, NET_POSE * sizeof(float));
    err_t e = run_product(t, &w->embed_pose, first ? t->wide : t->raw,
                          (struct layer_out){.out = t->y, .act = ACT_SILU});
    if (!e)
        e = run_product(t, &w->modulation, t->y, (struct layer_out){.out = t->shift});
    if (e)
        return e;
    normalise_rows(t, &plain, t->token, t->y);
    for (size_t i = 0; i < (size_t)t->n * d; i++) {
        const float *m = t->shift + i / d * 3 * d + i % d;
        t->x[i] = t->token[i] + m[2 * d] * (t->y[i] * (1 + m[d]) + m[0]);
    }
    return check_rows(t, t->x, d);
}

static err_t run_round(const struct trunk *t, bool first)
{
    const struct camera_weights *w = &t->net->camera;
    const struct norm last = {t->width, EPS, w->trunk_norm_g, w->trunk_norm_b};
    err_t e = modulate_tokens(t, first);
    for (int i = 0; i < t->net->d.cam_depth && !e; i++)
        e = run_block(t, w->trunk + i);
    if (e)
        return e;
    normalise_rows(t, &last, t->x, t->y);
    e = run_product(t, &w->fc1, t->y, (struct layer_out){.out = t->wide, .act = ACT_GELU});
    if (!e)
        e = run_product(t, &w->fc2, t->wide, (struct layer_out){.out = t->raw, .add = !first});
    return e ? e : check_rows(t, t->raw, NET_POSE);
}

/* Translation and quaternion as they are, fields of view above 0. */
static void activate_pose(const struct trunk *t, float *pose)
{
    for (int i = 0; i < t->n * NET_POSE; i++)
        pose[i] = i % NET_POSE < 7 || t->raw[i] > 0 ? t->raw[i] : 0;
}

/* ---- cameras ---- */

static float focal_of_fov(float fov, int size)
{
    double limited = fov > 0 ? fmin(fov, FOV_MAX) : 0;
    return (float)size / 2 / (tanf((float)(limited / 2)) + FOV_FLOOR);
}

void camera_decode(const float pose[NET_POSE], int size, struct camera *out)
{
    const float half = (float)size / 2;
    double x = pose[3], y = pose[4], z = pose[5], w = pose[6];
    double length = sqrt(x * x + y * y + z * z + w * w);
    *out = (struct camera){.w = size,
                           .h = size,
                           .fx = focal_of_fov(pose[8], size),
                           .fy = focal_of_fov(pose[7], size),
                           .cx = half,
                           .cy = half,
                           .q = {1, 0, 0, 0}};
    if (length > 0 && isfinite(length)) {
        const double q[4] = {w, x, y, z};
        for (int i = 0; i < 4; i++)
            out->q[i] = (float)(q[i] / length);
    }
    for (int i = 0; i < 3; i++)
        out->t[i] = isfinite(pose[i]) ? pose[i] : 0;
}

/* ---- taps ---- */

static void tap_pose(const struct trunk *t, int round, const float *pose)
{
    char name[32];
    snprintf(name, sizeof name, "camera.pose_enc_iter%d", round);
    tap_put(t->r, &(struct tap_tensor){
                      .name = name, .rank = 3, .shape = {1, t->n, NET_POSE}, .data = pose});
}

static void tap_cameras(const struct run *r, const struct geometry *g)
{
    struct tap_tensor matrix = {.name = "camera.extrinsic_w2c",
                                .rank = 4,
                                .shape = {1, g->n_views, 3, 4},
                                .parts = g->n_views};
    struct tap_tensor pixels = {.name = "camera.intrinsic_px",
                                .rank = 4,
                                .shape = {1, g->n_views, 3, 3},
                                .parts = g->n_views};
    for (int i = 0; i < g->n_views; i++) {
        const struct camera *c = g->cams + i;
        float rot[9];
        rotation_from_unit(c->q, rot);
        const float m[12] = {rot[0], rot[1],  rot[2], c->t[0], rot[3], rot[4],
                             rot[5], c->t[1], rot[6], rot[7],  rot[8], c->t[2]};
        const float k[9] = {c->fx, 0, c->cx, 0, c->fy, c->cy, 0, 0, 1};
        matrix.part = pixels.part = i;
        matrix.data = m;
        pixels.data = k;
        tap_put(r, &matrix);
        tap_put(r, &pixels);
    }
}

/* ---- run ---- */

static size_t room_inputs(const struct net *net)
{
    return MLP * 2 * (size_t)net->d.embed;
}

/* Floats per view of each array of struct trunk, in its order. */
static void array_widths(const struct net *net, size_t out[7])
{
    size_t d = 2 * (size_t)net->d.embed;
    const size_t w[7] = {d, 3 * d, d, d, MLP * d, NET_POSE, 1};
    memcpy(out, w, sizeof w);
}

static err_t layout_result(struct geometry *g, struct arena *keep, int n_views)
{
    err_t e = arena_alloc(keep, (size_t)n_views * NET_POSE, sizeof *g->pose, &g->pose);
    return e ? e : arena_alloc(keep, (size_t)n_views, sizeof *g->cams, &g->cams);
}

static err_t layout(struct trunk *t, struct arena *tmp, int threads)
{
    float **array[7] = {&t->token, &t->shift, &t->x, &t->y, &t->wide, &t->raw, &t->share};
    size_t w[7];
    array_widths(t->net, w);
    err_t e = layer_workspaces_init(tmp, threads, (int)room_inputs(t->net), &t->rooms);
    for (int i = 0; i < 7 && !e; i++)
        e = arena_alloc(tmp, (size_t)t->n * w[i], sizeof(float), array[i]);
    return e;
}

void camera_plan(struct plan *p, const struct net *net, int n_views)
{
    struct trunk t = {.net = net, .n = n_views};
    struct geometry g;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_result(&g, &p->keep, n_views) || layout(&t, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t run_rounds(const struct trunk *t, float *pose)
{
    err_t e = OK;
    for (int i = 0; i < ROUNDS && !e; i++) {
        e = run_round(t, i == 0);
        if (e)
            break;
        activate_pose(t, pose);
        tap_pose(t, i, pose);
    }
    return e;
}

err_t camera_run(const struct run *r, const struct net *net, const struct tokens *t, int size,
                 struct geometry *out)
{
    const struct camera_weights *w = &net->camera;
    struct trunk trunk = {.r = r, .net = net, .n = t->n_views, .width = 2 * t->embed};
    size_t mark = arena_mark(r->tmp), n = (size_t)t->n_views, d = 2 * (size_t)t->embed;
    *out = (struct geometry){.n_views = t->n_views, .size = size};
    err_t e = layout_result(out, r->keep, t->n_views);
    if (!e)
        e = layout(&trunk, r->tmp, pool_size(r->pool));
    if (!e) {
        const struct norm s = {2 * t->embed, EPS, w->token_norm_g, w->token_norm_b};
        for (size_t v = 0; v < (size_t)t->n_own; v++)
            r->k->net.norm(&s, t->keep[NET_KEEP - 1] + v * (size_t)t->n_tokens * d,
                           trunk.token + ((size_t)t->first + v) * d);
        e = team_gather(r->team, trunk.token, d * sizeof *trunk.token, t->n_views);
    }
    if (!e)
        e = run_rounds(&trunk, out->pose);
    for (size_t v = 0; v < n && !e; v++)
        camera_decode(out->pose + v * NET_POSE, size, out->cams + v);
    if (!e)
        tap_cameras(r, out);
    arena_reset(r->tmp, mark);
    return e;
}
