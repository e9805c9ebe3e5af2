/* The histograms of two views contain only surfaces that both show. Pairs of single pixels would be
 * biased: most pixels of one dark value are brighter ones with noise. */
#include "core/refine/response_refit.h"

#include "core/base/num.h"
#include "core/photo/response.h"
#include "core/photo/shade.h"
#include "core/stereo/visibility.h"

#include <math.h>
#include <string.h>

enum {
    PAIRS = 240,      // pairs of views that are compared at most
    SHARED_MIN = 500, // pixels that two views must have in common
    EACH = 3 * RESPONSE_QUANTILES,
    MEAN = 2 // px, least edge of the square that is averaged
};

static const float APART = 0.25f; // stops, least difference of exposures that are compared

struct refit {
    const struct views *v;
    struct visibility visibility;
    struct response_pair *pairs; // (PAIRS EACH)
    int n;
    uint32_t hist[2][3][256]; // counts over the surfaces that two views share
    int shared;
    double shade; // stops, sum over these of what the cameras add in the second less in the first
};

/* The square of n x n px around px (u, v). first: its upper left. */
static int square_around(const struct refit *f, int view, const float uv[2], int first[2])
{
    const struct extent *px = &f->v->extent[view];
    const int size[2] = {px->w, px->h}, n = num_max(f->visibility.depth->scale, MEAN);
    for (int k = 0; k < 2; k++)
        first[k] = num_max(0, num_min((int)(uv[k] - 0.5f * (float)n + 0.5f), size[k] - n));
    return n;
}

static bool is_masked(const struct refit *f, int view, const float uv[2])
{
    int first[2];
    const int n = square_around(f, view, uv, first);
    return views_hides_any(f->v, view, first[0], first[1], n);
}

/* Count the mean of the pixels around px (u, v). */
static void count_pixels(const struct refit *f, int view, const float uv[2], uint32_t (*hist)[256])
{
    const struct extent *px = &f->v->extent[view];
    int first[2], sum[3] = {0};
    const int n = square_around(f, view, uv, first);
    for (int i = 0; i < n * n; i++) {
        const size_t y = (size_t)(first[1] + i / n), x = (size_t)(first[0] + i % n);
        const uint8_t *p = views_rgb(f->v, view) + 3 * (y * (size_t)px->w + x);
        for (int c = 0; c < 3; c++)
            sum[c] += p[c];
    }
    for (int c = 0; c < 3; c++)
        hist[c][(sum[c] + n * n / 2) / (n * n)]++;
}

/* Stops that the camera of a view adds at px (u, v), mean of the colours: these share one curve. */
static double shade_at(const struct views *v, int view, const float uv[2])
{
    const struct extent *px = &v->extent[view];
    float stops[3];
    if (!v->shade)
        return 0;
    shade_stops(&v->shade[view].model,
                shade_r2(&v->shade[view], uv[0] / (float)px->w, uv[1] / (float)px->h), stops);
    return ((double)stops[0] + (double)stops[1] + (double)stops[2]) / 3;
}

/* Add the confirmed pixels of view i, and the same surfaces in view j, to the histograms. */
static void add_shared(struct refit *f, int i, int j, bool swap)
{
    const struct depthmaps *d = f->visibility.depth;
    const struct extent *map = &d->extent[i];
    for (int at = 0; at < map->w * map->h; at++) {
        const size_t k = map->at + (size_t)at;
        const float uvz[3] = {((float)(at % map->w) + 0.5f) * (float)d->scale,
                              ((float)(at / map->w) + 0.5f) * (float)d->scale, d->depth[k]};
        struct projected there;
        float point[3];
        if (!visibility_confident(&f->visibility, k))
            continue;
        visibility_unproject(&f->visibility, i, uvz, point);
        if (!visibility_project(&f->visibility, j, point, &there) ||
            !visibility_on_surface(&f->visibility, &there))
            continue;
        const float at_j[2] = {there.u, there.v};
        if (is_masked(f, i, uvz) || is_masked(f, j, at_j))
            continue;
        count_pixels(f, i, uvz, f->hist[swap]);
        count_pixels(f, j, at_j, f->hist[!swap]);
        const double more = shade_at(f->v, j, at_j) - shade_at(f->v, i, uvz);
        f->shade += swap ? -more : more;
        f->shared++;
    }
}

static void compare_views(struct refit *f, int i, int j)
{
    f->shared = 0;
    f->shade = 0;
    memset(f->hist, 0, sizeof f->hist);
    add_shared(f, i, j, false);
    add_shared(f, j, i, true);
    if (f->shared >= SHARED_MIN)
        f->n += response_quantiles(f->hist[0], f->hist[1],
                                   f->v->log2t[j] - f->v->log2t[i] + (float)(f->shade / f->shared),
                                   f->pairs + f->n);
}

static bool exposures_differ(const struct views *v, int i, int j)
{
    return i < j && fabsf(v->log2t[i] - v->log2t[j]) > APART;
}

/* Compare all pairs of views, or PAIRS of them at equal steps. */
static err_t compare_all_pairs(const struct run *r, struct refit *f)
{
    const int n = f->v->n;
    int all = 0, pair = 0;
    for (int k = 0; k < n * n; k++)
        all += exposures_differ(f->v, k / n, k % n);
    const int step = (all + PAIRS - 1) / PAIRS;
    for (int k = 0; k < n * n; k++) {
        if (!exposures_differ(f->v, k / n, k % n) || pair++ % step != 0)
            continue;
        err_t e = run_check(r, "refit");
        if (e)
            return e;
        compare_views(f, k / n, k % n);
    }
    return OK;
}

static err_t layout(struct refit *f, struct arena *tmp, int n_views)
{
    err_t e = visibility_layout(&f->visibility, tmp, n_views);
    return e ? e : arena_alloc(tmp, PAIRS * EACH, sizeof *f->pairs, &f->pairs);
}

size_t response_refit_plan(int n_views)
{
    struct arena tmp = arena_counter();
    struct refit f;
    return layout(&f, &tmp, n_views) ? SIZE_MAX : tmp.peak;
}

err_t response_refit_run(const struct run *r, const struct views *v, const struct depthmaps *depth,
                         struct tonemap *io)
{
    struct refit f = {.v = v};
    const size_t mark = arena_mark(r->tmp);
    err_t e = layout(&f, r->tmp, depth->n);
    if (!e) {
        visibility_set(&f.visibility, depth, v->cams);
        e = compare_all_pairs(r, &f);
    }
    if (!e && f.n >= EACH / 2)
        response_fit(f.pairs, f.n, v->mid_log2t, io);
    arena_reset(r->tmp, mark);
    return e;
}
