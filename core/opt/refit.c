#include "core/opt/refit.h"

#include "core/base/num.h"
#include "core/opt/response.h"
#include "core/splat/sight.h"

#include <math.h>

enum {
    LOOKS = 90000,    // pixels that are looked for in another view, all views together
    PAIRS_MIN = 1000, // fewer say less than histograms
    MEAN = 2          // px, least edge of the square whose mean is compared
};

static const float APART = 0.25f;                            // stops from which exposures differ
static const float BLACK = 3.0f / 255, WHITE = 251.0f / 255; // nothing is known beyond

struct refit {
    const struct views *v;
    struct sight sight;
    struct response_pair *pairs; // (3 LOOKS)
    int n;
};

/* Mean display values around px (u, v). */
static void mean_around(const struct refit *f, int view, const float uv[2], float out[3])
{
    const int size = f->v->size, n = num_max(f->sight.depth->scale, MEAN);
    int first[2], sum[3] = {0};
    for (int k = 0; k < 2; k++)
        first[k] = num_max(0, num_min((int)(uv[k] - 0.5f * (float)n + 0.5f), size - n));
    for (int i = 0; i < n * n; i++) {
        const size_t y = (size_t)(first[1] + i / n), x = (size_t)(first[0] + i % n);
        const uint8_t *p = f->v->rgb + 3 * (((size_t)view * (size_t)size + y) * (size_t)size + x);
        for (int c = 0; c < 3; c++)
            sum[c] += p[c];
    }
    for (int c = 0; c < 3; c++)
        out[c] = (float)sum[c] / (float)(n * n) / 255;
}

/* What pixel `at` of the map of view i shows there and in view j. */
static void compare(struct refit *f, int i, int j, int at)
{
    const struct depthmaps *d = f->sight.depth;
    const size_t k = (size_t)i * (size_t)d->size * (size_t)d->size + (size_t)at;
    const float uvz[3] = {((float)(at % d->size) + 0.5f) * (float)d->scale,
                          ((float)(at / d->size) + 0.5f) * (float)d->scale, d->depth[k]};
    struct sighting there;
    float point[3], a[3], b[3];
    if (!sight_sure(&f->sight, k))
        return;
    sight_point(&f->sight, i, uvz, point);
    if (!sight_look(&f->sight, j, point, &there) || !sight_same(&f->sight, &there))
        return;
    mean_around(f, i, uvz, a);
    mean_around(f, j, (const float[2]){there.u, there.v}, b);
    for (int c = 0; c < 3; c++) {
        const float lo = fminf(a[c], b[c]), hi = fmaxf(a[c], b[c]);
        if (lo >= BLACK && hi <= WHITE) // weight as in response.c
            f->pairs[f->n++] = (struct response_pair){a[c], b[c], f->v->log2t[j] - f->v->log2t[i],
                                                      sqrtf(lo * (1 - hi))};
    }
}

static bool differ(const struct views *v, int i, int j)
{
    return fabsf(v->log2t[i] - v->log2t[j]) > APART;
}

/* Pixels at equal steps, the first of them at another place in each pair of views. */
static err_t compare_all(const struct run *r, struct refit *f)
{
    const int n = f->v->n, pixels = f->sight.depth->size * f->sight.depth->size;
    double all = 0;
    for (int i = 0; i < n * n; i++)
        all += differ(f->v, i / n, i % n) ? pixels : 0;
    const int step = (int)fmin(1 + all / LOOKS, pixels);
    for (int i = 0, looks = 0, pair = 0; i < n * n; i++) {
        if (!differ(f->v, i / n, i % n))
            continue;
        err_t e = run_check(r, "refit");
        if (e)
            return e;
        for (int at = pair++ % step; at < pixels && looks < LOOKS; at += step, looks++)
            compare(f, i / n, i % n, at);
    }
    return OK;
}

size_t refit_plan(int n_views)
{
    return arena_add(sight_plan(n_views), arena_need(3 * LOOKS, sizeof(struct response_pair)));
}

err_t refit_run(const struct run *r, const struct views *v, const struct depthmaps *depth,
                struct tonemap *io)
{
    struct refit f = {.v = v};
    const size_t mark = arena_mark(r->tmp);
    err_t e = sight_init(r, depth, v->cams, &f.sight);
    if (!e)
        e = arena_alloc(r->tmp, 3 * LOOKS, sizeof *f.pairs, &f.pairs);
    if (!e)
        e = compare_all(r, &f);
    if (!e && f.n >= PAIRS_MIN)
        response_fit(f.pairs, f.n, v->mid_log2t, io);
    arena_reset(r->tmp, mark);
    return e;
}
