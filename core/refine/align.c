/* Gauss-Newton with Levenberg's damping, from small pictures to full ones. How the picture changes
 * when the camera moves follows from its own slope and the depth that is drawn beside it (Lucas,
 * Kanade, 1981), so a step costs one drawing and no backward pass. */
#include "core/refine/align.h"

#include "core/base/lin.h"
#include "core/photo/shade.h"
#include "core/photo/tonemap.h"
#include "core/refine/pyramid.h"
#include "core/sfm/pose.h"
#include "core/splat/raster.h"

#include <math.h>
#include <string.h>

enum {
    LEVELS = 3,         // pictures of level k are 2^k times smaller
    SMALLEST_EDGE = 80, // px
    STEPS = 12,         // at each level
    ROWS = 8,           // of a chunk
    TWIST = 6
};

static const float HUBER = 0.02f;   // display value: 5 codes of 255
static const float COVERED = 0.1f;  // alpha from which a pixel has a depth
static const double SETTLED = 1e-4; // relative gain of a step that is the last one of its level

/* Sums over pixels: the normal equations of the twist. */
struct normal {
    double h[TWIST * TWIST], g[TWIST]; // lower triangle
    double cost;
};

struct align {
    const struct run *r;
    const struct scene *s;
    struct raster raster;
    struct render pic;
    struct tonemap_table table;
    uint8_t *photo[LEVELS];   // planes (3, h, w)
    struct normal *part;      // of each chunk of rows
    const struct camera *cam; // of pic
    const uint8_t *target;    // photo[level]
    const struct views *v;    // which photographs
    int view, level;
};

static int count_levels(const struct extent *e)
{
    int n = 1;
    while (n < LEVELS && (e->w < e->h ? e->w : e->h) >> n >= SMALLEST_EDGE)
        n++;
    return n;
}

static int count_chunks(int h)
{
    return (h + ROWS - 1) / ROWS;
}

static err_t layout(struct align *a, struct arena *tmp, int splats, const struct views *v)
{
    const struct extent most = extent_cover(v->extent, v->n);
    err_t e = raster_init(&a->raster, tmp, splats > 0 ? splats : 1, most.w, most.h, false);
    for (int k = 0; k < LEVELS && !e; k++)
        e = arena_alloc(tmp, 3 * most.at >> 2 * k, 1, &a->photo[k]);
    if (!e)
        e = arena_alloc(tmp, 3 * most.at, 4, &a->pic.radiance);
    if (!e)
        e = arena_alloc(tmp, most.at, 4, &a->pic.depth);
    if (!e)
        e = arena_alloc(tmp, (size_t)count_chunks(most.h), sizeof *a->part, &a->part);
    return e ? e : arena_alloc(tmp, most.at, 4, &a->pic.alpha);
}

size_t align_plan(int splats, const struct views *v)
{
    struct arena tmp = arena_counter();
    struct align a;
    return layout(&a, &tmp, splats, v) ? SIZE_MAX : tmp.peak;
}

/* ---- one drawing ---- */

static float huber(float d, float *weight)
{
    const float size = fabsf(d);
    *weight = size <= HUBER ? 1 : HUBER / size;
    return size <= HUBER ? d * d / 2 : HUBER * (size - HUBER / 2);
}

/* The structure tensor of a pixel over its colours, weighted: xx xy yy, then slope times
 * difference: x y. */
static double structure_at(const struct align *a, size_t at, float out[5])
{
    const size_t w = (size_t)a->pic.w, px = w * (size_t)a->pic.h;
    double cost = 0;
    memset(out, 0, 5 * sizeof *out);
    for (size_t c = 0; c < 3; c++) {
        const float *x = a->pic.radiance + c * px + at;
        const float d = x[0] - (float)a->target[c * px + at] / 255;
        const float gx = (x[1] - x[-1]) / 2, gy = (x[w] - *(x - w)) / 2;
        float weight;
        cost += (double)huber(d, &weight);
        out[0] += weight * gx * gx;
        out[1] += weight * gx * gy;
        out[2] += weight * gy * gy;
        out[3] += weight * gx * d;
        out[4] += weight * gy * d;
    }
    return cost;
}

/* Motion of the pixel by the twist: rows for x and y, px per radian and per scene unit. */
static void motion_at(const struct camera *cam, int x, int y, float z, float jx[TWIST],
                      float jy[TWIST])
{
    const float a = ((float)x + 0.5f - cam->cx) / cam->fx,
                b = ((float)y + 0.5f - cam->cy) / cam->fy;
    const float p[TWIST] = {-a * b, 1 + a * a, -b, 1 / z, 0, -a / z};
    const float q[TWIST] = {-1 - b * b, a * b, a, 0, 1 / z, -b / z};
    for (int k = 0; k < TWIST; k++) {
        jx[k] = cam->fx * p[k];
        jy[k] = cam->fy * q[k];
    }
}

