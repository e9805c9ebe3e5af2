/* Of the cameras that do not fit, the one without which the others agree best has moved; it is
 * taken out, and the rest is checked again. Points that a camera does not see are the same without
 * it: of each camera only its own tracks are placed again. */
#include "core/sfm/rigcheck.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/adjust.h"
#include "core/sfm/triangulate.h"

#include <math.h>
#include <string.h>

enum { SEEN_LEAST = 12, STEPS = 20, TWIST = 6 };
static const double GATE = 4;              // expected errors of an observation that agrees
static const double KERNEL = 3;            // medians, width of the loss
static const double SIGMAS = 2.5;          // standard errors; 1.9 are enough for pure noise
static const double RAYLEIGH = 1.17741002; // median length of a vector of unit normals

struct check {
    const struct run *r;
    struct adjust a, own; // all tracks, and those of the view at work
    struct tracks {
        struct adjust_observation *obs; // (tracks->n)
        int *first;                     // (n_tracks + 1)
    } all, mine;                        // of a and own
    int used, in;                       // observations of all cameras, and those that agree
    int *lens_of;                       // (n) of a
    int *at;                            // (n_tracks) observations of the view at work in own
    int n_at;
    float *sorted; // (n_tracks)
    bool *gone;    // (n) has moved, and counts no more
    double agreed; // share of the other observations that agree without it
};

static err_t layout_tracks(struct arena *tmp, const struct match_tracks *t, struct tracks *list,
                           struct adjust *a)
{
    const size_t n = (size_t)t->n, tracks = (size_t)t->n_tracks;
    err_t e = arena_alloc(tmp, n, sizeof *list->obs, &list->obs);
    if (!e)
        e = arena_zalloc(tmp, tracks + 1, sizeof *list->first, &list->first);
    if (!e)
        e = arena_zalloc(tmp, 4 * tracks, sizeof *a->point, &a->point);
    return e ? e : arena_zalloc(tmp, n, sizeof *a->in, &a->in);
}

static err_t layout(struct check *c, struct arena *tmp, int n_views, const struct match_tracks *t)
{
    const size_t v = (size_t)n_views, tracks = (size_t)t->n_tracks;
    err_t e = layout_tracks(tmp, t, &c->all, &c->a);
    if (!e)
        e = layout_tracks(tmp, t, &c->mine, &c->own);
    if (!e)
        e = arena_alloc(tmp, tracks, sizeof *c->at, &c->at);
    if (!e)
        e = arena_alloc(tmp, tracks, sizeof *c->sorted, &c->sorted);
    if (!e)
        e = arena_zalloc(tmp, v, sizeof *c->gone, &c->gone);
    if (!e)
        e = arena_zalloc(tmp, v, sizeof *c->lens_of, &c->lens_of);
    if (!e)
        e = arena_zalloc(tmp, v, sizeof *c->a.lens, &c->a.lens);
    if (!e)
        e = arena_zalloc(tmp, v * ADJUST_POSE, sizeof *c->a.pose, &c->a.pose);
    return e ? e : arena_zalloc(tmp, v, sizeof *c->a.placed, &c->a.placed);
}

void rigcheck_plan(struct plan *p, int n_views, const struct match_tracks *t)
{
    struct check c;
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&c, &p->tmp, n_views, t))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static err_t set_up(struct check *c, int n, const struct match_tracks *t, const struct camera *cams)
{
    struct adjust *a = &c->a;
    err_t e = OK;
    for (int i = 0; i < n && !e; i++) {
        double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)i;
        rotation_of_camera(&cams[i], pose);
        for (int k = 0; k < 3; k++)
            pose[9 + k] = (double)cams[i].t[k];
        a->lens[i].lens = (struct lens){.fx = (double)cams[i].fx, .fy = (double)cams[i].fx};
        a->placed[i] = true;
        c->lens_of[i] = i;
        e = lens_init(&a->lens[i].lens);
    }
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *s = &t->obs[i];
        const struct camera *cam = &cams[s->view];
        c->all.obs[i] = (struct adjust_observation){
            s->u - cam->cx, (s->v - cam->cy) * cam->fx / cam->fy, 1 / s->sigma, s->view};
        c->all.first[s->track + 1]++;
    }
    for (int i = 0; i < t->n_tracks; i++)
        c->all.first[i + 1] += c->all.first[i];
    a->n_views = a->n_lenses = n;
    a->n_tracks = t->n_tracks;
    a->first = c->all.first;
    a->obs = c->all.obs;
    a->lens_of = c->lens_of;
    struct adjust own = *a;
    own.first = c->mine.first;
    own.obs = c->mine.obs;
    own.point = c->own.point;
    own.in = c->own.in;
    c->own = own;
    return e;
}

