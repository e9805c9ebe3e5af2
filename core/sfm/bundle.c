/* All starts end in the same rounds: points are triangulated again from the observations that
 * agree within a gate, then cameras, focal length and points are adjusted with a Cauchy loss; gate
 * and width of the loss shrink from round to round (graduated non-convexity: Blake and Zisserman
 * 1987). The start whose observations fit with more redundancy wins: a track of n inliers counts 2
 * n - 3. From cameras: their rotations may be wrong by many degrees, so that rays do not meet.
 * Points start at one depth along their rays, and the first, widest rounds correct the rotations.
 * From tracks (viewgraph.h): all centres at once; and those of a few views, to which the others are
 * added, those first that see the most of the points so far. Views that do not fit are placed again
 * from points (resect.h). */
#include "core/sfm/bundle.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/bundle_inner.h"
#include "core/sfm/connectivity.h"
#include "core/sfm/covariance.h"
#include "core/sfm/pair.h"
#include "core/sfm/resect.h"
#include "core/sfm/similarity.h"
#include "core/sfm/triangulate.h"

#include <math.h>
#include <string.h>

enum {
    LENS_GATE = 3, // of the gate, for points through a lens that is only about right
    SEED = 4,      // views that a start begins with
    CORE = 12      // that it begins with where these do not lead to all
};

/* ---- input ---- */

static err_t check_tracks(int n_views, const struct match_tracks *t)
{
    if (t->n < 0 || t->n_tracks < 0 || t->n_tracks > t->n / 2)
        return err_fail(ERR_ARG, "bundle: %d tracks of %d observations, each needs two",
                        t->n_tracks, t->n);
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *s = &t->obs[i];
        if (s->view < 0 || s->view >= n_views || s->track < 0 || s->track >= t->n_tracks)
            return err_fail(ERR_ARG, "bundle: observation %d is of track %d of %d in view %d of %d",
                            i, s->track, t->n_tracks, s->view, n_views);
        if (!isfinite(s->u) || !isfinite(s->v) || !(s->sigma > 0) || !isfinite(1 / s->sigma))
            return err_fail(ERR_ARG, "bundle: observation %d at %g, %g with an error of %g px", i,
                            (double)s->u, (double)s->v, (double)s->sigma);
        if (i > 0 && (s->track < s[-1].track || (s->track == s[-1].track && s->view <= s[-1].view)))
            return err_fail(ERR_ARG,
                            "bundle: observation %d is not in the order of tracks and views", i);
    }
    return OK;
}

static bool are_usable(const struct camera *start, int n)
{
    for (int i = 0; i < n; i++) {
        const struct camera *c = &start[i];
        float sum = c->fx + c->fy, length = 0;
        for (int k = 0; k < 4; k++)
            length += c->q[k] * c->q[k];
        for (int k = 0; k < 3; k++)
            sum += c->t[k];
        if (!isfinite(sum) || !(c->fx > 0) || !(c->fy > 0) || !(fabsf(length - 1) < 0.01f))
            return false;
    }
    return n > 0;
}

/* Observations in the form of struct adjust. */
struct input {
    struct adjust_observation *obs;
    int *first, *lens_of;
};

static err_t layout_lenses(struct bundle *b, struct input *x, struct arena *tmp, int n_views,
                           int n_lenses)
{
    const size_t n = (size_t)n_lenses;
    err_t e = arena_zalloc(tmp, (size_t)n_views, sizeof *x->lens_of, &x->lens_of);
    if (!e)
        e = arena_zalloc(tmp, n, sizeof *b->a.lens, &b->a.lens);
    if (!e)
        e = arena_zalloc(tmp, n, sizeof *b->best.lens, &b->best.lens);
    return e ? e : arena_zalloc(tmp, n, sizeof *b->start, &b->start);
}