static void add_pixel(const struct align *a, int x, int y, struct normal *out)
{
    const size_t at = (size_t)y * (size_t)a->pic.w + (size_t)x;
    const float alpha = a->pic.alpha[at], z = a->pic.depth[at] / alpha;
    float s[5], jx[TWIST], jy[TWIST];
    if (views_hides_any(a->v, a->view, x << a->level, y << a->level, 1 << a->level))
        return;
    out->cost += structure_at(a, at, s);
    if (!(alpha > COVERED) || !(z > 0))
        return;
    motion_at(a->cam, x, y, z, jx, jy);
    for (int i = 0; i < TWIST; i++) {
        const float u = s[0] * jx[i] + s[1] * jy[i], v = s[1] * jx[i] + s[2] * jy[i];
        for (int k = 0; k <= i; k++)
            out->h[TWIST * i + k] += (double)(u * jx[k] + v * jy[k]);
        out->g[i] += (double)(s[3] * jx[i] + s[4] * jy[i]);
    }
}

static err_t rows_chunk(void *ctx, int chunk, int worker)
{
    const struct align *a = ctx;
    const int from = chunk * ROWS, to = from + ROWS;
    (void)worker;
    a->part[chunk] = (struct normal){.cost = 0};
    for (int y = from > 1 ? from : 1; y < to && y < a->pic.h - 1; y++)
        for (int x = 1; x < a->pic.w - 1; x++)
            add_pixel(a, x, y, &a->part[chunk]);
    return OK;
}

/* Draw the view from cam and compare it with its photograph, which has the same size. */
static err_t compare_view(struct align *a, const struct camera *cam, struct normal *out)
{
    const struct views *v = a->v;
    const int i = a->view;
    const float *b = a->s->background, shift = v->log2t[i] - a->s->tone.mid_log2t;
    const struct raster_input in = {&a->s->g, cam, {b[0], b[1], b[2]}};
    const size_t px = (size_t)cam->w * (size_t)cam->h;
    err_t e = raster_run(a->r, &a->raster, &in, &a->pic);
    if (e)
        return e;
    if (v->shade)
        shade_apply(a->r->pool, &v->shade[i], cam->w, cam->h, a->pic.radiance);
    for (size_t c = 0; c < 3; c++)
        tonemap_run(&a->table.c[c], a->pic.radiance + c * px, shift, px, a->pic.radiance + c * px);
    a->cam = cam;
    e = pool_for(a->r->pool, count_chunks(cam->h), rows_chunk, a);
    *out = (struct normal){.cost = 0};
    for (int n = 0; n < count_chunks(cam->h) && !e; n++) {
        for (int k = 0; k < TWIST * TWIST; k++)
            out->h[k] += a->part[n].h[k];
        for (int k = 0; k < TWIST; k++)
            out->g[k] += a->part[n].g[k];
        out->cost += a->part[n].cost;
    }
    return e;
}

/* ---- steps ---- */

/* False if the equations do not determine the twist. */
static bool solve_twist(const struct normal *n, double damping, float twist[TWIST])
{
    double h[TWIST * TWIST], x[TWIST];
    memcpy(h, n->h, sizeof h);
    memcpy(x, n->g, sizeof x);
    for (int k = 0; k < TWIST; k++)
        h[(TWIST + 1) * k] *= 1 + damping;
    if (!lin_cholesky(h, TWIST))
        return false;
    lin_solve(h, TWIST, x);
    for (int k = 0; k < TWIST; k++)
        twist[k] = (float)x[k];
    return true;
}

/* Move the camera of the view by pictures of one level. */
static err_t align_level(struct align *a, int level)
{
    const struct extent *px = &a->v->extent[a->view];
    struct camera *own = &a->v->cams[a->view];
    struct camera cam = pose_scaled(own, px->w >> level, px->h >> level);
    struct normal now, next;
    float twist[TWIST];
    double damping = 1e-3;
    a->target = a->photo[level];
    a->level = level;
    err_t e = compare_view(a, &cam, &now);
    for (int step = 0; step < STEPS && !e && solve_twist(&now, damping, twist); step++) {
        struct camera moved = cam;
        pose_move(&moved, twist);
        e = compare_view(a, &moved, &next);
        const bool better = !e && next.cost < now.cost;
        const bool settled = fabs(now.cost - next.cost) <= SETTLED * now.cost;
        damping *= better ? 0.1 : 10;
        if (better) {
            cam = moved;
            now = next;
        }
        if (settled)
            break;
    }
    memcpy(own->q, cam.q, sizeof own->q);
    memcpy(own->t, cam.t, sizeof own->t);
    return e;
}

static err_t align_view(struct align *a)
{
    const struct extent *px = &a->v->extent[a->view];
    const int levels = count_levels(px);
    err_t e = OK;
    pyramid_split(views_rgb(a->v, a->view), extent_pixels(px), a->photo[0]);
    for (int k = 1; k < levels; k++)
        pyramid_halve(a->photo[k - 1], px->w >> (k - 1), px->h >> (k - 1), a->photo[k]);
    for (int k = levels - 1; k >= 0 && !e; k--)
        e = align_level(a, k);
    return e;
}

err_t align_run(const struct run *r, const struct scene *s, struct views *v)
{
    size_t mark = arena_mark(r->tmp);
    if (!v->cams)
        return err_fail(ERR_ARG, "align: views without cameras");
    struct align a = {.r = r, .s = s, .v = v};
    err_t e = layout(&a, r->tmp, s->g.n, v);
    tonemap_table_init(&a.table, &s->tone);
    for (; a.view < v->n && !e; a.view++)
        e = align_view(&a);
    arena_reset(r->tmp, mark);
    return e;
}
