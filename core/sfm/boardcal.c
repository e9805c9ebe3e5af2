/* 1. Each lens from its photographs alone, as Zhang (PAMI 2000): several focal lengths, with and
 *    without a fisheye, are tried; the best fit wins.
 * 2. Poses of the board in each photograph, with that lens.
 * 3. A tree over cameras and takes, by links with many corners, chains the poses.
 * 4. Least squares of everything, with a loss that narrows; corners that do not agree are left out.
 *    Where white spreads over black (a response that saturates, blur before it), tags look smaller
 *    and gaps wider: that shift, one number a photograph, is taken from what is left over. */
#include "core/sfm/boardcal.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/boardpose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    PHOTOS = BOARDCAL_CAMERAS * BOARDCAL_TAKES,
    LENS_VIEWS = 12, // photographs that a lens begins with
    ROUNDS = 3,
    STEPS_START = 12,
    STEPS = 40,
    STEPS_REFINE = 8,
    PRINCIPAL = 1 + LENS_TERMS
};
static const double SIGMA = 0.1, SIGMA_LEAST = 0.02, // px, expected error of a corner
    WIDE = 4, NARROW = 3,                            // px; median errors: width of the loss
    GATE = 6, GATE_LEAST = 0.3,                      // median errors; px: of corners that agree
    FISHEYE_GAIN = 0.7,                              // of the cost, which a fisheye must reach
    POOR = 100,                                      // px^2, error of a pose that is none
    FOCAL_PRIOR = 10, NO_PRIOR = 1, // 1 / deviation of ln focal length: of EXIF data, or unknown
    TERM_PRIOR[LENS_TERMS] = {2, 2, 20, 20},
                    CENTRE_PRIOR = 50, // longer edge / expected shift of the principal point
    RAYLEIGH = 1.17741,                // median length of a vector of unit normals
    STRAIGHT = 0.1;                    // px: a lens that bends less is a pinhole

static const double fields[] = {60, 45, 75, 90, 110, 30}; // degrees

struct photo {
    int camera, take, first, n;
    double pose[BOARDFIT_POSE], error; // of the board in the camera; px^2
};

struct cal {
    const struct run *r;
    struct boardcal *in;
    struct boardcal_result *out;
    struct photo *photo; // (PHOTOS)
    int n_photos;
    struct boardfit_lens lens[BOARDCAL_CAMERAS];
    bool camera_free[BOARDCAL_CAMERAS], board_free[BOARDCAL_TAKES];
    struct boardfit_points points;
    float *error; // (corners) px
};

static err_t layout(struct cal *c, struct arena *tmp, int n_corners)
{
    err_t e = arena_alloc(tmp, PHOTOS, sizeof *c->photo, &c->photo);
    return e ? e : arena_alloc(tmp, (size_t)n_corners, sizeof *c->error, &c->error);
}

/* ---- photographs ---- */

static void list_photos(struct cal *c)
{
    const struct boardfit_corner *k = c->in->corner;
    c->n_photos = 0;
    for (int i = 0, n; i < c->in->n; i += n) {
        for (n = 1;
             i + n < c->in->n && k[i + n].camera == k[i].camera && k[i + n].take == k[i].take; n++)
            ;
        if (n >= BOARDCAL_LEAST && c->n_photos < PHOTOS)
            c->photo[c->n_photos++] =
                (struct photo){.camera = k[i].camera, .take = k[i].take, .first = i, .n = n};
    }
}

/* ---- one lens ---- */

/* Start of a lens: a focal length, no terms. */
static err_t begin_lens(const struct boardcal_lens *l, bool fisheye, double focal,
                        struct boardfit_lens *out)
{
    const bool pinhole = l->pinhole && !fisheye;
    memset(out, 0, sizeof *out);
    out->lens = (struct lens){.model = fisheye   ? LENS_OPENCV_FISHEYE
                                       : pinhole ? LENS_PINHOLE
                                                 : LENS_RADIAL,
                              .fx = focal,
                              .fy = focal,
                              .cx = 0.5 * l->w,
                              .cy = 0.5 * l->h};
    out->mean[0] = log(l->focal > 0 ? l->focal : focal);
    out->prior[0] = l->focal > 0 ? FOCAL_PRIOR : NO_PRIOR;
    out->free[0] = true;
    for (int k = 0; k < LENS_TERMS; k++) {
        out->free[1 + k] = fisheye || (!pinhole && k < 2);
        out->prior[1 + k] = TERM_PRIOR[k];
    }
    for (int k = 0; k < 2; k++) {
        out->mean[PRINCIPAL + k] = k == 0 ? out->lens.cx : out->lens.cy;
        out->prior[PRINCIPAL + k] = CENTRE_PRIOR / num_max(l->w, l->h);
    }
    return lens_init(&out->lens);
}

