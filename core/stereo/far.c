/* 1. Pixels whose surroundings are smooth form regions.
 * 2. Each pixel of a region is looked up in the same direction in every other view: the same
 *    radiance there speaks for infinity, another one against it, and a surface that stereo knows
 *    there says nothing.
 * 3. A region is sky if nearly all that speaks speaks for infinity, if it is bright or a black
 *    backdrop, and if it reaches the border of the picture; then, if it looks as the sky of any
 *    view does.
 * 4. It grows over pixels that look like it, black ones even if stereo knows them, up to the
 *    silhouettes before it. */
#include "core/stereo/far.h"

#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/photo/response.h"

#include <math.h>
#include <string.h>

enum {
    RADIUS = 2,         // px, of the surroundings
    REGIONS_MAX = 1024, // of one view
    GROWN = 4,          // px
    BLOWN = 235,        // display value of 255 above which the response is hardly known
    BLACK = 16,         // and below which there is noise
    MOST = 9            // votes for one against, of what is as black as a black backdrop
};

static const float SMOOTH = 0.12f; // stops, standard deviation of luminance in the surroundings
static const float ALIKE = 0.4f;   // stops, two views of one thing
static const float OCCLUDER = 1;   // stop, what is darker than a region by that may hide it
static const float TELLS = 1;      // stop, between saturation and what a picture else shows
static const float ELSE = 0.9f;    // quantile of that
static const float GROWS = 0.3f;   // stops, the next pixel of a region
static const float LEAST = 0.03f;  // share of the picture, of a region that needs no other
static const float VAST = 0.15f;   // of a black one, which may be a shadow
static const float AGREE = 0.97f;  // share of the votes
static const float BRIGHT = 0.5f;  // quantile of the rest of the picture
static const float ASKED = 0.25f;  // votes per pixel

/* log2 radiance, and which colours are saturated, at least as bright as that, or black, at most. */
struct colour {
    float log2[3];
    float light; // log2 luminance
    uint8_t blown, black;
    bool hidden; // masked
};

struct region {
    int area, yes, weak, no; // votes: for, for if it is as bright as it may be, against
    bool border, sky;
    double light;       // sum
    double known[3][2]; // sum of log2 radiance and number of pixels of which it is known
    int blown;          // pixels with a saturated colour
    bool black;         // all its pixels are
};

struct far {
    const struct run *run;
    const struct views *v;
    struct depthmaps *d;
    struct shell shell;
    struct response_table table;
    struct colour *colour; // (maps)
    int32_t *label;        // (maps) region of a pixel, -1: none
    int32_t *stack;        // (workers, most pixels)
    float *sorted;         // (workers, most pixels)
    struct region *region; // (n, REGIONS_MAX)
    int *n_regions;        // (n)
    bool *telling;         // (n) what is saturated there is brighter than most
    bool *black_tells;     // (n) what is black there is darker than most, and in other views, too
    float black_level;     // log2 of what is as dark as BLACK, before the exposure of a view
    float darkest;         // log2 radiance below which the most sensitive view is black
    struct region sky;     // all that is sky
    bool black;            // some of it is a black backdrop
    size_t most;           // pixels of a map
};

/* ---- pictures ---- */

static struct colour mean_colour(const struct far *s, const uint8_t *rgb, int w, float shift)
{
    const int n = s->d->scale * s->d->scale;
    struct colour out = {.blown = 0};
    float all = 0;
    const float dark = s->black_level - shift;
    for (int c = 0; c < 3; c++) {
        float sum = 0, bright = 0;
        for (int k = 0; k < n; k++) {
            const size_t at = (size_t)(k / s->d->scale) * (size_t)w + (size_t)(k % s->d->scale);
            sum += s->table.linear[c][rgb[3 * at + (size_t)c]];
            bright += (float)rgb[3 * at + (size_t)c];
        }
        all += sum;
        out.log2[c] = log2f(sum / (float)n + 1e-9f) - shift;
        if (bright > (float)(BLOWN * n)) {
            out.blown |= (uint8_t)(1 << c);
            out.log2[c] = s->table.x[c][BLOWN] - shift;
        } else if (bright < (float)(BLACK * n)) {
            out.black |= (uint8_t)(1 << c);
            out.log2[c] = s->table.x[c][BLACK] - shift;
        }
    }
    out.light = fmaxf(log2f(all / (float)(3 * n) + 1e-9f) - shift, dark);
    return out;
}

