#include "core/stereo/fill.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/stereo/far.h"

#include <math.h>
#include <string.h>

enum {
    CELL = 4,        // px of the map
    SEEN_BY = 4,     // views, points
    OTHERS_MAX = 12, // views whose points are looked at
};

static const float STOPS = 6.0f; // light and inverse depth are limited to so many around the median

static const float SURE = -2.0f;       // ln of b below which a depth is usable: a tenth of it
static const float GUESSED = 0.29f;    // confidence of others: not usable
static const float ABOUT = 0.1f;       // relative difference of depths
static const float DOUBT = 3.0f;       // times b, where the branch overrules stereo
static const float DOUBT_LEAST = 0.1f; // stops: below, both mean the same surface
static const float IS_FAR = 1.0f, NOT_FAR = -1.0f; // logits
static const float SKY_LEAST = 0.01f; // share of all pixels; less are lamps and windows

static float limit(float x)
{
    return fminf(fmaxf(x, -STOPS), STOPS);
}

/* Of pixel i of the map, px of the view. */
static void pixel_centre(const struct depthmaps *d, int view, size_t i, float uv[2])
{
    const int w = d->extent[view].w;
    uv[0] = ((float)((int)i % w) + 0.5f) * (float)d->scale;
    uv[1] = ((float)((int)i / w) + 0.5f) * (float)d->scale;
}

err_t fill_layout(struct fill *f, struct arena *a, const struct extent *maps, int n)
{
    const size_t most = extent_cover(maps, n).at;
    err_t e = guess_layout(&f->guess, a, maps, n);
    if (!e)
        e = visibility_layout(&f->vis, a, n);
    if (!e)
        e = arena_alloc(a, most, sizeof *f->rho, &f->rho);
    return e ? e : arena_alloc(a, most, sizeof *f->sort, &f->sort);
}

void fill_set(struct fill *f, const struct views *v, const struct tonemap *tone,
              const struct depthmaps *depth)
{
    f->views = v;
    f->depth = depth;
    response_tabulate(tone, &f->table);
    visibility_set(&f->vis, depth, v->cams);
}

/* Light and weight of the pixels of the view that a pixel of the map covers. */
static void mean_light(const struct fill *f, int view, int i, float *out)
{
    const struct extent *px = &f->views->extent[view];
    const int s = f->depth->scale, w = f->depth->extent[view].w;
    const uint8_t *rgb = views_rgb(f->views, view);
    float sum[4] = {0};
    for (int k = 0; k < s * s; k++) {
        const int x = i % w * s + k % s, y = i / w * s + k / s;
        const size_t at = (size_t)y * (size_t)px->w + (size_t)x;
        const float third = views_hides(f->views, view, at) ? 0 : 1 / 3.0f;
        for (int c = 0; c < 3; c++) {
            const uint8_t z = rgb[3 * at + (size_t)c];
            sum[c] += f->table.x[c][z];
            sum[FILL_WEIGHT] += third * f->table.weight[c][z];
        }
    }
    for (int c = 0; c <= FILL_WEIGHT; c++)
        out[c] = sum[c] / (float)(s * s);
}

static void fill_light(struct fill *f, int view, float *out)
{
    const size_t n = extent_pixels(&f->depth->extent[view]);
    for (size_t i = 0; i < n; i++) {
        float *p = out + i * FILL_INPUT;
        mean_light(f, view, (int)i, p);
        f->sort[i] = (p[0] + p[1] + p[2]) / 3.0f;
    }
    const float middle = num_median(f->sort, n);
    for (size_t i = 0; i < 3 * n; i++)
        out[i / 3 * FILL_INPUT + i % 3] = limit(out[i / 3 * FILL_INPUT + i % 3] - middle) / 3.0f;
}

/* Median of log2 of the inverse depth where it is usable, else of all guesses. */
static float middle_rho(struct fill *f, int view)
{
    const struct extent *map = &f->depth->extent[view];
    const size_t all = extent_pixels(map);
    size_t n = 0;
    for (size_t i = 0; i < all; i++)
        if (f->depth->conf[map->at + i] >= SWEEP_CONF_USABLE && !sweep_far(f->depth, map->at + i))
            f->sort[n++] = -log2f(f->depth->depth[map->at + i]);
    for (size_t i = 0; n == 0 && i < all; i++)
        f->sort[i] = log2f(f->rho[i]);
    return num_median(f->sort, n ? n : all);
}