/* Photographs that a lens begins with, each as a take of one camera in the middle of the world. */
struct start {
    int n, n_corners;
    const struct photo *photo[LENS_VIEWS];
    struct boardfit_corner *corner;
    double camera[1][BOARDFIT_POSE], board[LENS_VIEWS][BOARDFIT_POSE];
    bool moves[LENS_VIEWS];
};

static err_t choose_views(const struct cal *c, int lens, struct start *v)
{
    v->n = v->n_corners = 0;
    for (int i = 0; i < c->n_photos; i++) {
        const struct photo *p = &c->photo[i];
        int at = v->n;
        if (c->in->lens_of[p->camera] != lens)
            continue;
        for (; at > 0 && v->photo[at - 1]->n < p->n; at--)
            if (at < LENS_VIEWS)
                v->photo[at] = v->photo[at - 1];
        if (at < LENS_VIEWS)
            v->photo[at] = p;
        v->n = num_min(v->n + 1, LENS_VIEWS);
    }
    for (int i = 0; i < v->n; i++)
        v->n_corners += v->photo[i]->n;
    err_t e = arena_alloc(c->r->tmp, (size_t)v->n_corners, sizeof *v->corner, &v->corner);
    struct boardfit_corner *to = v->corner;
    for (int i = 0; i < v->n && !e; i++)
        for (int k = 0; k < v->photo[i]->n; k++, to++) {
            *to = c->in->corner[v->photo[i]->first + k];
            to->camera = 0;
            to->take = i;
        }
    return e;
}

/* Fit one start of the lens; *cost of its corners. */
static err_t try_lens(const struct cal *c, struct start *v, struct boardfit_lens *l, double *cost)
{
    static const int lens_of[1] = {0};
    static const double middle[BOARDFIT_POSE] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
    bool fixed = false;
    struct boardfit b = {1,        v->n,   1,        v->n_corners, lens_of, l,  v->camera,
                         v->board, &fixed, v->moves, v->corner,    SIGMA,   {0}};
    err_t e = OK;
    memcpy(v->camera[0], middle, sizeof middle);
    *cost = INFINITY;
    for (int i = 0, at = 0; i < v->n && !e; at += v->photo[i++]->n) {
        double error;
        e = boardpose_find(c->r->tmp, &l->lens, v->corner + at, v->photo[i]->n, v->board[i],
                           &error);
        v->moves[i] = true;
        if (!e && !isfinite(error))
            return OK;
    }
    if (!e)
        e = boardfit_run(c->r->tmp, &b, WIDE, STEPS_START, cost);
    l->free[PRINCIPAL] = l->free[PRINCIPAL + 1] = true;
    return e ? e : boardfit_run(c->r->tmp, &b, WIDE, STEPS_START, cost);
}

/* The best of several starts. */
static err_t find_lens(struct cal *c, int lens)
{
    const struct boardcal_lens *l = &c->in->lens[lens];
    const size_t mark = arena_mark(c->r->tmp);
    const int n_fields = (int)(sizeof fields / sizeof fields[0]);
    struct start v;
    double best = INFINITY;
    err_t e = choose_views(c, lens, &v);
    for (int i = 0; i < 2 * n_fields && !e && v.n > 0; i++) {
        const double half = fields[i % n_fields] * NUM_PI / 360, edge = num_max(l->w, l->h);
        const bool fisheye = i >= n_fields;
        struct boardfit_lens start;
        double cost, focal = 0.5 * edge / (fisheye ? half : tan(half));
        if ((fisheye && l->pinhole) || (!fisheye && l->fisheye))
            continue;
        if (l->focal > 0 && i % n_fields > 0)
            continue;
        focal = l->focal > 0 ? l->focal : focal;
        e = begin_lens(l, fisheye, focal, &start);
        if (!e)
            e = try_lens(c, &v, &start, &cost);
        if (!e && cost < (fisheye && isfinite(best) ? FISHEYE_GAIN : 1) * best) {
            best = cost;
            c->lens[lens] = start;
        }
    }
    arena_reset(c->r->tmp, mark);
    if (!e && !isfinite(best)) // sees no board: as good as any
        e = begin_lens(l, l->fisheye, l->focal > 0 ? l->focal : num_max(l->w, l->h),
                       &c->lens[lens]);
    return e;
}

