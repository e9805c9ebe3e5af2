#include "core/refine/correct.h"

#include "core/base/num.h"
#include "core/net/depth.h"
#include "core/photo/response.h"
#include "core/sfm/similarity.h"
#include "core/splat/rotate.h"
#include "core/splat/voxel.h"
#include "core/stereo/consensus.h"

#include <math.h>
#include <string.h>

static const float TIMES = 2;  // as much that another photograph must say
static const float LIKE = 1;   // stops between what may be one thing
static const float WIDEST = 1; // px, standard deviation of a Gaussian in its own view
static const float LN2 = 0.69314718f;

enum { DIMMEST = 2, BRIGHTEST = 252 }; // range of display values with a weight in response_tabulate
enum { CELLS = 1536 };
static const float END = 24, CELL = 48.0f / CELLS; // stops

/* ---- known cameras ---- */

struct known_cameras {
    struct prediction *p;
    const struct camera *own; // the network's cameras
    const struct run *r;
};

static err_t unproject_chunk(void *ctx, int view, int worker)
{
    const struct known_cameras *k = ctx;
    const size_t pixels = (size_t)k->p->geom.size * (size_t)k->p->geom.size;
    (void)worker;
    depth_unproject(&k->p->geom, view, k->p->points + 3 * pixels * (size_t)view);
    return OK;
}

static err_t move_to_cameras(const struct known_cameras *k)
{
    const struct geometry *g = &k->p->geom;
    const int pixels = g->size * g->size;
    err_t e = OK;
    for (int i = 0; i < g->n_views && !e && k->p->features; i++) {
        float turn[9];
        similarity_rotation(&k->own[i], &g->cams[i], turn);
        e = rotate_features(k->r, turn, k->p->features, (size_t)k->p->n,
                            (int[2]){i * pixels, pixels});
    }
    return e || !k->p->points
               ? e
               : pool_for(k->r->pool, g->n_views, unproject_chunk, (void *)(uintptr_t)k);
}

static err_t layout_sorted(float **sorted, struct arena *tmp, int n_views)
{
    return arena_alloc(tmp, (size_t)n_views, sizeof **sorted, sorted);
}

/* Each view's depth at its own scale over the median one. */
static err_t scale_depth(const struct run *r, const float *factor, struct geometry *g,
                         float *median)
{
    const size_t n = (size_t)g->n_views, pixels = (size_t)g->size * (size_t)g->size;
    float *sorted;
    err_t e = layout_sorted(&sorted, r->tmp, g->n_views);
    if (e)
        return e;
    memcpy(sorted, factor, n * sizeof *sorted);
    *median = num_median(sorted, n);
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < pixels; k++)
            g->depth[i * pixels + k] *= factor[i] / *median;
    return OK;
}

static err_t layout_own(struct camera **own, struct arena *tmp, int n_views)
{
    return arena_alloc(tmp, (size_t)n_views, sizeof **own, own);
}