static err_t read_view(void *ctx, int i, int worker)
{
    struct far *s = ctx;
    const struct extent *map = &s->d->extent[i];
    const int full = s->v->extent[i].w;
    const size_t scale = (size_t)s->d->scale;
    const float shift = s->v->log2t[i] - s->v->mid_log2t;
    float *sorted = s->sorted + (size_t)worker * s->most;
    size_t n = 0;
    for (int k = 0; k < map->w * map->h; k++) {
        size_t at = (size_t)(k / map->w) * scale * (size_t)full + (size_t)(k % map->w) * scale;
        struct colour *to = &s->colour[map->at + (size_t)k];
        *to = mean_colour(s, views_rgb(s->v, i) + 3 * at, full, shift);
        to->hidden = sweep_hides(s->d, s->v, i, k);
        if (to->blown != 7 && to->black != 7 && !to->hidden)
            sorted[n++] = to->light;
    }
    const bool shows = (float)n > LEAST * (float)extent_pixels(map);
    s->telling[i] = shows && s->table.x[1][BLOWN] - shift > num_quantile(sorted, n, ELSE) + TELLS;
    const float dark = s->black_level - shift;
    s->black_tells[i] =
        shows && dark < s->darkest + TELLS && dark < num_quantile(sorted, n, BRIGHT) - TELLS;
    return run_check(s->run, "far");
}

/* Whether two pixels may show the same thing. */
static bool is_alike(const struct colour *a, const struct colour *b)
{
    for (int c = 0; c < 3; c++) {
        const float more = a->log2[c] - b->log2[c];
        if ((more > ALIKE && !((b->blown | a->black) >> c & 1)) ||
            (more < -ALIKE && !((a->blown | b->black) >> c & 1)))
            return false;
    }
    return true;
}

static bool is_smooth(const struct colour *map, const struct extent *px, int x, int y)
{
    float n = 0, sum = 0, square = 0;
    const float centre = map[y * px->w + x].light;
    for (int k = 0; k < (2 * RADIUS + 1) * (2 * RADIUS + 1); k++) {
        const int u = x + k % (2 * RADIUS + 1) - RADIUS, v = y + k / (2 * RADIUS + 1) - RADIUS;
        if (u < 0 || v < 0 || u >= px->w || v >= px->h)
            continue;
        const float diff = map[v * px->w + u].light - centre;
        n++;
        sum += diff;
        square += diff * diff;
    }
    return square / n - sum / n * (sum / n) < SMOOTH * SMOOTH;
}

/* ---- votes ---- */

/* Pixel of view j in the direction of pixel (x, y) of view i; false outside. */
static bool same_direction(const struct far *s, const int ij[2], const float r[9], const int xy[2],
                           size_t *at)
{
    const struct camera *a = &s->v->cams[ij[0]], *b = &s->v->cams[ij[1]];
    const float scale = (float)s->d->scale;
    const struct extent *map = &s->d->extent[ij[1]];
    const float ray[3] = {(((float)xy[0] + 0.5f) * scale - a->cx) / a->fx,
                          (((float)xy[1] + 0.5f) * scale - a->cy) / a->fy, 1};
    float p[3];
    for (int k = 0; k < 3; k++)
        p[k] = r[3 * k] * ray[0] + r[3 * k + 1] * ray[1] + r[3 * k + 2] * ray[2];
    if (!(p[2] > 1e-6f))
        return false;
    const float u = (b->fx * p[0] / p[2] + b->cx) / scale,
                v = (b->fy * p[1] / p[2] + b->cy) / scale;
    if (!(u >= 0 && v >= 0 && u < (float)map->w && v < (float)map->h))
        return false;
    *at = map->at + (size_t)v * (size_t)map->w + (size_t)u;
    return true;
}

/* The vote of pixel `mine` of view ij[0] on pixel `at` of view ij[1], which is in its direction: 1
 * for infinity, 0 weakly so, -1 against it, -2 none. */