/* ---- the chain ---- */

static err_t find_poses(struct cal *c)
{
    err_t e = OK;
    for (int i = 0; i < c->n_photos && !e; i++) {
        struct photo *p = &c->photo[i];
        e = run_check(c->r, "board");
        if (!e)
            e = boardpose_find(c->r->tmp, &c->lens[c->in->lens_of[p->camera]].lens,
                               c->in->corner + p->first, p->n, p->pose, &p->error);
    }
    return e;
}

/* out = a b, as X = Ra (Rb X + tb) + ta. */
static void chain_poses(const double a[BOARDFIT_POSE], const double b[BOARDFIT_POSE],
                        double out[BOARDFIT_POSE])
{
    lin_product(a, b, out);
    lin_apply(a, b + 9, out + 9);
    for (int k = 0; k < 3; k++)
        out[9 + k] += a[9 + k];
}

static void invert_pose(const double a[BOARDFIT_POSE], double out[BOARDFIT_POSE])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            out[3 * i + k] = a[3 * k + i];
    lin_apply_t(a, a + 9, out + 9);
    for (int k = 0; k < 3; k++)
        out[9 + k] = -out[9 + k];
}

/* The photograph with most corners that links what is tied to what is not; NULL: none. */
static const struct photo *best_link(const struct cal *c, int part)
{
    const struct photo *best = NULL;
    for (int i = 0; i < c->n_photos; i++) {
        const struct photo *p = &c->photo[i];
        const bool camera = c->out->part[p->camera] == part, take = c->out->seen[p->take];
        if (camera != take && p->error < POOR && (camera || c->out->part[p->camera] < 0) &&
            (!best || p->n > best->n))
            best = p;
    }
    return best;
}

static void tie(struct cal *c, const struct photo *p, int part)
{
    struct boardcal_result *o = c->out;
    double back[BOARDFIT_POSE];
    if (o->part[p->camera] == part) {
        invert_pose(o->pose[p->camera], back);
        chain_poses(back, p->pose, o->board[p->take]);
        o->seen[p->take] = true;
        return;
    }
    invert_pose(o->board[p->take], back);
    chain_poses(p->pose, back, o->pose[p->camera]);
    o->part[p->camera] = part;
}

/* Parts of cameras that takes tie; each in the world of its first one. */
static void chain_all(struct cal *c)
{
    static const double middle[BOARDFIT_POSE] = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
    struct boardcal_result *o = c->out;
    int part = 0;
    for (int i = 0; i < c->in->n_cameras; i++)
        o->part[i] = -1;
    for (int i = 0; i < c->in->n_cameras; i++) {
        bool sees = false;
        for (int k = 0; k < c->n_photos; k++)
            sees = sees || (c->photo[k].camera == i && c->photo[k].error < POOR);
        if (o->part[i] >= 0 || !sees)
            continue;
        memcpy(o->pose[i], middle, sizeof middle);
        o->part[i] = part;
        for (const struct photo *p = best_link(c, part); p; p = best_link(c, part))
            tie(c, p, part);
        part++;
    }
}

static int part_size(const struct cal *c, int part)
{
    int n = 0;
    for (int i = 0; i < c->in->n_cameras; i++)
        n += c->out->part[i] == part;
    return n;
}