static err_t layout(struct bundle *b, struct input *x, struct arena *tmp, int n_views,
                    const struct match_tracks *t)
{
    const size_t n = (size_t)t->n, v = (size_t)n_views, points = 4 * (size_t)t->n_tracks;
    err_t e = arena_alloc(tmp, n, sizeof *x->obs, &x->obs);
    if (!e)
        e = arena_zalloc(tmp, (size_t)t->n_tracks + 1, sizeof *x->first, &x->first);
    for (int i = 0; i < 2 && !e; i++) {
        struct answer *w = &b->best;
        e = arena_zalloc(tmp, v * ADJUST_POSE, sizeof(double), i ? &w->pose : &b->a.pose);
        if (!e)
            e = arena_zalloc(tmp, points, sizeof(double), i ? &w->point : &b->a.point);
        if (!e)
            e = arena_zalloc(tmp, v, sizeof(bool), i ? &w->placed : &b->a.placed);
        if (!e)
            e = arena_zalloc(tmp, n, sizeof(bool), i ? &w->in : &b->a.in);
    }
    if (!e)
        e = arena_alloc(tmp, n, sizeof *b->trusted, &b->trusted);
    if (!e)
        e = arena_alloc(tmp, n, sizeof *b->sorted, &b->sorted);
    if (!e)
        e = arena_zalloc(tmp, (size_t)viewgraph_edges(n_views), sizeof *b->g.edge, &b->g.edge);
    return e;
}

/* Turn about the axis of the camera, counterclockwise as seen in the view: from view to sensor. */
static void turn_back(int quarters, double x[3])
{
    for (int k = 0; k < (quarters & 3); k++) {
        const double u = x[0];
        x[0] = x[1];
        x[1] = -u;
    }
}

/* Position of an observation from the middle of the sensor, square pixels. */
static void taken_position(const struct bundle *b, const struct match_observation *s, double px[2])
{
    const struct extent *size = &b->v->extent[s->view];
    const double focal = b->cfg->pinhole ? (double)b->cfg->pinhole[s->view] : 0;
    double ray[3] = {(double)(s->u - 0.5f * (float)size->w),
                     (double)((s->v - 0.5f * (float)size->h) * bundle_aspect(b)), focal};
    turn_back(bundle_turned(b, s->view), ray);
    memcpy(px, ray, 2 * sizeof *px);
    if (focal > 0 && !lens_project(&b->cfg->lens[b->a.lens_of[s->view]].start, ray, px))
        px[0] = px[1] = 0; // the crop has no such point
}

static err_t load_tracks(struct bundle *b)
{
    const struct match_tracks *t = b->tracks;
    struct input x;
    err_t e = layout(b, &x, b->r->tmp, b->n_views, t);
    if (!e)
        e = layout_lenses(b, &x, b->r->tmp, b->n_views, b->a.n_lenses);
    if (e)
        return e;
    for (int v = 0; v < b->n_views && b->cfg->lens_of; v++)
        x.lens_of[v] = b->cfg->lens_of[v];
    b->a.lens_of = x.lens_of;
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *s = &t->obs[i];
        double px[2];
        taken_position(b, s, px);
        x.obs[i] = (struct adjust_observation){(float)px[0], (float)px[1], 1 / s->sigma, s->view};
        x.first[s->track + 1]++;
        b->trusted[i] = true;
    }
    for (int i = 0; i < t->n_tracks; i++)
        x.first[i + 1] += x.first[i];
    b->a.first = x.first;
    b->a.obs = x.obs;
    return OK;
}

/* ---- rounds ---- */

struct round {
    double gate, kernel; // expected errors
    int steps;
};

static err_t run_rounds(struct bundle *b, const struct round *s, int n)
{
    struct adjust *a = &b->a;
    err_t e = OK;
    for (int k = 0; k < n && !e; k++) {
        e = triangulate_points(b->r, a, s[k].gate * b->scale);
        for (int i = 0; i < b->tracks->n && s[k].gate > 2 * BUNDLE_GATE; i++)
            a->in[i] &= b->trusted[i];
        if (!e)
            e = adjust_run(b->r, a, s[k].kernel * b->scale, s[k].steps);
        adjust_normalise(a);
    }
    return e;
}

/* Ratio of the errors to the expected ones, 1..4, by the median of a Rayleigh distribution. */
static double error_scale(struct bundle *b)
{
    const struct adjust *a = &b->a;
    int n = 0;
    for (int t = 0; t < a->n_tracks; t++)
        for (int i = a->first[t]; i < a->first[t + 1]; i++)
            if (a->in[i] && a->first[t + 1] - a->first[t] > 2)
                b->sorted[n++] = (float)adjust_error(a, a->point + 4 * (size_t)t, &a->obs[i]);
    return fmax(1, fmin(4, sqrt((double)num_median(b->sorted, (size_t)n)) / 1.1774));
}

