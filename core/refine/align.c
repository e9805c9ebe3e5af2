#include "core/refine/align.h"

#include "core/photo/shade.h"
#include "core/refine/loss.h"
#include "core/sfm/pose.h"
#include "core/splat/raster.h"

#include <math.h>
#include <string.h>

static const float RATE = 1e-3f; // core/refine/README.md 1, C

struct align {
    const struct run *r;
    const struct scene *s;
    struct raster raster;
    struct loss loss;
    struct render pic;
    uint8_t *photo; // (3, h, w) of the current view
    float extent;   // scene units
};

static err_t layout(struct align *a, struct arena *tmp, int splats, const struct views *v,
                    int threads)
{
    const struct extent most = extent_cover(v->extent, v->n);
    err_t e = raster_init(&a->raster, tmp, splats > 0 ? splats : 1, most.w, most.h, true);
    if (!e)
        e = loss_init(&a->loss, tmp, most.w, most.h, threads);
    if (!e)
        e = arena_alloc(tmp, 3 * most.at, 1, &a->photo);
    if (!e)
        e = arena_alloc(tmp, 3 * most.at, 4, &a->pic.radiance);
    return e ? e : arena_alloc(tmp, most.at, 4, &a->pic.alpha);
}

size_t align_plan(int splats, const struct views *v, int threads)
{
    struct arena tmp = arena_counter();
    struct align a;
    return layout(&a, &tmp, splats, v, threads) ? SIZE_MAX : tmp.peak;
}

/* The scene is frozen: only the pose has a gradient. */
static void drop_gradients(void *ctx, int first, int count, const float *grad, const float *seen)
{
    (void)ctx, (void)first, (void)count, (void)grad, (void)seen;
}

/* Gradient of the loss of one photograph by the twist of its camera. */
static err_t twist_of(struct align *a, const struct views *v, int i, float twist[6])
{
    const struct camera *cam = &v->cams[i];
    const float *b = a->s->background;
    struct raster_input in = {&a->s->g, cam, {b[0], b[1], b[2]}};
    struct loss_input li = {.pic = &a->pic,
                            .tone = &a->s->tone,
                            .shift = v->log2t[i] - a->s->tone.mid_log2t,
                            .photo = a->photo,
                            .w_l1 = 0.2f,
                            .w_ssim = 0.8f};
    struct loss_output out;
    float pose[POSE_GRAD];
    err_t e = raster_run(a->r, &a->raster, &in, &a->pic);
    if (!e && v->shade)
        shade_apply(a->r->pool, &v->shade[i], a->pic.w, a->pic.h, a->pic.radiance);
    if (!e)
        e = loss_run(a->r, &a->loss, &li, &out);
    if (e)
        return e;
    if (v->shade)
        shade_apply(a->r->pool, &v->shade[i], a->pic.w, a->pic.h, a->loss.d_radiance);
    struct render_grad up = {a->loss.d_radiance, NULL, NULL};
    struct raster_sink sink = {drop_gradients, NULL, pose, NULL};
    e = raster_grad_run(a->r, &a->raster, &in, &up, &sink);
    if (!e)
        pose_twist_grad(cam, pose, twist);
    return e;
}

static err_t align_view(struct align *a, const struct views *v, int i, int iterations)
{
    const size_t px = extent_pixels(&v->extent[i]);
    const uint8_t *rgb = views_rgb(v, i);
    float m1[6] = {0}, m2[6] = {0}, ones[6] = {1, 1, 1, 1, 1, 1};
    for (size_t c = 0; c < 3; c++)
        for (size_t k = 0; k < px; k++)
            a->photo[c * px + k] = rgb[3 * k + c];
    for (int step = 0; step < iterations; step++) {
        float grad[6], move[6] = {0};
        err_t e = twist_of(a, v, i, grad);
        if (e)
            return e;
        float lr = RATE * powf(0.01f, (float)step / (float)iterations);
        struct adam_step rule = {lr,
                                 0.9f,
                                 0.999f,
                                 1e-15f,
                                 (float)(1 / (1 - pow(0.9, step + 1))),
                                 (float)(1 / (1 - pow(0.999, step + 1)))};
        a->r->k->adam(&rule, 3, ones, grad, move, m1, m2);
        rule.lr *= a->extent; // translations
        a->r->k->adam(&rule, 3, ones, grad + 3, move + 3, m1 + 3, m2 + 3);
        pose_move(&v->cams[i], move);
    }
    return OK;
}

err_t align_run(const struct run *r, const struct scene *s, int iterations, struct views *v)
{
    size_t mark = arena_mark(r->tmp);
    if (!v->cams || iterations < 0)
        return err_fail(ERR_ARG,
                        "align: %d iterations on views %s cameras, must be >= 0 with cameras",
                        iterations, v->cams ? "with" : "without");
    struct align a = {.r = r, .s = s};
    err_t e = layout(&a, r->tmp, s->g.n, v, pool_size(r->pool));
    a.extent = e ? 0 : pose_extent(&s->g, v->cams, v->n);
    for (int i = 0; i < v->n && !e; i++) {
        e = align_view(&a, v, i, iterations);
        if (!e && r->progress)
            r->progress(r->progress_ctx, "align", i + 1, v->n, NULL);
    }
    arena_reset(r->tmp, mark);
    return e;
}