/* What the largest part sees; its first camera stays. */
static void keep_main(struct cal *c)
{
    struct boardcal_result *o = c->out;
    struct boardcal *in = c->in;
    int kept = 0, first = -1;
    for (int i = 0; i < in->n_cameras; i++)
        if (part_size(c, o->part[i]) > part_size(c, o->main_part) && o->part[i] >= 0)
            o->main_part = o->part[i];
    for (int i = 0; i < in->n_cameras; i++) {
        const bool own = o->part[i] == o->main_part;
        c->camera_free[i] = own && first >= 0;
        first = own && first < 0 ? i : first;
    }
    memset(o->seen, 0, sizeof o->seen);
    for (int i = 0; i < c->n_photos; i++)
        if (o->part[c->photo[i].camera] == o->main_part && c->photo[i].error < POOR)
            o->seen[c->photo[i].take] = true;
    memcpy(c->board_free, o->seen, sizeof c->board_free);
    for (int i = 0; i < in->n; i++)
        if (o->part[in->corner[i].camera] == o->main_part && o->seen[in->corner[i].take])
            in->corner[kept++] = in->corner[i];
    in->n = kept;
}

bool boardcal_tied(const struct boardcal *in, const struct boardcal_result *b)
{
    for (int i = 0; i < in->n_cameras; i++)
        if (b->part[i] != 0)
            return false;
    return true;
}

/* ---- everything ---- */

static struct boardfit fit_of(struct cal *c)
{
    const struct boardcal *in = c->in;
    return (struct boardfit){.n_cameras = in->n_cameras,
                             .n_takes = in->n_takes,
                             .n_lenses = in->n_lenses,
                             .n = in->n,
                             .lens_of = in->lens_of,
                             .lens = c->lens,
                             .pose = c->out->pose,
                             .board = c->out->board,
                             .camera_free = c->camera_free,
                             .board_free = c->board_free,
                             .corner = in->corner,
                             .sigma = SIGMA,
                             .points = c->points};
}

static double median_error(struct cal *c, const struct boardfit *b)
{
    for (int i = 0; i < b->n; i++) {
        double e[2];
        c->error[i] = boardfit_error(b, &b->corner[i], e) ? (float)hypot(e[0], e[1]) : 1e6f;
    }
    return (double)num_median(c->error, (size_t)b->n);
}

/* Corners that agree come first; *n of them. */
static void part_corners(struct cal *c, double gate, int *n)
{
    struct boardfit b = fit_of(c);
    int kept = 0;
    for (int i = 0; i < c->in->n; i++) {
        double e[2];
        if (!boardfit_error(&b, &c->in->corner[i], e) || hypot(e[0], e[1]) > gate)
            continue;
        const struct boardfit_corner k = c->in->corner[i];
        memmove(c->in->corner + kept + 1, c->in->corner + kept, (size_t)(i - kept) * sizeof k);
        c->in->corner[kept++] = k;
    }
    *n = kept;
}

/* Corners of a photograph follow each other. Move them by the part of their errors that is due to
 * white that spreads. */
static void shift_corners(struct cal *c, const struct boardfit *b)
{
    struct boardfit_corner *k = c->in->corner;
    for (int i = 0, n; i < b->n; i += n) {
        double along = 0, length = 0;
        for (n = 0; i + n < b->n && k[i + n].camera == k[i].camera && k[i + n].take == k[i].take;
             n++) {
            double e[2];
            if (!boardfit_error(b, &k[i + n], e))
                continue;
            for (int d = 0; d < 2; d++) {
                along += e[d] * k[i + n].inward[d];
                length += k[i + n].inward[d] * k[i + n].inward[d];
            }
        }
        for (int m = 0; m < n && length > 0; m++)
            for (int d = 0; d < 2; d++)
                k[i + m].px[d] += along / length * k[i + m].inward[d];
    }
}

/* Most px by which the terms bend rays within the corners of the photograph. */
static double most_bend(const struct lens *l, int w, int h)
{
    const double px[2] = {l->cx < 0.5 * w ? w : 0, l->cy < 0.5 * h ? h : 0};
    double ray[3];
    if (!lens_unproject(l, px, ray) || !(ray[2] > 0))
        return INFINITY;
    const double r2 = (ray[0] * ray[0] + ray[1] * ray[1]) / (ray[2] * ray[2]);
    return l->fx * sqrt(r2) *
           fmax(fabs(l->term[0] * r2 + l->term[1] * r2 * r2),
                0.5 * fabs(l->term[0] * r2 / 2 + l->term[1] * r2 * r2 / 4));
}

