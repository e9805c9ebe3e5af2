#include "sim/train/stereo.h"

#include "core/base/arena.h"
#include "core/base/cpu.h"
#include "core/kernels/kernels.h"
#include "core/photo/response.h"
#include "core/stereo/far.h"
#include "core/stereo/fill.h"

#include <string.h>

enum { SIDE_MAX = 256 }; // px, largest picture whose map has its size

static err_t check_request(const struct stereo_request *q)
{
    if (q->n < 2 || q->n > STEREO_VIEWS)
        return err_fail(ERR_ARG, "stereo: %d photographs, allowed are 2 to %d", q->n, STEREO_VIEWS);
    if (q->w < SWEEP_SIZE_MIN || q->h < SWEEP_SIZE_MIN || q->w > SIDE_MAX || q->h > SIDE_MAX)
        return err_fail(ERR_ARG, "stereo: %d x %d px, allowed are %d to %d", q->w, q->h,
                        SWEEP_SIZE_MIN, SIDE_MAX);
    if (!q->px || !q->log2t || !q->cams || !q->input || !q->guess)
        return err_fail(ERR_ARG, "stereo: px, log2t, cams, input and guess must not be NULL");
    return OK;
}

static void set_views(const struct stereo_request *q, struct extent *extent, struct camera *cams,
                      struct views *v)
{
    float lo = q->log2t[0], hi = lo;
    for (int i = 0; i < q->n; i++) {
        const float *c = q->cams + STEREO_CAMERA * i;
        extent[i] = (struct extent){q->w, q->h, (size_t)i * (size_t)q->w * (size_t)q->h};
        cams[i] = (struct camera){
            q->w, q->h, c[0], c[1], c[2], c[3], {c[4], c[5], c[6], c[7]}, {c[8], c[9], c[10]}};
        lo = q->log2t[i] < lo ? q->log2t[i] : lo;
        hi = q->log2t[i] > hi ? q->log2t[i] : hi;
    }
    *v = (struct views){.n = q->n,
                        .size = q->w > q->h ? q->w : q->h,
                        .extent = extent,
                        .rgb = (uint8_t *)(uintptr_t)q->px,
                        .log2t = (float *)(uintptr_t)q->log2t,
                        .mid_log2t = (lo + hi) / 2,
                        .cams = cams};
}

static void count_memory(struct plan *p, const struct views *v)
{
    struct fill f;
    const size_t mark = arena_mark(&p->tmp);
    arena_step(&p->tmp, response_plan(v));
    sweep_plan(p, v, v->extent);
    far_plan(p, v->extent, v->n);
    if (fill_layout(&f, &p->tmp, v->extent, v->n))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t describe_views(const struct run *r, const struct stereo_request *q,
                            const struct views *v)
{
    struct tonemap tone;
    struct depthmaps depth;
    struct fill f;
    err_t e = response_run(r, v, &tone);
    if (!e)
        e = sweep_run(r, v, &tone, &depth);
    if (!e)
        e = far_run(r, v, &tone, &depth);
    if (!e)
        e = fill_layout(&f, r->tmp, v->extent, v->n);
    if (e)
        return e;
    fill_set(&f, v, &tone, &depth);
    for (int i = 0; i < v->n; i++) {
        fill_input(&f, i, q->input + FILL_INPUT * v->extent[i].at);
        memcpy(q->guess + v->extent[i].at, f.rho, extent_pixels(&v->extent[i]) * sizeof *f.rho);
    }
    return OK;
}

int stereo_run(const struct stereo_request *q)
{
    struct arena tmp = {0}, keep = {0};
    struct extent extent[STEREO_VIEWS];
    struct camera cams[STEREO_VIEWS];
    struct views v;
    err_t e = check_request(q);
    if (e)
        return e;
    set_views(q, extent, cams, &v);
    struct plan p = plan_begin(1);
    count_memory(&p, &v);
    e = arena_init(&tmp, "stereo", p.tmp.peak);
    if (!e)
        e = arena_init(&keep, "stereo", p.keep.peak);
    struct kernels k;
    kernels_init(&k, cpu_detect());
    struct run r = {.k = &k, .tmp = &tmp, .keep = &keep};
    if (!e)
        e = describe_views(&r, q, &v);
    arena_free(&tmp);
    arena_free(&keep);
    return e;
}