/* Whether lenses are found. */
static bool finds_lenses(const struct bundle *b)
{
    return b->cfg->find_distortion && !b->cfg->focal_known;
}

/* Whether nothing has told about the lens of a view: no view of it is placed. */
static bool is_lens_unknown(const struct bundle *b, int view)
{
    const struct adjust *a = &b->a;
    const int lens = a->lens_of[view];
    for (int v = 0; v < b->n_views; v++)
        if (a->placed[v] && a->lens_of[v] == lens)
            return false;
    return finds_lenses(b);
}

/* Place views that are not placed yet from the points of the others. */
static err_t place_again(struct bundle *b, bool *any)
{
    struct adjust *a = &b->a;
    *any = false;
    for (int v = 0; v < b->n_views; v++) {
        const double gate = BUNDLE_GATE * b->scale;
        if (a->placed[v])
            continue;
        int n = is_lens_unknown(b, v) ? resect_lens(&b->g, a, v, LENS_GATE * gate)
                                      : resect_view(&b->g, a, v, gate);
        if (n >= CONNECTIVITY_VIEW)
            a->placed[v] = *any = true;
    }
    return run_check(b->r, "placing views");
}

/* Place the views that see more than half as many points as the one that sees the most. */
static err_t place_most(struct bundle *b, bool *any)
{
    struct adjust *a = &b->a;
    int seen[BUNDLE_VIEWS_MAX] = {0}, most = CONNECTIVITY_VIEW;
    const double gate = 2 * BUNDLE_GATE * b->scale;
    err_t e = OK;
    for (int v = 0; v < b->n_views && !e; v++) {
        if (!a->placed[v] && !is_lens_unknown(b, v))
            seen[v] = resect_view(&b->g, a, v, gate);
        most = num_max(most, seen[v]);
        e = run_check(b->r, "placing views");
    }
    *any = false;
    for (int v = 0; v < b->n_views; v++)
        if (2 * seen[v] >= most && seen[v] >= CONNECTIVITY_VIEW)
            a->placed[v] = *any = true;
    return e;
}

/* The last rounds, common to all starts. */
static err_t run_last_rounds(struct bundle *b)
{
    static const struct round middle[] = {{12, 4, 10}}, last[] = {{6, 2, 10}, {BUNDLE_GATE, 2, 25}};
    bool any = false;
    err_t e = run_rounds(b, middle, 1);
    b->scale = error_scale(b);
    if (!e)
        e = run_rounds(b, last, 1);
    if (!e)
        e = connectivity_prune(b->r, &b->g, &b->a, BUNDLE_GATE * b->scale);
    if (!e && !b->cfg->rig_known)
        e = place_again(b, &any);
    if (!e && any)
        e = run_rounds(b, middle, 1);
    if (!e)
        e = run_rounds(b, last, 2);
    if (!e)
        e = triangulate_points(b->r, &b->a, BUNDLE_GATE * b->scale);
    if (!e)
        e = connectivity_prune(b->r, &b->g, &b->a, BUNDLE_GATE * b->scale);
    if (!e)
        e = triangulate_points(b->r, &b->a, BUNDLE_GATE * b->scale);
    return e;
}

/* Keep the present state if it is better than the one before. */
static void keep_better(struct bundle *b, bool from_tracks)
{
    struct answer *w = &b->best;
    const struct adjust *a = &b->a;
    double all, score = bundle_result_redundancy(b, b->a.in, true, &all);
    if (score <= w->score * b->margin)
        return;
    w->score = score;
    memcpy(w->lens, a->lens, (size_t)a->n_lenses * sizeof *w->lens);
    w->scale = b->scale;
    w->from_tracks = from_tracks;
    memcpy(w->pose, a->pose, (size_t)b->n_views * ADJUST_POSE * sizeof *w->pose);
    memcpy(w->point, a->point, 4 * (size_t)a->n_tracks * sizeof *w->point);
    memcpy(w->placed, a->placed, (size_t)b->n_views * sizeof *w->placed);
    memcpy(w->in, a->in, (size_t)b->tracks->n * sizeof *w->in);
}