/* Lenses without bend lose their terms. */
static void straighten_lenses(struct cal *c)
{
    for (int i = 0; i < c->in->n_lenses; i++) {
        struct boardfit_lens *l = &c->lens[i];
        if (l->lens.model != LENS_RADIAL ||
            most_bend(&l->lens, c->in->lens[i].w, c->in->lens[i].h) > STRAIGHT)
            continue;
        l->lens.model = LENS_PINHOLE;
        for (int k = 0; k < LENS_TERMS; k++) {
            l->lens.term[k] = 0;
            l->free[1 + k] = false;
        }
    }
}

static err_t fit_all(struct cal *c, int *used)
{
    double cost, median = WIDE;
    struct boardfit b = fit_of(c);
    err_t e = boardfit_run(c->r->tmp, &b, WIDE, STEPS, &cost);
    for (int k = 0; k < ROUNDS && !e; k++) {
        median = fmax(median_error(c, &b), 1e-3);
        part_corners(c, fmax(GATE * median, GATE_LEAST), &b.n);
        if (b.n == 0)
            return err_fail(ERR_ARG, "no corners of the board agree");
        shift_corners(c, &b);
        if (k == ROUNDS - 1)
            straighten_lenses(c);
        e = run_check(c->r, "board");
        if (!e)
            e = boardfit_run(c->r->tmp, &b, NARROW * median, STEPS, &cost);
    }
    *used = b.n;
    return e;
}

/* Median depth of a camera's corners. */
static double depth_of(struct cal *c, int camera, int n)
{
    const struct boardcal_result *o = c->out;
    size_t seen = 0;
    for (int i = 0; i < n; i++) {
        const struct boardfit_corner *k = &c->in->corner[i];
        const double *board = o->board[k->take], *pose = o->pose[camera];
        double world[3];
        if (k->camera != camera)
            continue;
        for (int d = 0; d < 3; d++)
            world[d] = board[3 * d] * k->at[0] + board[3 * d + 1] * k->at[1] + board[9 + d];
        c->error[seen++] = (float)(lin_dot(pose + 6, world) + pose[11]);
    }
    return (double)num_median(c->error, seen);
}

/* Standard errors, and what corners are like. */
static err_t judge_result(struct cal *c, int n)
{
    struct boardcal_result *o = c->out;
    struct boardfit b = fit_of(c);
    double sum = 0;
    const size_t mark = arena_mark(c->r->tmp);
    b.n = n;
    for (int i = 0; i < n; i++) {
        double e[2];
        if (boardfit_error(&b, &b.corner[i], e))
            sum += e[0] * e[0] + e[1] * e[1];
    }
    o->used = n;
    o->rms_px = sqrt(sum / n);
    b.sigma = fmax(sqrt(sum / num_max(2 * n - boardfit_unknowns(&b), 1)), 1e-6);
    for (int i = 0; i < b.n_cameras; i++) {
        c->camera_free[i] = o->part[i] == o->main_part;
        o->depth[i] = depth_of(c, i, n);
    }
    err_t e = boardfit_covariance(c->r->tmp, &b, o->covariance, o->lens_sd);
    arena_reset(c->r->tmp, mark);
    return e;
}

static err_t solve(struct cal *c)
{
    struct boardcal_result *o = c->out;
    int used = 0;
    list_photos(c);
    if (c->n_photos == 0)
        return err_fail(ERR_ARG, "no camera sees two tags of the board");
    err_t e = OK;
    for (int i = 0; i < c->in->n_lenses && !e; i++)
        e = find_lens(c, i);
    if (!e)
        e = find_poses(c);
    if (e)
        return e;
    chain_all(c);
    keep_main(c);
    e = fit_all(c, &used);
    if (!e)
        e = judge_result(c, used);
    c->in->n = used;
    for (int i = 0; i < c->in->n_lenses; i++) {
        o->fit[i] = c->lens[i];
        o->lens[i] = c->lens[i].lens;
    }
    return e;
}