/* ---- one camera ---- */

/* Observations of placed views, and those that agree, `sign` times. */
static void count_tracks(const struct adjust *a, int sign, int *used, int *in)
{
    for (int t = 0; t < a->n_tracks; t++) {
        int n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            n += a->placed[a->obs[i].view];
            *in += sign * a->in[i];
        }
        *used += n > 1 ? sign * n : 0;
    }
}

static void copy_track(const struct adjust *a, int track, struct check *c)
{
    struct adjust *own = &c->own;
    int n = c->mine.first[own->n_tracks];
    memcpy(own->point + 4 * (size_t)own->n_tracks, a->point + 4 * (size_t)track,
           4 * sizeof *own->point);
    for (int i = a->first[track]; i < a->first[track + 1]; i++, n++) {
        c->mine.obs[n] = a->obs[i];
        own->in[n] = a->in[i];
    }
    c->mine.first[++own->n_tracks] = n;
}

/* Place the points of the view without it; note its observations of them, and how far the others
 * agree. */
static err_t place_without(struct check *c, int view)
{
    const struct adjust *a = &c->a;
    struct adjust *own = &c->own;
    int used = c->used, in = c->in;
    own->n_tracks = c->n_at = 0;
    for (int t = 0; t < a->n_tracks; t++)
        for (int i = a->first[t]; i < a->first[t + 1]; i++)
            if (a->obs[i].view == view)
                copy_track(a, t, c);
    count_tracks(own, -1, &used, &in);
    own->placed[view] = false;
    err_t e = triangulate_points(c->r, own, GATE);
    count_tracks(own, 1, &used, &in);
    own->placed[view] = true;
    for (int t = 0; t < own->n_tracks && !e; t++) {
        int agree = 0, at = -1;
        for (int i = own->first[t]; i < own->first[t + 1]; i++) {
            agree += own->in[i];
            at = own->obs[i].view == view ? i : at;
        }
        if (agree < 2)
            continue;
        c->at[c->n_at++] = at;
        memmove(own->point + 4 * (size_t)(c->n_at - 1), own->point + 4 * (size_t)t,
                4 * sizeof *own->point); // points of earlier tracks are not needed again
    }
    c->agreed = used > 0 ? (double)in / used : 0;
    return e;
}

static const double *point_of(const struct check *c, int k)
{
    return c->own.point + 4 * (size_t)k;
}

/* Median error of the observations at the present pose, expected errors; those without pixel are
 * far off. */
static double median_error(const struct check *c)
{
    for (int k = 0; k < c->n_at; k++)
        c->sorted[k] = (float)sqrt(adjust_error(&c->own, point_of(c, k), &c->own.obs[c->at[k]]));
    return (double)num_median(c->sorted, (size_t)c->n_at);
}

/* Normal equations with Cauchy weights of width `kernel`, factored; false if they are singular. */
static bool normal_equations(struct check *c, double kernel, double h[TWIST * TWIST],
                             double g[TWIST])
{
    memset(h, 0, TWIST * TWIST * sizeof *h);
    memset(g, 0, TWIST * sizeof *g);
    for (int k = 0; k < c->n_at; k++) {
        struct adjust_jacobian j;
        if (!adjust_jacobian(&c->own, point_of(c, k), &c->own.obs[c->at[k]], &j))
            continue;
        const double e2 = j.error[0] * j.error[0] + j.error[1] * j.error[1];
        const double w = 1 / (1 + e2 / (kernel * kernel));
        for (int i = 0; i < 2; i++)
            lin_add_equation(h, g, TWIST, j.pose[i], w, j.error[i]);
    }
    for (int i = 0; i < TWIST; i++)
        h[(TWIST + 1) * i] *= 1 + 1e-6;
    return lin_cholesky(h, TWIST);
}