static void fill_depth(const struct fill *f, int view, float middle, float *out)
{
    const struct extent *map = &f->depth->extent[view];
    const struct camera *c = &f->views->cams[view];
    for (size_t i = 0; i < extent_pixels(map); i++) {
        const size_t at = map->at + i;
        const bool far = sweep_far(f->depth, at);
        float uv[2], *p = out + i * FILL_INPUT;
        pixel_centre(f->depth, view, i, uv);
        p[FILL_CONF] = f->depth->conf[at];
        p[FILL_USABLE] = !far && p[FILL_CONF] >= SWEEP_CONF_USABLE;
        p[FILL_STEREO] = limit(-log2f(f->depth->depth[at]) - middle) / 2.0f;
        p[FILL_FAR] = far;
        p[FILL_GUESS] = limit(log2f(f->rho[i]) - middle) / 2.0f;
        p[FILL_RAY] = (uv[0] - c->cx) / c->fx;
        p[FILL_RAY + 1] = (uv[1] - c->cy) / c->fy;
    }
}

/* Number of other views, up to SEEN_BY, in whose pictures the guess at pixel i is. */
static int count_seen(const struct fill *f, int view, int i)
{
    float uvz[3] = {0, 0, 1.0f / f->rho[i]};
    pixel_centre(f->depth, view, (size_t)i, uvz);
    float point[3];
    struct projected p;
    int seen = 0;
    visibility_unproject(&f->vis, view, uvz, point);
    for (int j = 0; j < f->depth->n && seen < SEEN_BY; j++)
        seen += j != view && visibility_project(&f->vis, j, point, &p);
    return seen;
}

/* Once per cell: it changes slowly. */
static void fill_seen(const struct fill *f, int view, float *out)
{
    const struct extent *map = &f->depth->extent[view];
    const int across = (map->w + CELL - 1) / CELL, down = (map->h + CELL - 1) / CELL;
    for (int k = 0; k < across * down; k++) {
        const int x0 = k % across * CELL, y0 = k / across * CELL;
        const int x = num_min(x0 + CELL / 2, map->w - 1), y = num_min(y0 + CELL / 2, map->h - 1);
        const float seen = (float)count_seen(f, view, y * map->w + x) / SEEN_BY;
        for (int i = 0; i < CELL * CELL; i++)
            if (x0 + i % CELL < map->w && y0 + i / CELL < map->h)
                out[((y0 + i / CELL) * map->w + x0 + i % CELL) * FILL_INPUT + FILL_SEEN] = seen;
    }
}

/* ---- what other views have measured ---- */

/* Squared, between the cameras. */
static double centre_distance(const struct fill *f, int a, int b)
{
    double p[3], q[3], sum = 0;
    rotation_centre(&f->vis.cams[a], p);
    rotation_centre(&f->vis.cams[b], q);
    for (int k = 0; k < 3; k++)
        sum += (p[k] - q[k]) * (p[k] - q[k]);
    return sum;
}

/* Whether view j is one of the OTHERS_MAX nearest ones. */
static bool is_near(const struct fill *f, int view, int j)
{
    const double d = centre_distance(f, view, j);
    int nearer = 0;
    for (int k = 0; k < f->depth->n && nearer < OTHERS_MAX; k++) {
        const double other = centre_distance(f, view, k);
        nearer += k != view && k != j && (other < d || (other <= d && k < j));
    }
    return j != view && nearer < OTHERS_MAX;
}

/* A point of another view in the input of this one; inverse depths as they are. */
static void add_point(const struct projected *p, const struct extent *map, float *out)
{
    float *to = out + (p->at - map->at) * FILL_INPUT;
    const float rho = 1.0f / p->z;
    to[FILL_NEAREST] = fmaxf(to[FILL_NEAREST], rho);
    to[FILL_FARTHEST] = to[FILL_OTHERS] > 0 ? fminf(to[FILL_FARTHEST], rho) : rho;
    to[FILL_OTHERS] = fminf(to[FILL_OTHERS] + 1.0f / SEEN_BY, 1.0f);
}

static void add_view(const struct fill *f, int view, int j, float *out)
{
    const struct extent *from = &f->depth->extent[j], *map = &f->depth->extent[view];
    for (size_t i = 0; i < extent_pixels(from); i++) {
        const size_t at = from->at + i;
        float point[3], uvz[3] = {0, 0, f->depth->depth[at]};
        struct projected p;
        if (!visibility_confident(&f->vis, at) || sweep_far(f->depth, at))
            continue;
        pixel_centre(f->depth, j, i, uvz);
        visibility_unproject(&f->vis, j, uvz, point);
        if (visibility_project(&f->vis, view, point, &p))
            add_point(&p, map, out);
    }
}