static int vote(const struct far *s, const int ij[2], const struct colour *mine, size_t at)
{
    const struct colour *other = &s->colour[at];
    const bool black = mine->black == 7;
    if (other->hidden)
        return -2;
    if (black ? other->black < 7 && other->light > s->darkest + ALIKE : !is_alike(mine, other)) {
        const bool blind = s->d->conf[at] < SWEEP_CONF_USABLE;
        return blind && other->light > mine->light - OCCLUDER ? -1 : -2;
    }
    if (black)
        return s->black_tells[ij[0]] || s->black_tells[ij[1]];
    return (mine->blown < 7 || s->telling[ij[0]]) && (other->blown < 7 || s->telling[ij[1]]);
}

static void count_agreement(const struct far *s, int i, struct region *regions)
{
    const struct extent *map = &s->d->extent[i];
    float ra[9], rb[9], r[9];
    rotation_from_unit(s->v->cams[i].q, ra);
    for (int j = 0; j < s->v->n; j++) {
        if (j == i)
            continue;
        rotation_from_unit(s->v->cams[j].q, rb);
        for (int k = 0; k < 9; k++) // of j times that of i transposed
            r[k] = rb[k / 3 * 3] * ra[k % 3 * 3] + rb[k / 3 * 3 + 1] * ra[k % 3 * 3 + 1] +
                   rb[k / 3 * 3 + 2] * ra[k % 3 * 3 + 2];
        for (int k = 0; k < map->w * map->h; k++) {
            const size_t own = map->at + (size_t)k;
            size_t at;
            if (s->label[own] < 0 || !same_direction(s, (const int[2]){i, j}, r,
                                                     (const int[2]){k % map->w, k / map->w}, &at))
                continue;
            struct region *region = &regions[s->label[own]];
            const int v = vote(s, (const int[2]){i, j}, &s->colour[own], at);
            region->yes += v == 1;
            region->weak += v == 0;
            region->no += v == -1;
        }
    }
}

/* ---- regions ---- */

static void add_pixel(struct region *r, const struct colour *p)
{
    r->area++;
    r->light += (double)p->light;
    r->blown += p->blown != 0;
    r->black = p->black == 7;
    for (int c = 0; c < 3; c++) {
        if ((p->blown | p->black) >> c & 1)
            continue;
        r->known[c][0] += (double)p->log2[c];
        r->known[c][1]++;
    }
}

/* Neighbours of pixel at: left, right, up, down; -1 outside.*/
static int neighbour_of(const struct extent *map, int at, int k)
{
    const int x = at % map->w + (k == 1) - (k == 0), y = at / map->w + (k == 3) - (k == 2);
    return x < 0 || y < 0 || x >= map->w || y >= map->h ? -1 : y * map->w + x;
}

/* The region of smooth pixels around `first`, all black or none; label -2, -3: smooth, black, not
 * yet part of one. */
static void flood_region(const struct far *s, int i, int first, int32_t *stack, int name)
{
    const struct extent *map = &s->d->extent[i];
    int32_t *label = s->label + map->at;
    struct region *r = &s->region[(size_t)i * REGIONS_MAX + (size_t)name];
    const int32_t kind = label[first];
    int n = 0;
    *r = (struct region){0};
    stack[n++] = first;
    label[first] = name;
    while (n > 0) {
        const int at = stack[--n];
        add_pixel(r, &s->colour[map->at + (size_t)at]);
        for (int k = 0; k < 4; k++) {
            const int next = neighbour_of(map, at, k);
            r->border |= next < 0;
            if (next < 0 || label[next] != kind)
                continue;
            label[next] = name;
            stack[n++] = next;
        }
    }
}

/* Luminance above which a region counts as bright: a quantile of what is not smooth; where there is
 * nothing else, none. */
static float median_brightness(const struct far *s, int i, float *sorted)
{
    const struct extent *map = &s->d->extent[i];
    size_t n = 0;
    for (size_t k = map->at; k < map->at + extent_pixels(map); k++)
        if ((s->label[k] < 0 || s->colour[k].black == 7) && !s->colour[k].hidden)
            sorted[n++] = s->colour[k].light;
    return (float)n > LEAST * (float)extent_pixels(map) ? num_quantile(sorted, n, BRIGHT)
                                                        : INFINITY;
}

static bool speaks_for_infinity(const struct region *r, int yes)
{
    return (float)yes >= AGREE * (float)(yes + r->no) && (float)yes >= ASKED * (float)r->area;
}