/* Continue from the best state. */
static void load_best(struct bundle *b)
{
    const struct answer *w = &b->best;
    struct adjust *a = &b->a;
    b->scale = w->scale;
    memcpy(a->lens, w->lens, (size_t)a->n_lenses * sizeof *w->lens);
    memcpy(a->pose, w->pose, (size_t)b->n_views * ADJUST_POSE * sizeof *w->pose);
    memcpy(a->point, w->point, 4 * (size_t)a->n_tracks * sizeof *w->point);
    memcpy(a->placed, w->placed, (size_t)b->n_views * sizeof *w->placed);
    memcpy(a->in, w->in, (size_t)b->tracks->n * sizeof *w->in);
}

/* ---- starts ---- */

/* No points, and the lenses of b->start. */
static void reset_bundle(struct bundle *b)
{
    for (int i = 0; i < b->a.n_lenses; i++)
        b->a.lens[i].lens = b->start[i];
    b->scale = 1;
    memset(b->a.point, 0, 4 * (size_t)b->a.n_tracks * sizeof *b->a.point);
}

static void free_focals(struct bundle *b, bool free)
{
    for (int i = 0; i < b->a.n_lenses; i++)
        b->a.lens[i].free[0] = free;
}

/* Add all views that see enough points, those first that see the most. */
static err_t add_views(struct bundle *b, bool *any)
{
    static const struct round next[] = {{12, 4, 8}};
    bool more = true;
    err_t e = OK;
    *any = false;
    while (more && !e) {
        e = place_most(b, &more);
        *any |= more;
        if (!e && more)
            e = run_rounds(b, next, 1);
    }
    return e;
}

/* From a few views to all. Focal lengths are those of the few: along a walk that does not close yet
 * they would drift. */
static err_t grow_views(struct bundle *b)
{
    static const struct round first[] = {{30, 10, 10}, {12, 4, 10}},
                              closed[] = {{30, 10, 10}, {20, 6, 10}};
    bool any;
    err_t e = run_rounds(b, first, 2);
    free_focals(b, false);
    if (!e)
        e = add_views(b, &any);
    free_focals(b, !b->cfg->focal_known);
    return e ? e : run_rounds(b, closed, 2); // its ends may lie apart
}

/* core: views that it begins with, 0: all at once. */
static err_t from_tracks(struct bundle *b, int core)
{
    static const struct round first[] = {{30, 10, 10}, {20, 6, 10}};
    struct adjust *a = &b->a;
    bool found = false;
    int n_placed = 0;
    reset_bundle(b);
    err_t e = viewgraph_pairs(b->r, a, &b->g);
    if (!e)
        e = viewgraph_rotations(b->r, &b->g, a, &n_placed);
    if (e || n_placed == 0)
        return e;
    e = viewgraph_vote(b->r, &b->g, a);
    for (int i = 0; i < b->tracks->n && !e; i++)
        b->trusted[i] = a->in[i] || !a->placed[a->obs[i].view];
    if (core > 0)
        viewgraph_core(&b->g, core, a);
    for (int i = 0; i < b->tracks->n && core > 0; i++)
        a->in[i] = a->in[i] && a->placed[a->obs[i].view];
    if (!e)
        e = viewgraph_centres(b->r, &b->g, a, &found);
    if (!e)
        e = core > 0 ? grow_views(b) : run_rounds(b, first, 2);
    if (!e)
        e = run_last_rounds(b);
    if (!e)
        keep_better(b, true);
    return e;
}

static void load_cameras(struct bundle *b)
{
    for (int v = 0; v < b->n_views; v++) {
        const struct camera *c = &b->cfg->start[v];
        const double q[4] = {(double)c->q[0], (double)c->q[1], (double)c->q[2], (double)c->q[3]};
        double *p = b->a.pose + (size_t)ADJUST_POSE * (size_t)v;
        rotation_from_quat(q, p);
        for (int k = 0; k < 3; k++)
            p[9 + k] = (double)c->t[k];
        bundle_result_turn(p, -bundle_turned(b, v));
        b->a.placed[v] = true;
    }
}

/* Typical depth of the scene from the cameras of the start: by its depth maps, else by the point
 * nearest to the axes of the views. */