err_t boardcal_run(const struct run *r, struct boardcal *in, struct boardcal_result *out)
{
    struct cal c = {.r = r, .in = in, .out = out};
    const size_t mark = arena_mark(r->tmp);
    memset(out, 0, sizeof *out);
    if (in->n_cameras < 1 || in->n_cameras > BOARDCAL_CAMERAS || in->n_takes < 1 ||
        in->n_takes > BOARDCAL_TAKES)
        return err_fail(ERR_ARG, "a board in %d cameras and %d takes, at most %d and %d",
                        in->n_cameras, in->n_takes, BOARDCAL_CAMERAS, BOARDCAL_TAKES);
    err_t e = layout(&c, r->tmp, in->n);
    if (!e)
        e = solve(&c);
    arena_reset(r->tmp, mark);
    return e;
}

/* Median error of the sights, expected errors. */
static err_t median_sight(const struct run *r, const struct boardfit *b, double *out)
{
    const struct boardfit_points *p = &b->points;
    const size_t mark = arena_mark(r->tmp);
    float *error;
    err_t e = arena_alloc(r->tmp, (size_t)p->first[p->n], sizeof *error, &error);
    for (int i = 0; i < p->n && !e; i++)
        for (int k = p->first[i]; k < p->first[i + 1]; k++) {
            double d[2];
            error[k] = boardfit_sight_error(b, &p->sight[k], p->at[i], d)
                           ? (float)(hypot(d[0], d[1]) / p->sight[k].sigma)
                           : 1e6f;
        }
    *out = e ? 0 : (double)num_median(error, (size_t)p->first[p->n]);
    arena_reset(r->tmp, mark);
    return e;
}

static err_t refine(struct cal *c, const struct boardfit_points *points)
{
    struct boardcal_result *o = c->out;
    double cost;
    c->points = *points;
    memcpy(c->lens, o->fit, (size_t)c->in->n_lenses * sizeof c->lens[0]);
    memcpy(c->board_free, o->seen, sizeof c->board_free);
    for (int i = 0; i < c->in->n_cameras; i++)
        c->camera_free[i] = i > 0;
    struct boardfit b = fit_of(c);
    err_t e = OK;
    for (int k = 0; k < ROUNDS && !e; k++) {
        double median = 0;
        e = run_check(c->r, "board");
        if (!e)
            e = median_sight(c->r, &b, &median);
        median = fmax(median, 0.1);
        const double corners = fmax(median_error(c, &b), 1e-3);
        b.points.kernel = c->points.kernel = NARROW * median;
        b.sigma = fmax(corners / RAYLEIGH, SIGMA_LEAST); // sights weigh by what they expect
        if (!e)
            e = boardfit_run(c->r->tmp, &b, NARROW * corners, STEPS_REFINE, &cost);
    }
    for (int i = 0; i < c->in->n_lenses; i++) {
        o->fit[i] = c->lens[i];
        o->lens[i] = c->lens[i].lens;
    }
    return e ? e : judge_result(c, c->in->n);
}

err_t boardcal_refine(const struct run *r, struct boardcal *in,
                      const struct boardfit_points *points, struct boardcal_result *io)
{
    struct cal c = {.r = r, .in = in, .out = io};
    const size_t mark = arena_mark(r->tmp);
    err_t e = layout(&c, r->tmp, in->n);
    if (!e)
        e = refine(&c, points);
    arena_reset(r->tmp, mark);
    return e;
}

size_t boardcal_plan(int n_cameras, int n_takes, int n_corners, int n_points, int n_sights)
{
    struct arena a = arena_counter();
    struct cal c;
    (void)layout(&c, &a, n_corners); // a counter is never full
    const size_t mark = arena_mark(&a);
    arena_hold(&a, arena_need((size_t)n_corners, sizeof(struct boardfit_corner)));
    arena_step(&a, num_max_size(boardpose_plan(n_corners), boardfit_plan(1, LENS_VIEWS, 1, 0)));
    arena_reset(&a, mark);
    arena_step(&a, boardpose_plan(n_corners));
    arena_step(&a, arena_need((size_t)n_sights, sizeof(float)));
    arena_step(&a, boardfit_plan(n_cameras, n_takes, n_cameras, n_points));
    return a.peak;
}