static bool is_large(const struct far *s, const struct region *r, int view)
{
    return r->border && (float)r->area >= LEAST * (float)extent_pixels(&s->d->extent[view]);
}

static err_t find_regions(void *ctx, int i, int worker)
{
    struct far *s = ctx;
    const struct extent *map = &s->d->extent[i];
    const int pixels = map->w * map->h;
    int32_t *label = s->label + map->at;
    struct region *regions = s->region + (size_t)i * REGIONS_MAX;
    for (int k = 0; k < pixels; k++) {
        const struct colour *c = &s->colour[map->at + (size_t)k];
        label[k] = -1;
        if (!c->hidden && is_smooth(s->colour + map->at, map, k % map->w, k / map->w))
            label[k] = c->black == 7 ? -3 : -2;
    }
    s->n_regions[i] = 0;
    for (int k = 0; k < pixels; k++) {
        if (label[k] < -1 && s->n_regions[i] == REGIONS_MAX)
            label[k] = -1;
        if (label[k] < -1)
            flood_region(s, i, k, s->stack + (size_t)worker * s->most, s->n_regions[i]++);
    }
    count_agreement(s, i, regions);
    const float bright = median_brightness(s, i, s->sorted + (size_t)worker * s->most);
    for (int k = 0; k < s->n_regions[i]; k++) {
        struct region *r = &regions[k];
        r->sky = is_large(s, r, i) && speaks_for_infinity(r, r->yes) &&
                 (2 * r->blown > r->area || (float)(r->light / r->area) >= bright ||
                  (r->black && (float)r->area > VAST * (float)pixels));
    }
    return run_check(s->run, "far");
}

/* Whether a region is as bright and has the colour of all that is sky, as far as both are known. */
static bool resembles_sky(const struct far *s, const struct region *r, int view)
{
    for (int c = 0; c < 3; c++) {
        const double n = r->known[c][1], all = s->sky.known[c][1];
        const double bound = (double)(s->table.x[c][BLOWN] - s->v->log2t[view] + s->v->mid_log2t);
        if (!(all > 0))
            return false;
        if (2 * n < r->area ? s->sky.known[c][0] / all < bound - (double)ALIKE
                            : fabs(r->known[c][0] / n - s->sky.known[c][0] / all) > (double)ALIKE)
            return false;
    }
    return true;
}

/* Regions that look like the sky of any view are sky. */
static void extend_sky(struct far *s)
{
    const int n = s->v->n * REGIONS_MAX;
    for (int k = 0; k < n; k++) {
        const struct region *r = &s->region[k];
        if (k % REGIONS_MAX >= s->n_regions[k / REGIONS_MAX] || !r->sky)
            continue;
        s->black |= r->black;
        for (int c = 0; c < 6; c++)
            s->sky.known[c / 2][c % 2] += r->known[c / 2][c % 2];
    }
    for (int k = 0; k < n; k++) {
        struct region *r = &s->region[k];
        const int view = k / REGIONS_MAX;
        if (k % REGIONS_MAX >= s->n_regions[view] || r->sky)
            continue;
        if (r->black)
            r->sky = s->black && is_large(s, r, view) && r->yes + r->weak >= MOST * r->no;
        else
            r->sky = resembles_sky(s, r, view) && speaks_for_infinity(r, r->yes + r->weak) &&
                     (2 * r->blown < r->area || is_large(s, r, view));
    }
}

/* ---- depth ---- */

/* Whether pixel k, which has no certain depth, continues the sky beside it. What is black has no
 * texture: its depth is that of a silhouette within the window that was matched. */
static bool region_continues(const struct far *s, const struct extent *map, int k)
{
    const struct colour *colour = s->colour + map->at;
    const int32_t *label = s->label + map->at;
    if (label[k] == 0 ||
        (colour[k].black < 7 && s->d->conf[map->at + (size_t)k] >= SWEEP_CONF_CONFIRMED))
        return false;
    for (int q = 0; q < 4; q++) {
        const int next = neighbour_of(map, k, q);
        if (next >= 0 && label[next] == 0 && fabsf(colour[next].light - colour[k].light) < GROWS)
            return true;
    }
    return false;
}