static double typical_depth(struct bundle *b)
{
    double h[9] = {0}, g[3] = {0}, x[3], inverse[9], sum = 0;
    int n = 0;
    for (int i = 0; i < b->tracks->n && b->cfg->start_depth; i++) {
        float d = bundle_depth_at(b, &b->tracks->obs[i]);
        if (d > 0 && isfinite(d))
            b->sorted[n++] = d;
    }
    if (n > 0)
        return (double)num_median(b->sorted, (size_t)n);
    for (int v = 0; v < b->n_views; v++) {
        const double *p = b->a.pose + (size_t)ADJUST_POSE * (size_t)v;
        double c[3];
        lin_apply_t(p, p + 9, c);
        for (int k = 0; k < 9; k++)
            h[k] += (k % 4 == 0) - p[6 + k / 3] * p[6 + k % 3];
        for (int i = 0; i < 9; i++)
            g[i / 3] -= ((i % 4 == 0) - p[6 + i / 3] * p[6 + i % 3]) * c[i % 3];
    }
    if (!lin_inverse3(h, inverse))
        return 1;
    lin_apply(inverse, g, x);
    for (int v = 0; v < b->n_views; v++) {
        const double *p = b->a.pose + (size_t)ADJUST_POSE * (size_t)v;
        sum += (lin_dot(p + 6, x) + p[11]) / b->n_views;
    }
    return sum > 0 && isfinite(sum) ? sum : 1;
}

/* Put points at one depth: the mean of the positions that the rays of their observations reach
 * there. */
static void points_at(struct bundle *b, double depth)
{
    struct adjust *a = &b->a;
    for (int t = 0; t < a->n_tracks; t++) {
        double *x = a->point + 4 * (size_t)t, len = 0;
        int n = 0;
        memset(x, 0, 4 * sizeof *x);
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            const double *p = a->pose + (size_t)ADJUST_POSE * (size_t)a->obs[i].view;
            double ray[3], w[3];
            adjust_ray(a, &a->obs[i], ray);
            const double far = depth / fmax(ray[2], 0.1);
            const double c[3] = {far * ray[0] - p[9], far * ray[1] - p[10], far * ray[2] - p[11]};
            a->in[i] = b->trusted[i];
            if (!a->in[i])
                continue;
            lin_apply_t(p, c, w);
            for (int k = 0; k < 3; k++)
                x[k] += w[k];
            n++;
        }
        x[3] = n ? n : 1;
        for (int k = 0; k < 4; k++)
            len += x[k] * x[k];
        for (int k = 0; k < 4; k++)
            x[k] /= sqrt(len);
    }
}

static err_t from_cameras(struct bundle *b)
{
    static const struct round first[] = {{100, 60, 10}, {60, 30, 10}, {30, 15, 10}, {20, 8, 10}};
    struct adjust *a = &b->a;
    reset_bundle(b);
    load_cameras(b);
    points_at(b, typical_depth(b));
    adjust_normalise(a);
    free_focals(b, false);
    err_t e = adjust_run(b->r, a, 100, 20);
    if (!e)
        e = run_rounds(b, first, 1);
    free_focals(b, !b->cfg->focal_known);
    if (!e)
        e = run_rounds(b, first + 1, 3);
    if (!e)
        e = run_last_rounds(b);
    if (!e)
        keep_better(b, false);
    return e;
}

/* Start from cameras calibrated relative to each other: only points and the focal length move. */
static err_t from_rig(struct bundle *b)
{
    static const struct round first[] = {{30, 10, 10}, {20, 6, 10}};
    reset_bundle(b);
    load_cameras(b);
    b->a.poses_fixed = true;
    err_t e = run_rounds(b, first, 2);
    if (!e)
        e = run_last_rounds(b);
    if (!e)
        keep_better(b, false);
    return e;
}

/* ---- run ---- */