/* One step of Gauss-Newton. Returns whether it moved. */
static bool step_pose(struct check *c, double pose[ADJUST_POSE], double kernel)
{
    double h[TWIST * TWIST], g[TWIST], length = 0;
    if (!normal_equations(c, kernel, h, g))
        return false;
    lin_solve(h, TWIST, g);
    for (int i = 0; i < TWIST; i++)
        length += g[i] * g[i];
    if (!isfinite(length))
        return false;
    adjust_move_pose(pose, g);
    return length > 1e-16;
}

static void fit_pose(struct check *c, double pose[ADJUST_POSE])
{
    for (int k = 0; k < STEPS; k++)
        if (!step_pose(c, pose, fmax(KERNEL * median_error(c), 1)))
            break;
}

/* Standard errors of the pose: its rotation, rad, and its centre. */
static void pose_deviations(struct check *c, double out[2])
{
    const double median = median_error(c), sigma = median / RAYLEIGH;
    double h[TWIST * TWIST], g[TWIST];
    out[0] = out[1] = INFINITY;
    if (!normal_equations(c, fmax(KERNEL * median, 1), h, g))
        return;
    out[0] = out[1] = 0;
    for (int i = 0; i < TWIST; i++) {
        double unit[TWIST] = {0};
        unit[i] = 1;
        lin_solve(h, TWIST, unit);
        out[i / 3] += sigma * sigma * unit[i];
    }
    out[0] = sqrt(out[0]);
    out[1] = sqrt(out[1]);
}

static double centre_distance(const double a[ADJUST_POSE], const double b[ADJUST_POSE])
{
    double x[3], y[3], sum = 0;
    lin_apply_t(a, a + 9, x);
    lin_apply_t(b, b + 9, y);
    for (int k = 0; k < 3; k++)
        sum += (x[k] - y[k]) * (x[k] - y[k]);
    return sqrt(sum);
}

/* Angle of R_b R_a^T. */
static double angle_between(const double a[ADJUST_POSE], const double b[ADJUST_POSE])
{
    double turn[9], w[3];
    for (int i = 0; i < 9; i++)
        turn[i] = lin_dot(b + 3 * (i / 3), a + 3 * (i % 3));
    rotation_log(turn, w);
    return sqrt(lin_dot(w, w)) * 180 / NUM_PI;
}

/* Compare the pose `now`, of these standard errors, with that of the rig, which own.pose has. */
static void compare_poses(struct check *c, int view, const double now[ADJUST_POSE],
                          const double deviation[2], struct rigcheck_camera *out)
{
    double *pose = c->own.pose + (size_t)ADJUST_POSE * (size_t)view, was[ADJUST_POSE];
    struct adjust_jacobian a, b;
    memcpy(was, pose, sizeof was);
    for (int k = 0; k < c->n_at; k++) {
        const struct adjust_observation *s = &c->own.obs[c->at[k]];
        const bool before = adjust_jacobian(&c->own, point_of(c, k), s, &a);
        memcpy(pose, now, sizeof was);
        const bool after = adjust_jacobian(&c->own, point_of(c, k), s, &b);
        memcpy(pose, was, sizeof was);
        c->sorted[k] = 1e6f;
        if (before && after)
            c->sorted[k] = (float)(hypot(a.error[0] - b.error[0], a.error[1] - b.error[1]) /
                                   (double)s->weight);
    }
    out->off_px = num_median(c->sorted, (size_t)c->n_at);
    for (int k = 0; k < c->n_at; k++)
        c->sorted[k] = (float)adjust_depth(&c->own, view, point_of(c, k));
    const double depth = fmax((double)num_median(c->sorted, (size_t)c->n_at), 1e-12);
    out->turned_deg = (float)angle_between(was, now);
    out->turned_sd_deg = (float)(deviation[0] * 180 / NUM_PI);
    out->shift = (float)(centre_distance(was, now) / depth);
    out->shift_sd = (float)(deviation[1] / depth);
}