static void fill_others(const struct fill *f, int view, float middle, float *out)
{
    const size_t n = extent_pixels(&f->depth->extent[view]);
    for (size_t i = 0; i < n; i++)
        memset(out + i * FILL_INPUT + FILL_NEAREST, 0, (FILL_INPUT - FILL_NEAREST) * sizeof *out);
    for (int j = 0; j < f->depth->n; j++)
        if (is_near(f, view, j))
            add_view(f, view, j, out);
    for (size_t i = 0; i < n; i++) {
        float *p = out + i * FILL_INPUT;
        for (int k = FILL_NEAREST; k <= FILL_FARTHEST && p[FILL_OTHERS] > 0; k++)
            p[k] = limit(log2f(p[k]) - middle) / 2.0f;
    }
}

void fill_input(struct fill *f, int view, float *out)
{
    guess_smooth(&f->guess, f->depth, view, f->rho);
    const float middle = middle_rho(f, view);
    fill_light(f, view, out);
    fill_depth(f, view, middle, out);
    fill_seen(f, view, out);
    fill_others(f, view, middle, out);
}

/* ---- the answer ---- */

/* Whether another view has confirmed a surface about there, which is that view's to show. */
static bool is_measured(const struct fill *f, int view, const float uvz[3])
{
    bool found = false;
    float point[3];
    struct projected p;
    visibility_unproject(&f->vis, view, uvz, point);
    for (int j = 0; j < f->depth->n && !found; j++)
        found = j != view && visibility_project(&f->vis, j, point, &p) &&
                visibility_confident(&f->vis, p.at) &&
                fabsf(p.z / f->depth->depth[p.at] - 1.0f) < ABOUT;
    return found;
}

/* A depth that the branch is sure of is usable, but not confirmed; any other is a better guess. */
static float confidence_of(const struct fill *f, int view, const float uvz[3], const float *answer)
{
    return answer[FILL_SPREAD] < SURE && !is_measured(f, view, uvz) ? SWEEP_CONF_USABLE : GUESSED;
}

/* What a pixel sees of the shell: what far_run said holds unless the branch is sure of the
 * opposite. It knows skies, not black backdrops. */
static uint8_t sees_shell(uint8_t was, const float *answer)
{
    if (was == FAR_BLACK)
        return was;
    return answer[FILL_IS_FAR] > (was ? NOT_FAR : IS_FAR) ? FAR_SKY : 0;
}

void fill_look_for_sky(struct fill *f, const float *answer)
{
    const struct depthmaps *d = f->depth;
    const size_t pixels = extent_total(d->extent, d->n);
    size_t far = 0;
    for (size_t at = 0; at < pixels && d->far; at++)
        far += sees_shell(d->far[at], answer + FILL_ANSWER * at) == FAR_SKY;
    f->sky = (float)far >= SKY_LEAST * (float)pixels;
}

/* Whether stereo has no depth here, or one that the branch does not believe. */
static bool is_lost(float conf, const float *answer)
{
    const float off = fabsf(answer[FILL_RESIDUAL]);
    return conf < SWEEP_CONF_USABLE ||
           (off > DOUBT_LEAST && off > DOUBT * expf(answer[FILL_SPREAD]));
}

size_t fill_take(struct fill *f, int view, const float *answer, struct depthmaps *d)
{
    const struct extent *map = &d->extent[view];
    const struct shell shell = shell_of(f->views->cams, f->views->n);
    size_t taken = 0;
    guess_smooth(&f->guess, d, view, f->rho);
    for (size_t i = 0; i < extent_pixels(map); i++, answer += FILL_ANSWER) {
        const size_t at = map->at + i;
        const uint8_t was = sweep_far(d, at), far = was || f->sky ? sees_shell(was, answer) : 0;
        if (far == was && (far || !is_lost(d->conf[at], answer)))
            continue;
        float uvz[3] = {0, 0, 1.0f / (f->rho[i] * exp2f(limit(answer[FILL_RESIDUAL])))};
        pixel_centre(d, view, i, uvz);
        const float most =
            d->far ? shell_depth(&shell, &f->views->cams[view], uvz[0], uvz[1]) : INFINITY;
        uvz[2] = far ? most : fminf(uvz[2], SHELL_INSIDE * most);
        d->depth[at] = uvz[2];
        d->conf[at] = far ? FAR_CONF : confidence_of(f, view, uvz, answer);
        if (d->far)
            d->far[at] = far;
        taken++;
    }
    return taken;
}