static err_t layout_result(struct bundle_result *out, struct arena *keep, int n_views, int n_tracks)
{
    const size_t lenses = (size_t)out->n_lenses;
    err_t e = arena_zalloc(keep, (size_t)n_views, sizeof *out->cams, &out->cams);
    if (!e)
        e = arena_alloc(keep, 3 * (size_t)n_tracks, sizeof *out->points, &out->points);
    if (!e)
        e = arena_alloc(keep, (size_t)n_views, sizeof *out->depth_scale, &out->depth_scale);
    if (!e)
        e = arena_zalloc(keep, (size_t)n_views, sizeof *out->placed, &out->placed);
    if (!e)
        e = arena_zalloc(keep, lenses, sizeof *out->lenses, &out->lenses);
    if (!e)
        e = arena_zalloc(keep, lenses, sizeof *out->selfcal, &out->selfcal);
    if (!e)
        e = arena_zalloc(keep, (size_t)n_views, sizeof *out->depth, &out->depth);
    return e ? e
             : arena_zalloc(keep, COVARIANCE_POSE * (size_t)n_views, sizeof *out->pose_covariance,
                            &out->pose_covariance);
}

void bundle_plan(struct plan *p, int n_views, int n_lenses, const struct match_tracks *t)
{
    struct bundle_result out = {.n_lenses = n_lenses};
    struct bundle b;
    struct input x;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_result(&out, &p->keep, n_views, t->n_tracks) ||
        layout(&b, &x, &p->tmp, n_views, t) || layout_lenses(&b, &x, &p->tmp, n_views, n_lenses))
        plan_refuse(p);
    arena_step(&p->tmp, selfcal_plan(n_views, n_lenses, t->n_tracks, t->n));
    arena_step(&p->tmp, viewgraph_plan(n_views, t->n));
    arena_step(&p->tmp, similarity_plan(n_views));
    arena_step(&p->tmp, connectivity_plan(n_views));
    arena_reset(&p->tmp, mark);
}

static int count_placed(const struct bundle *b)
{
    int n = 0;
    for (int v = 0; v < b->n_views; v++)
        n += b->best.placed[v];
    return n;
}

/* From a few views, whose points tell the scale of all others, unless there are lenses of which the
 * few tell nothing. Then all centres at once, as long as that places all views; along walks it does
 * not. Relative poses for a wrong focal length are wrong, and adjustment then converges slowly: so
 * it starts again where a focal length comes out different. */
static err_t from_focals(struct bundle *b)
{
    const bool many = b->n_views > PAIR_ALL, grows = b->a.n_lenses == 1 || !finds_lenses(b);
    err_t e = OK;
    for (int k = 0; k < 3 && !e; k++) {
        double most = 0;
        for (int i = 0; i < b->a.n_lenses; i++)
            bundle_start_expect(b, i);
        if (k == 0 && grows && !many && b->n_views > SEED)
            e = from_tracks(b, SEED);
        if (!e && !many)
            e = from_tracks(b, 0);
        if (!e && (many || (b->n_views > CORE && count_placed(b) < b->n_views)))
            e = from_tracks(b, CORE);
        for (int i = 0; i < b->a.n_lenses; i++) {
            const struct lens *l = &b->a.lens[i].lens;
            most = fmax(most, fabs(log(l->fx / b->start[i].fx)));
            b->start[i] = *l;
        }
        if (most < 0.05)
            break;
    }
    return e;
}

static err_t run_starts(struct bundle *b)
{
    free_focals(b, !b->cfg->focal_known);
    b->margin = 1;
    if (b->cfg->rig_known)
        return from_rig(b);
    err_t e = b->cfg->start ? from_cameras(b) : OK;
    if (!e)
        e = from_focals(b);
    /* a network's focal length may be worse than none */
    if (!e && bundle_start_usual(b))
        e = from_focals(b);
    b->margin = 1;
    return e;
}

/* Those that lenses have. */
static void free_own_terms(struct adjust *a)
{
    for (int i = 0; i < a->n_lenses * LENS_TERMS; i++) {
        struct adjust_lens *l = &a->lens[i / LENS_TERMS];
        l->free[1 + i % LENS_TERMS] = i % LENS_TERMS < selfcal_terms(&l->lens);
        l->free[ADJUST_CENTRE] = l->free[ADJUST_CENTRE + 1] = l->lens.cx != 0 || l->lens.cy != 0;
    }
}