/* Standard deviation of an observation, px, from their errors at the fitted pose. */
static double observed_sigma(struct check *c)
{
    for (int k = 0; k < c->n_at; k++) {
        const struct adjust_observation *s = &c->own.obs[c->at[k]];
        c->sorted[k] = (float)(sqrt(adjust_error(&c->own, point_of(c, k), s)) / (double)s->weight);
    }
    return (double)num_median(c->sorted, (size_t)c->n_at) / RAYLEIGH;
}

static void set_pose(const double pose[ADJUST_POSE], struct camera *cam)
{
    double q[4];
    rotation_to_quat(pose, q);
    for (int k = 0; k < 4; k++)
        cam->q[k] = (float)q[k];
    for (int k = 0; k < 3; k++)
        cam->t[k] = (float)pose[9 + k];
}

/* The camera against the others; `moved` is set, but not taken for granted yet. */
static err_t check_camera(struct check *c, const struct views *v, int view,
                          struct rigcheck_camera *out)
{
    double *pose = c->own.pose + (size_t)ADJUST_POSE * (size_t)view, was[ADJUST_POSE],
           now[ADJUST_POSE], deviation[2];
    err_t e = place_without(c, view);
    out->seen = c->n_at;
    out->known = c->n_at >= SEEN_LEAST;
    out->moved = false;
    if (e || !out->known)
        return e;
    memcpy(was, pose, sizeof was);
    fit_pose(c, pose);
    const double sigma = observed_sigma(c) * sqrt(TWIST / (double)c->n_at);
    pose_deviations(c, deviation);
    memcpy(now, pose, sizeof now);
    memcpy(pose, was, sizeof was);
    compare_poses(c, view, now, deviation, out);
    const int edge = num_max(v->extent[view].w, v->extent[view].h);
    out->moved = out->off_px > fmaxf(RIGCHECK_MOVED * (float)edge, (float)(SIGMAS * sigma));
    set_pose(now, &out->cam);
    return OK;
}

/* ---- all ---- */

/* Check those that have not moved so far; the one that did, or -1. */
static err_t find_moved(struct check *c, const struct views *v, struct rigcheck_camera *out,
                        int *worst)
{
    double best = -1;
    err_t e = triangulate_points(c->r, &c->a, GATE);
    *worst = -1;
    c->used = c->in = 0;
    count_tracks(&c->a, 1, &c->used, &c->in);
    for (int i = 0; i < v->n && !e; i++) {
        if (c->gone[i])
            continue;
        e = check_camera(c, v, i, &out[i]);
        if (!e && out[i].moved && c->agreed > best) {
            best = c->agreed;
            *worst = i;
        }
    }
    return e;
}

static err_t take_out_moved(struct check *c, const struct views *v, struct rigcheck_camera *out)
{
    err_t e = OK;
    for (int left = v->n; !e && left >= RIGCHECK_LEAST; left--) {
        int worst;
        e = find_moved(c, v, out, &worst);
        if (e || worst < 0)
            break;
        c->gone[worst] = true;
        c->a.placed[worst] = false;
    }
    return e;
}

err_t rigcheck_run(const struct run *r, const struct views *v, const struct match_tracks *tracks,
                   const struct camera *cams, struct rigcheck_camera *out)
{
    struct check c = {.r = r};
    const size_t mark = arena_mark(r->tmp);
    if (v->n < RIGCHECK_LEAST)
        return err_fail(ERR_ARG, "a rig is checked with %d cameras or more, it has %d",
                        RIGCHECK_LEAST, v->n);
    for (int i = 0; i < v->n; i++)
        out[i] = (struct rigcheck_camera){.cam = cams[i]};
    err_t e = layout(&c, r->tmp, v->n, tracks);
    if (!e)
        e = set_up(&c, v->n, tracks, cams);
    if (!e)
        e = take_out_moved(&c, v, out);
    for (int i = 0; i < v->n && !e; i++) {
        out[i].moved = c.gone[i];
        if (!c.gone[i])
            out[i].cam = cams[i];
    }
    arena_reset(r->tmp, mark);
    return e;
}
