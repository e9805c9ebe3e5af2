#include "sim/train/redraw.h"

#include "core/base/arena.h"
#include "core/base/cpu.h"
#include "core/base/gaussians.h"
#include "core/base/pool.h"
#include "core/splat/raster.h"

#include <string.h>

static err_t check_request(const struct redraw *q)
{
    if (q->n < 1 || q->n > GAUSSIANS_MAX || q->degree < 0 || q->degree > SH_DEGREE_MAX)
        return err_fail(ERR_ARG, "redraw: %d splats of degree %d, allowed are 1 to %d, 0 to %d",
                        q->n, q->degree, GAUSSIANS_MAX, SH_DEGREE_MAX);
    if (q->w < 1 || q->h < 1 || q->w > RASTER_SIDE_MAX || q->h > RASTER_SIDE_MAX)
        return err_fail(ERR_ARG, "redraw: a picture of %d x %d px, allowed are 1 to %d", q->w, q->h,
                        RASTER_SIDE_MAX);
    if (!q->planes || !q->radiance || !q->alpha || (q->up_radiance && !q->grad))
        return err_fail(
            ERR_ARG,
            "redraw: planes, radiance, alpha and (with up_radiance) grad must not be NULL");
    return OK;
}

/* Blocks of the gradient go to their splats; every splat is in exactly one. */
static void store_block(void *ctx, int first, int count, const float *grad, const float *seen)
{
    const struct redraw *q = ctx;
    for (int p = 0; p < gaussians_planes(q->degree); p++)
        for (int i = 0; i < count; i++)
            q->grad[(size_t)p * (size_t)q->n + (size_t)(first + i)] =
                seen[i] != 0 ? grad[p * SPLAT_BLOCK + i] : 0.0f;
}

static err_t layout_scene(const struct redraw *q, struct arena *a, struct gaussians *g,
                          struct raster *raster)
{
    err_t e = gaussians_init(g, a, q->n, q->degree);
    return e ? e : raster_init(raster, a, q->n, q->w, q->h, q->up_radiance != NULL);
}

static size_t memory_need(const struct redraw *q)
{
    struct arena a = arena_counter();
    struct gaussians g;
    struct raster raster;
    return layout_scene(q, &a, &g, &raster) ? SIZE_MAX : a.peak;
}

static err_t draw_picture(const struct run *r, const struct redraw *q)
{
    const float *c = q->camera;
    struct camera cam = {
        q->w, q->h, c[0], c[1], c[2], c[3], {c[4], c[5], c[6], c[7]}, {c[8], c[9], c[10]}};
    struct gaussians g;
    struct raster raster;
    err_t e = layout_scene(q, r->tmp, &g, &raster);
    if (e)
        return e;
    g.n = q->n;
    for (int p = 0; p < gaussians_planes(q->degree); p++)
        memcpy(g.plane[p], q->planes + (size_t)p * (size_t)q->n, (size_t)q->n * sizeof(float));
    struct raster_input in = {&g, &cam, {q->background[0], q->background[1], q->background[2]}};
    struct render out = {q->w, q->h, q->radiance, q->depth, q->alpha};
    e = raster_run(r, &raster, &in, &out);
    if (e || !q->up_radiance)
        return e;
    struct render_grad up = {q->up_radiance, q->up_depth, q->up_alpha};
    struct raster_sink sink = {store_block, (void *)q, NULL, NULL};
    return raster_grad_run(r, &raster, &in, &up, &sink);
}

int redraw_run(const struct redraw *q)
{
    struct arena tmp = {0};
    struct pool *pool = NULL;
    err_t e = check_request(q);
    if (e)
        return e;
    e = arena_init(&tmp, "redraw", memory_need(q));
    if (!e)
        e = pool_open(&pool, q->threads);
    struct kernels k;
    kernels_init(&k, cpu_detect());
    struct run r = {.k = &k, .pool = pool, .tmp = &tmp};
    if (!e)
        e = draw_picture(&r, q);
    pool_close(pool);
    arena_free(&tmp);
    return e;
}