void correct_cameras_plan(struct plan *p, int n_views)
{
    const size_t mark = arena_mark(&p->tmp);
    float *sorted;
    struct camera *own;
    arena_step(&p->tmp, similarity_plan(n_views));
    if (layout_sorted(&sorted, &p->tmp, n_views) || layout_own(&own, &p->tmp, n_views))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t correct_cameras(const struct run *r, const struct camera *cams, const float *depth_scale,
                      struct prediction *p, float *scale)
{
    struct geometry *g = &p->geom;
    const size_t n = (size_t)g->n_views, mark = arena_mark(r->tmp);
    struct camera *own;
    err_t e = depth_scale ? scale_depth(r, depth_scale, g, scale)
                          : similarity_scale(r, g->cams, cams, g->n_views, scale);
    if (!e)
        e = layout_own(&own, r->tmp, g->n_views);
    if (!e) {
        memcpy(own, g->cams, n * sizeof *own);
        memcpy(g->cams, cams, n * sizeof *own);
        for (size_t i = 0; i < n; i++)
            for (int k = 0; k < 3; k++)
                g->cams[i].t[k] /= *scale;
        e = move_to_cameras(&(struct known_cameras){p, own, r});
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* Keeps the views chosen in each of `planes` arrays of `from` views, one after another. */
static void keep_views(const bool *keep, int from, int planes, size_t bytes, void *data)
{
    char *to = data;
    for (int k = 0; k < planes; k++)
        for (int i = 0; i < from; i++)
            if (keep[i]) {
                memmove(to, (char *)data + bytes * ((size_t)k * (size_t)from + (size_t)i), bytes);
                to += bytes;
            }
}

void correct_drop(const bool *keep, float *depth_scale, struct prediction *p)
{
    struct geometry *g = &p->geom;
    const int n = g->n_views, pixels = g->size * g->size;
    const size_t bytes = (size_t)pixels * sizeof(float);
    keep_views(keep, n, 1, sizeof *depth_scale, depth_scale);
    keep_views(keep, n, 1, sizeof *g->cams, g->cams);
    keep_views(keep, n, 1, bytes, g->depth);
    if (p->points)
        keep_views(keep, n, 1, 3 * bytes, p->points);
    if (p->features) {
        keep_views(keep, n, VOXEL_FEATURES, bytes, p->features);
        keep_views(keep, n, 1, bytes, p->confidence);
    }
    for (int i = 0; i < n; i++)
        g->n_views -= !keep[i];
    p->n = g->n_views * pixels;
}

/* ---- what the photographs know better ---- */

struct correction {
    const struct correct_known *known;
    float scale;
    struct prediction *p;
    struct visibility visibility;
    struct response_table table; // tables of the photographs
    float (*moved)[CELLS + 1];   // (3) x of the known curve where it shows what the network's does
    float *depth;                // (n) in units of the maps
};

/* The input of softplus whose output is `factor` times as large, `most` at most. */
static float scale_softplus(float x, float factor, double most)
{
    double y = (x > 20 ? (double)x : log1p(exp((double)x))) * (double)factor;
    y = fmin(y, most);
    return y > 20 ? (float)y : (float)log(expm1(fmax(y, 1e-30)));
}

static void move_pixel(const struct correction *s, int view, size_t i, float depth)
{
    const size_t n = (size_t)s->p->n;
    float *scales = s->p->features + VOXEL_SCALE * n + i, *mine = &s->p->geom.depth[i];
    const float pixel = depth / s->p->geom.cams[view].fx / VOXEL_SCALE_UNIT;
    for (size_t k = 0; k < 3; k++)
        scales[k * n] = scale_softplus(scales[k * n], depth / *mine, (double)(WIDEST * pixel));
    *mine = depth;
}

/* Where pixel i of the view is in the maps. */
static size_t map_index(const struct correction *s, int view, int i)
{
    const int w = s->p->geom.size;
    return visibility_index(&s->visibility, view, (float)(i % w), (float)(i / w));
}

static bool pixel_masked(const struct correction *s, int view, int x, int y)
{
    return views_hides_any(s->known->seen.views, view, x, y, 1);
}

static const uint8_t *photo_pixel(const struct correction *s, int view, int x, int y)
{
    const struct views *v = s->known->seen.views;
    return views_rgb(v, view) + 3 * ((size_t)y * (size_t)v->extent[view].w + (size_t)x);
}

/* How much a pixel says about radiance, 0..1. */
static float pixel_weight(const struct correction *s, const uint8_t *rgb)
{
    const struct response_table *t = &s->table;
    return (t->weight[0][rgb[0]] + t->weight[1][rgb[1]] + t->weight[2][rgb[2]]) / 3;
}

/* log2 radiance that a display value stands for, from and to. */
static void radiance_range(const struct correction *s, int view, int c, int shown, float out[2])
{
    const struct views *v = s->known->seen.views;
    const struct response_table *t = &s->table;
    const float at = v->log2t[view] - v->mid_log2t;
    out[0] = out[1] = t->x[c][num_min(num_max(shown, DIMMEST), BRIGHTEST)] - at;
    if (t->weight[c][shown] == 0)
        out[shown > 127] = shown > 127 ? INFINITY : -INFINITY;
}

struct pixel {
    int view;
    bool sure;
    const uint8_t *rgb;
    float worth;
    float point[3]; // units of the maps
};

/* Whether the two cannot show one thing. */
static bool pixels_differ(const struct correction *s, const struct pixel *p, int view,
                          const uint8_t *rgb)
{
    for (int c = 0; c < 3; c++) {
        float a[2], b[2];
        radiance_range(s, p->view, c, p->rgb[c], a);
        radiance_range(s, view, c, rgb[c], b);
        if (a[0] > b[1] + LIKE || b[0] > a[1] + LIKE)
            return true;
    }
    return false;
}

enum verdict { SILENT, AGREES, DIFFERS, BETTER };

/* The verdict of view j on the pixel. A view whose depth is a guess may be anywhere
 * before what others are sure of, and behind anything else. */
static enum verdict ask_view(const struct correction *s, const struct pixel *p, int j)
{
    struct projected there;
    if (!visibility_project(&s->visibility, j, p->point, &there) ||
        pixel_masked(s, j, (int)there.u, (int)there.v))
        return SILENT;
    const uint8_t *rgb = photo_pixel(s, j, (int)there.u, (int)there.v);
    const bool knows = pixel_weight(s, rgb) > TIMES * p->worth;
    if (p->sure)
        return knows && visibility_on_surface(&s->visibility, &there) ? BETTER : SILENT;
    if (knows || visibility_in_front(&s->visibility, &there))
        return BETTER;
    if (visibility_behind(&s->visibility, &there))
        return SILENT;
    return pixels_differ(s, p, j, rgb) ? DIFFERS : AGREES;
}

/* Whether pixel i is masked, others know it better, or more of them show something else there than
 * the same. */
static bool pixel_refuted(const struct correction *s, int view, int i)
{
    const int w = s->p->geom.size;
    const float *at = s->p->points + 3 * ((size_t)view * (size_t)w * (size_t)w + (size_t)i);
    const uint8_t *rgb = photo_pixel(s, view, i % w, i / w);
    const struct pixel p = {view,
                            visibility_confident(&s->visibility, map_index(s, view, i)),
                            rgb,
                            pixel_weight(s, rgb),
                            {at[0] * s->scale, at[1] * s->scale, at[2] * s->scale}};
    int against = 0;
    if (pixel_masked(s, view, i % w, i / w))
        return true;
    for (int j = 0; j < s->p->geom.n_views; j++) {
        const enum verdict said = j == view ? SILENT : ask_view(s, &p, j);
        if (said == BETTER)
            return true;
        against += (said == DIFFERS) - (said == AGREES);
    }
    return against > 0;
}

/* The network's colour under the known curve, at the exposure of its photograph. */
static float graded_radiance(const float *table, float x, float *slope)
{
    const float at = fminf(fmaxf((x + END) / CELL, 0), CELLS - 0.01f);
    const int i = (int)at;
    *slope = (table[i + 1] - table[i]) / CELL;
    return table[i] + (at - (float)i) * (table[i + 1] - table[i]);
}

/* The photograph's own radiance, or, where it is black or saturated, the network's. */
static void colour_pixel(const struct correction *s, int view, int i)
{
    const struct views *net = s->known->views, *seen = s->known->seen.views;
    const size_t n = (size_t)s->p->n, w = (size_t)net->size;
    const uint8_t *rgb = photo_pixel(s, view, i % net->size, i / net->size);
    const float at_net = net->log2t[view] - net->mid_log2t;
    const float at_seen = seen->log2t[view] - seen->mid_log2t;
    for (size_t c = 0; c < 3; c++) {
        float *sh =
            s->p->features + (VOXEL_SH + SH_COEFS_MAX * c) * n + (size_t)view * w * w + (size_t)i;
        float slope = 0, x;
        if (s->table.weight[c][rgb[c]] > 0)
            x = s->table.x[c][rgb[c]] - at_seen;
        else
            x = graded_radiance(s->moved[c], *sh * (float)SH_BASIS0 / LN2 + at_net, &slope) -
                at_net;
        *sh = x * LN2 / (float)SH_BASIS0;
        for (size_t k = 1; k < SH_COEFS_MAX; k++)
            sh[k * n] *= slope;
    }
}

/* Unlike depth_unproject, at the middle of the pixel, whose colour the photograph tells. */
static void unproject_pixel(const struct correction *s, int view, int i, size_t k)
{
    const int w = s->p->geom.size;
    const float uvz[3] = {(float)(i % w) + 0.5f, (float)(i / w) + 0.5f, s->depth[k]};
    visibility_unproject(&s->visibility, view, uvz, s->p->points + 3 * k);
    for (size_t c = 0; c < 3; c++)
        s->p->points[3 * k + c] /= s->scale;
}

static err_t correct_view(void *ctx, int view, int worker)
{
    const struct correction *s = ctx;
    const int pixels = s->p->geom.size * s->p->geom.size;
    const size_t first = (size_t)view * (size_t)pixels;
    (void)worker;
    for (int i = 0; i < pixels; i++) {
        const size_t k = first + (size_t)i;
        move_pixel(s, view, k, s->depth[k] / s->scale);
        unproject_pixel(s, view, i, k);
        if (pixel_refuted(s, view, i))
            s->p->confidence[k] = NAN; // voxel_merge leaves it out
        if (!s->p->linear)
            colour_pixel(s, view, i);
    }
    return OK;
}

/* Beyond what both curves show (response_radiance_log) radiance is not guessed. */
static void tabulate_weights(struct correction *s)
{
    const struct tonemap *to = s->known->tone;
    response_tabulate(s->known->seen.tone, &s->table);
    for (int c = 0; c < 3; c++)
        for (int i = 0; i <= CELLS; i++) {
            const float shown = response_display(&s->p->tone, c, (float)i * CELL - END);
            s->moved[c][i] = response_radiance_log(to, c, shown, to->mid_log2t) / LN2;
        }
}

static err_t layout(struct correction *s, struct arena *tmp, int n_views, int size)
{
    const size_t n = (size_t)n_views * (size_t)size * (size_t)size;
    err_t e = visibility_layout(&s->visibility, tmp, n_views);
    if (!e)
        e = arena_alloc(tmp, 3, sizeof *s->moved, &s->moved);
    return e ? e : arena_alloc(tmp, n, sizeof *s->depth, &s->depth);
}

void correct_plan(struct plan *p, int n_views, int size)
{
    const size_t mark = arena_mark(&p->tmp);
    struct correction s;
    if (layout(&s, &p->tmp, n_views, size))
        plan_refuse(p);
    arena_step(&p->tmp, consensus_plan(n_views, size, p->threads));
    arena_reset(&p->tmp, mark);
}

err_t correct_run(const struct run *r, const struct correct_known *known, float scale,
                  struct prediction *p)
{
    struct correction s = {.known = known, .scale = scale, .p = p};
    const size_t mark = arena_mark(r->tmp);
    err_t e = layout(&s, r->tmp, p->geom.n_views, p->geom.size);
    if (!e) {
        visibility_set(&s.visibility, known->seen.depth, known->seen.views->cams);
        tabulate_weights(&s);
        for (int k = 0; k < p->n; k++)
            s.depth[k] = p->geom.depth[k] * scale;
        e = consensus_run(r, &s.visibility, s.depth);
    }
    if (!e)
        e = pool_for(r->pool, p->geom.n_views, correct_view, &s);
    if (!e && !p->linear)
        p->tone = *known->tone;
    arena_reset(r->tmp, mark);
    return e;
}