static void grow_regions(const struct far *s, int i, int32_t *stack)
{
    const struct extent *map = &s->d->extent[i];
    for (int round = 0; round < GROWN; round++) {
        int n = 0;
        for (int k = 0; k < map->w * map->h; k++)
            if (region_continues(s, map, k))
                stack[n++] = k;
        for (int k = 0; k < n; k++)
            s->label[map->at + (size_t)stack[k]] = 0;
    }
}

static err_t place_view(void *ctx, int i, int worker)
{
    struct far *s = ctx;
    const struct extent *map = &s->d->extent[i];
    const float scale = (float)s->d->scale;
    int32_t *label = s->label + map->at; // 0: sky
    for (int k = 0; k < map->w * map->h; k++)
        label[k] =
            label[k] >= 0 && s->region[(size_t)i * REGIONS_MAX + (size_t)label[k]].sky ? 0 : -1;
    grow_regions(s, i, s->stack + (size_t)worker * s->most);
    for (int k = 0; k < map->w * map->h; k++) {
        const size_t at = map->at + (size_t)k;
        const float most =
            shell_depth(&s->shell, &s->v->cams[i], ((float)(k % map->w) + 0.5f) * scale,
                        ((float)(k / map->w) + 0.5f) * scale);
        s->d->far[at] = label[k] != 0 ? 0 : s->colour[at].black == 7 ? FAR_BLACK : FAR_SKY;
        s->d->depth[at] = s->d->far[at] ? most : fminf(s->d->depth[at], SHELL_INSIDE * most);
        s->d->conf[at] = s->d->far[at] ? FAR_CONF : s->d->conf[at];
    }
    return run_check(s->run, "far");
}

/* ---- memory and entry ---- */

static err_t layout_far(struct depthmaps *d, struct arena *keep, size_t pixels)
{
    return arena_alloc(keep, pixels, sizeof *d->far, &d->far);
}

static err_t layout(struct far *s, struct arena *a, const struct extent *maps, int n, int workers)
{
    const size_t pixels = extent_total(maps, n);
    s->most = extent_cover(maps, n).at;
    err_t e = arena_alloc(a, pixels, sizeof *s->colour, &s->colour);
    if (!e)
        e = arena_alloc(a, pixels, sizeof *s->label, &s->label);
    if (!e)
        e = arena_alloc(a, (size_t)workers * s->most, sizeof *s->stack, &s->stack);
    if (!e)
        e = arena_alloc(a, (size_t)workers * s->most, sizeof *s->sorted, &s->sorted);
    if (!e)
        e = arena_alloc(a, (size_t)n * REGIONS_MAX, sizeof *s->region, &s->region);
    if (!e)
        e = arena_alloc(a, (size_t)n, sizeof *s->telling, &s->telling);
    if (!e)
        e = arena_alloc(a, (size_t)n, sizeof *s->black_tells, &s->black_tells);
    return e ? e : arena_alloc(a, (size_t)n, sizeof *s->n_regions, &s->n_regions);
}

void far_plan(struct plan *p, const struct extent *maps, int n)
{
    struct far s = {0};
    struct depthmaps d;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_far(&d, &p->keep, extent_total(maps, n)) || layout(&s, &p->tmp, maps, n, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t far_run(const struct run *r, const struct views *v, const struct tonemap *tone,
              struct depthmaps *d)
{
    struct far s = {.run = r, .v = v, .d = d, .shell = shell_of(v->cams, v->n)};
    const size_t mark = arena_mark(r->tmp);
    if (!(s.shell.radius > 0))
        return OK;
    err_t e = layout_far(d, r->keep, extent_total(d->extent, d->n));
    if (!e)
        e = layout(&s, r->tmp, d->extent, d->n, pool_size(r->pool));
    if (!e) {
        response_tabulate(tone, &s.table);
        s.black_level = s.table.x[1][BLACK];
        s.darkest = INFINITY;
        for (int i = 0; i < v->n; i++)
            s.darkest = fminf(s.darkest, s.black_level - (v->log2t[i] - v->mid_log2t));
        e = pool_for(r->pool, v->n, read_view, &s);
    }
    if (!e)
        e = pool_for(r->pool, v->n, find_regions, &s);
    if (!e) {
        extend_sky(&s);
        e = pool_for(r->pool, v->n, place_view, &s);
    }
    arena_reset(r->tmp, mark);
    return e;
}