/* Distortion, from the best state so far; it stays unless fewer observations fit. */
static err_t find_distortion(struct bundle *b)
{
    struct adjust *a = &b->a;
    load_best(b);
    free_own_terms(a);
    const struct selfcal_config cfg = {BUNDLE_GATE, b->scale, b->cfg->find_principal};
    err_t e = selfcal_run(b->r, a, &cfg, b->selfcal);
    if (!e)
        e = run_last_rounds(b);
    if (!e)
        keep_better(b, b->best.from_tracks);
    return e;
}

/* Views that many others came to know only later are tried again, as long as more are placed. */
static err_t complete_views(struct bundle *b)
{
    err_t e = OK;
    for (int before = -1, now = count_placed(b); now > before && now < b->n_views && !e;) {
        bool any;
        load_best(b);
        e = add_views(b, &any);
        if (!e && any)
            e = run_last_rounds(b);
        if (!e && any)
            keep_better(b, b->best.from_tracks);
        before = now;
        now = count_placed(b);
    }
    return e;
}

/* How well the best state is known. */
static err_t measure_result(struct bundle *b, double *pose_covariance)
{
    double deviation[BUNDLE_VIEWS_MAX * ADJUST_LENS];
    load_best(b);
    if (b->cfg->find_distortion) // a state from before these were looked for may have been the best
        free_own_terms(&b->a);
    err_t e = covariance_run(b->r, &b->a, deviation, pose_covariance);
    for (int i = 0; i < b->a.n_lenses && b->cfg->find_distortion && !e; i++)
        memcpy(b->selfcal[i].deviation, deviation + ADJUST_LENS * i,
               sizeof b->selfcal[i].deviation);
    return e;
}

static err_t check_lenses(const struct bundle_config *cfg, int n_views)
{
    if (cfg->n_lenses < 0 || cfg->n_lenses > n_views)
        return err_fail(ERR_ARG, "bundle: %d lenses of %d views", cfg->n_lenses, n_views);
    for (int v = 0; v < n_views && cfg->lens_of; v++)
        if (cfg->lens_of[v] < 0 || cfg->lens_of[v] >= cfg->n_lenses)
            return err_fail(ERR_ARG, "bundle: lens %d of view %d, there are %d", cfg->lens_of[v], v,
                            cfg->n_lenses);
    return OK;
}

err_t bundle_run(const struct run *r, const struct views *v, const struct match_tracks *tracks,
                 const struct bundle_config *cfg, struct bundle_result *out)
{
    const size_t mark = arena_mark(r->tmp);
    const int n_views = v->n;
    struct bundle_config own = *cfg;
    *out = (struct bundle_result){0};
    if (n_views < 1 || n_views > BUNDLE_VIEWS_MAX || v->size < 1)
        return err_fail(ERR_ARG, "bundle: %d views of %d px, allowed are 1 to %d views", n_views,
                        v->size, BUNDLE_VIEWS_MAX);
    err_t e = check_tracks(n_views, tracks);
    if (!e)
        e = check_lenses(cfg, n_views);
    if (e)
        return e;
    if (own.start && !are_usable(own.start, n_views))
        own.start = NULL;
    own.rig_known &= own.start != NULL;
    struct bundle b = {.r = r, .cfg = &own, .tracks = tracks, .n_views = n_views, .v = v};
    if (own.n_lenses == 0) {
        own.n_lenses = 1;
        own.lens = &b.one;
        own.lens_of = NULL;
    }
    b.a.n_lenses = out->n_lenses = own.n_lenses;
    b.a.n_views = n_views;
    b.a.n_tracks = tracks->n_tracks;
    b.scale = 1;
    e = layout_result(out, r->keep, n_views, tracks->n_tracks);
    if (!e)
        e = load_tracks(&b);
    b.selfcal = out->selfcal;
    if (!e)
        e = bundle_start_known(&b);
    if (!e && tracks->n > 0)
        e = run_starts(&b);
    if (!e && own.find_distortion && b.best.score > 0)
        e = find_distortion(&b);
    if (!e && !own.rig_known && b.best.score > 0)
        e = complete_views(&b);
    if (!e && (own.find_distortion || own.measure_poses) && b.best.score > 0)
        e = measure_result(&b, own.measure_poses ? out->pose_covariance : NULL);
    if (!e)
        e = bundle_result_write(&b, out);
    arena_reset(r->tmp, mark);
    if (e)
        *out = (struct bundle_result){0};
    return e;
}
