/* Both starts end in the same rounds: points are triangulated again from the sightings that agree
 * within a gate, then cameras, focal length and points are adjusted with a Cauchy loss; gate and
 * width of the loss shrink from round to round (graduated non-convexity: Blake and Zisserman 1987).
 * The start whose sightings fit with more redundancy wins: a track of n inliers counts 2 n - 3.
 * From cameras: their rotations may be wrong by many degrees, so that rays do not meet. Points
 * start at one depth along their rays, and the first, widest rounds correct the rotations.
 * From tracks: viewgraph.h. Views that do not fit are placed again from points (resect.h). */
#include "core/sfm/bundle.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/adjust.h"
#include "core/sfm/connectivity.h"
#include "core/sfm/resect.h"
#include "core/sfm/similarity.h"
#include "core/sfm/viewgraph.h"

#include <math.h>
#include <string.h>

enum { GATE = 4 };                              // expected errors of an inlier
static const double CHANCE = 0.2;               // redundancy that wrong matches may have
static const double FAR = 1e-6;                 // least w of a point in the result
static const double FOV60 = 0.8660254037844386; // focal length over picture size at 60 degrees

/* One candidate result. */
struct answer {
    double focal, scale; // scale: of the expected errors, at least 1
    double *pose, *point;
    bool *placed, *in;
    double score;
    bool from_tracks;
};

struct bundle {
    const struct run *r;
    const struct bundle_config *cfg;
    const struct match_tracks *tracks;
    const struct views *v;
    int n_views;
    struct adjust a;
    struct viewgraph g;
    bool *trusted; // (sightings) after the votes; all without them
    float *sorted; // (sightings)
    struct answer best;
    double scale;
};

/* ---- input ---- */

static err_t check_tracks(int n_views, const struct match_tracks *t)
{
    if (t->n < 0 || t->n_tracks < 0 || t->n_tracks > t->n / 2)
        return err_fail(ERR_ARG, "bundle: %d tracks of %d sightings, each needs two", t->n_tracks,
                        t->n);
    for (int i = 0; i < t->n; i++) {
        const struct match_seen *s = &t->seen[i];
        if (s->view < 0 || s->view >= n_views || s->track < 0 || s->track >= t->n_tracks)
            return err_fail(ERR_ARG, "bundle: sighting %d is of track %d of %d in view %d of %d", i,
                            s->track, t->n_tracks, s->view, n_views);
        if (!isfinite(s->u) || !isfinite(s->v) || !(s->sigma > 0) || !isfinite(1 / s->sigma))
            return err_fail(ERR_ARG, "bundle: sighting %d at %g, %g with an error of %g px", i,
                            (double)s->u, (double)s->v, (double)s->sigma);
        if (i > 0 && (s->track < s[-1].track || (s->track == s[-1].track && s->view <= s[-1].view)))
            return err_fail(ERR_ARG, "bundle: sighting %d is not in the order of tracks and views",
                            i);
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

/* Adjustment assumes square pixels: rows are scaled by the aspect. */
static float picture_aspect(const struct bundle *b)
{
    return b->v->aspect > 0 ? b->v->aspect : 1;
}

static double start_focal(const struct bundle *b)
{
    float f[BUNDLE_VIEWS_MAX];
    if (b->cfg->focal > 0 && isfinite(b->cfg->focal))
        return (double)b->cfg->focal;
    if (!b->cfg->start)
        return FOV60 * b->v->size;
    for (int i = 0; i < b->n_views; i++)
        f[i] = sqrtf(b->cfg->start[i].fx * b->cfg->start[i].fy * picture_aspect(b));
    return (double)num_median(f, (size_t)b->n_views);
}

/* Observations in the form of struct adjust. */
struct input {
    struct adjust_seen *seen;
    int *first;
};

static err_t layout(struct bundle *b, struct input *x, struct arena *tmp, int n_views,
                    const struct match_tracks *t)
{
    const size_t n = (size_t)t->n, v = (size_t)n_views, points = 4 * (size_t)t->n_tracks;
    err_t e = arena_alloc(tmp, n, sizeof *x->seen, &x->seen);
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

static err_t load_tracks(struct bundle *b)
{
    const struct match_tracks *t = b->tracks;
    struct input x;
    err_t e = layout(b, &x, b->r->tmp, b->n_views, t);
    if (e)
        return e;
    for (int i = 0; i < t->n; i++) {
        const struct match_seen *s = &t->seen[i];
        const struct extent *px = &b->v->extent[s->view];
        x.seen[i] = (struct adjust_seen){s->u - 0.5f * (float)px->w,
                                         (s->v - 0.5f * (float)px->h) * picture_aspect(b),
                                         1 / s->sigma, s->view};
        x.first[s->track + 1]++;
        b->trusted[i] = true;
    }
    for (int i = 0; i < t->n_tracks; i++)
        x.first[i + 1] += x.first[i];
    b->a.first = x.first;
    b->a.seen = x.seen;
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
        e = adjust_points(b->r, a, s[k].gate * b->scale);
        for (int i = 0; i < b->tracks->n && s[k].gate > 2 * GATE; i++)
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
                b->sorted[n++] = (float)adjust_error(a, a->point + 4 * (size_t)t, &a->seen[i]);
    return fmax(1, fmin(4, sqrt((double)num_median(b->sorted, (size_t)n)) / 1.1774));
}

/* Place views that are not placed yet from the points of the others. */
static err_t place_again(struct bundle *b, bool *any)
{
    struct adjust *a = &b->a;
    *any = false;
    for (int v = 0; v < b->n_views; v++)
        if (!a->placed[v] && resect_view(&b->g, a, v, GATE * b->scale) >= CONNECTIVITY_VIEW)
            a->placed[v] = *any = true;
    return run_check(b->r, "placing views");
}

/* The last rounds, common to both starts. */
static err_t run_last_rounds(struct bundle *b)
{
    static const struct round middle[] = {{12, 4, 10}}, last[] = {{6, 2, 10}, {GATE, 2, 25}};
    bool any = false;
    err_t e = run_rounds(b, middle, 1);
    b->scale = error_scale(b);
    if (!e)
        e = run_rounds(b, last, 1);
    connectivity_prune(&b->a);
    if (!e && !b->cfg->rig_known)
        e = place_again(b, &any);
    if (!e && any)
        e = run_rounds(b, middle, 1);
    if (!e)
        e = run_rounds(b, last, 2);
    if (!e)
        e = adjust_points(b->r, &b->a, GATE * b->scale);
    connectivity_prune(&b->a);
    if (!e)
        e = adjust_points(b->r, &b->a, GATE * b->scale);
    return e;
}

/* Redundancy of the inliers and of all sightings; with `soft`, sightings near the gate count
 * less. */
static double count_redundancy(const struct bundle *b, bool soft, double *all)
{
    const struct adjust *a = &b->a;
    double sum = 0;
    *all = 0;
    for (int t = 0; t < a->n_tracks; t++) {
        const int seen = a->first[t + 1] - a->first[t];
        double n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            double e2 = soft ? adjust_error(a, a->point + 4 * (size_t)t, &a->seen[i]) : 0;
            n += a->in[i] ? fmax(0, 1 - e2 / (GATE * GATE)) : 0;
        }
        sum += fmax(0, 2 * n - 3);
        *all += seen > 1 ? 2 * seen - 3 : 0;
    }
    return sum;
}

/* Keep the present state if it is better than the one before. */
static void keep_better(struct bundle *b, bool from_tracks)
{
    struct answer *w = &b->best;
    const struct adjust *a = &b->a;
    double all, score = count_redundancy(b, true, &all);
    if (score <= w->score)
        return;
    w->score = score;
    w->focal = a->focal;
    w->scale = b->scale;
    w->from_tracks = from_tracks;
    memcpy(w->pose, a->pose, (size_t)b->n_views * ADJUST_POSE * sizeof *w->pose);
    memcpy(w->point, a->point, 4 * (size_t)a->n_tracks * sizeof *w->point);
    memcpy(w->placed, a->placed, (size_t)b->n_views * sizeof *w->placed);
    memcpy(w->in, a->in, (size_t)b->tracks->n * sizeof *w->in);
}

/* ---- starts ---- */

static void reset_points(struct bundle *b, double focal)
{
    b->a.focal = focal;
    b->scale = 1;
    memset(b->a.point, 0, 4 * (size_t)b->a.n_tracks * sizeof *b->a.point);
}

static err_t from_tracks(struct bundle *b, double focal)
{
    static const struct round first[] = {{30, 10, 10}, {20, 6, 10}};
    struct adjust *a = &b->a;
    bool found = false;
    reset_points(b, focal);
    err_t e = viewgraph_pairs(b->r, a, &b->g);
    if (e || viewgraph_rotations(&b->g, a) == 0)
        return e;
    e = viewgraph_vote(b->r, &b->g, a);
    for (int i = 0; i < b->tracks->n && !e; i++)
        b->trusted[i] = a->in[i] || !a->placed[a->seen[i].view];
    if (!e)
        e = viewgraph_centres(b->r, &b->g, a, &found);
    if (!e)
        e = run_rounds(b, first, 2);
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
        b->a.placed[v] = true;
    }
}

static float depth_at(const struct bundle *b, const struct match_seen *s)
{
    const struct extent *px = &b->v->extent[s->view];
    const int x = (int)fminf(fmaxf(s->u, 0), (float)(px->w - 1));
    const int y = (int)fminf(fmaxf(s->v, 0), (float)(px->h - 1));
    return b->cfg->start_depth[px->at + (size_t)y * (size_t)px->w + (size_t)x];
}

/* Typical depth of the scene from the cameras of the start: by its depth maps, else by the point
 * nearest to the axes of the views. */
static double typical_depth(struct bundle *b)
{
    double h[9] = {0}, g[3] = {0}, x[3], inverse[9], sum = 0;
    int n = 0;
    for (int i = 0; i < b->tracks->n && b->cfg->start_depth; i++) {
        float d = depth_at(b, &b->tracks->seen[i]);
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

/* Put points at one depth: the mean of the positions that the rays of their sightings reach there.
 * */
static void points_at(struct bundle *b, double depth)
{
    struct adjust *a = &b->a;
    for (int t = 0; t < a->n_tracks; t++) {
        double *x = a->point + 4 * (size_t)t, len = 0;
        int n = 0;
        memset(x, 0, 4 * sizeof *x);
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            const double *p = a->pose + (size_t)ADJUST_POSE * (size_t)a->seen[i].view;
            const double c[3] = {depth * (double)a->seen[i].u / a->focal - p[9],
                                 depth * (double)a->seen[i].v / a->focal - p[10], depth - p[11]};
            double w[3];
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
    reset_points(b, start_focal(b));
    load_cameras(b);
    points_at(b, typical_depth(b));
    adjust_normalise(a);
    a->focal_fixed = true;
    err_t e = adjust_run(b->r, a, 100, 20);
    if (!e)
        e = run_rounds(b, first, 1);
    a->focal_fixed = b->cfg->focal_known;
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
    reset_points(b, start_focal(b));
    load_cameras(b);
    b->a.poses_fixed = true;
    err_t e = run_rounds(b, first, 2);
    if (!e)
        e = run_last_rounds(b);
    if (!e)
        keep_better(b, false);
    return e;
}

/* ---- result ---- */

/* Similarity from the adjusted world to that of the result. */
struct world {
    double scale, r[9], t[3]; // x_out = scale r x + t
};

static struct camera camera_of(const struct bundle *b, int v)
{
    const struct extent *px = &b->v->extent[v];
    const float f = (float)b->best.focal;
    const double *p = b->best.pose + (size_t)ADJUST_POSE * (size_t)v;
    struct camera cam = {
        px->w, px->h, f, f / picture_aspect(b), 0.5f * (float)px->w, 0.5f * (float)px->h, {0}, {0}};
    double q[4];
    rotation_to_quat(p, q);
    for (int k = 0; k < 4; k++)
        cam.q[k] = (float)q[k];
    for (int k = 0; k < 3; k++)
        cam.t[k] = (float)p[9 + k];
    return cam;
}

/* World of `start` if there is one, else that of the first placed camera. */
static err_t find_world(const struct bundle *b, struct world *out)
{
    struct camera from[BUNDLE_VIEWS_MAX], to[BUNDLE_VIEWS_MAX];
    struct similarity w;
    int n = 0;
    *out = (struct world){1, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0}};
    for (int v = 0; v < b->n_views; v++) {
        if (!b->best.placed[v])
            continue;
        if (!b->cfg->start && n++ == 0) {
            memcpy(out->r, b->best.pose + (size_t)ADJUST_POSE * (size_t)v, sizeof out->r);
            memcpy(out->t, b->best.pose + (size_t)ADJUST_POSE * (size_t)v + 9, sizeof out->t);
        }
        if (b->cfg->start) {
            from[n] = camera_of(b, v);
            to[n++] = b->cfg->start[v];
        }
    }
    if (!b->cfg->start || n == 0)
        return OK;
    err_t e = similarity_fit(b->r, from, to, n, &w);
    if (e || !(w.scale > 0) || !isfinite(w.scale + w.t[0] + w.t[1] + w.t[2]))
        return e;
    out->scale = w.scale;
    rotation_from_quat(w.q, out->r);
    memcpy(out->t, w.t, sizeof out->t);
    return OK;
}

static struct camera moved_camera(const struct world *w, const struct camera *cam)
{
    struct similarity to = {.scale = w->scale};
    rotation_to_quat(w->r, to.q);
    memcpy(to.t, w->t, sizeof to.t);
    return similarity_apply(&to, cam);
}

/* Cameras of the result; views that are not placed get those of `start`, else of the nearest placed
 * view. */
static void write_cameras(const struct bundle *b, const struct world *w, struct bundle_result *out)
{
    struct camera none = camera_of(b, 0);
    none.q[0] = 1;
    for (int k = 0; k < 3; k++)
        none.q[1 + k] = none.t[k] = 0;
    for (int v = 0; v < b->n_views; v++) {
        out->placed[v] = b->best.placed[v];
        out->n_placed += out->placed[v];
        out->cams[v] = none;
        if (out->placed[v] && !b->cfg->rig_known) {
            struct camera own = camera_of(b, v);
            out->cams[v] = moved_camera(w, &own);
        } else if (b->cfg->start) {
            memcpy(out->cams[v].q, b->cfg->start[v].q, sizeof none.q);
            memcpy(out->cams[v].t, b->cfg->start[v].t, sizeof none.t);
        }
    }
    for (int v = 0; v < b->n_views && !b->cfg->start; v++)
        for (int gap = 1; gap < b->n_views && !out->placed[v]; gap++) {
            const int near = v >= gap && out->placed[v - gap] ? v - gap : v + gap;
            if (near < b->n_views && out->placed[near]) {
                out->cams[v] = out->cams[near];
                break;
            }
        }
}

/* Inliers, their error, and positions of the points. */
static void write_points(const struct bundle *b, const struct world *w, struct bundle_result *out)
{
    const struct adjust *a = &b->a;
    double sum = 0;
    for (int t = 0; t < a->n_tracks; t++) {
        const double *x = b->best.point + 4 * (size_t)t;
        const double far = fmax(x[3], FAR), p[3] = {x[0] / far, x[1] / far, x[2] / far};
        double q[3];
        int n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            if (!b->best.in[i])
                continue;
            double weight = (double)a->seen[i].weight;
            sum += adjust_error(a, x, &a->seen[i]) / (weight * weight);
            n++;
        }
        out->inliers += n;
        lin_apply(w->r, p, q);
        for (int k = 0; k < 3; k++)
            out->points[3 * t + k] = n ? (float)(w->scale * q[k] + w->t[k]) : NAN;
    }
    out->rms_px = out->inliers ? (float)sqrt(sum / out->inliers) : 0;
}

/* Depth of the points over that of the start, in each view. */
static void write_scales(struct bundle *b, const struct world *w, struct bundle_result *out)
{
    const struct adjust *a = &b->a;
    for (int v = 0; v < b->n_views; v++) {
        int n = 0;
        out->depth_scale[v] = 1;
        for (int i = 0; i < b->tracks->n && b->cfg->start_depth && b->cfg->start; i++) {
            const struct match_seen *s = &b->tracks->seen[i];
            if (s->view != v || !b->best.in[i])
                continue;
            double z = w->scale * adjust_depth(a, v, b->best.point + 4 * (size_t)s->track);
            float ratio = (float)z / depth_at(b, s);
            if (ratio > 0 && isfinite(ratio))
                b->sorted[n++] = ratio;
        }
        if (n >= CONNECTIVITY_VIEW)
            out->depth_scale[v] = num_median(b->sorted, (size_t)n);
    }
}

/* Median over tracks of the widest angle between the first ray and another, px. */
static double parallax_px(struct bundle *b)
{
    const struct adjust *a = &b->a;
    int n = 0;
    for (int t = 0; t < a->n_tracks; t++) {
        const double *x = b->best.point + 4 * (size_t)t;
        double ray[3], first[3] = {0}, c[3], least = 2;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            const double *p = b->best.pose + (size_t)ADJUST_POSE * (size_t)a->seen[i].view;
            if (!b->best.in[i])
                continue;
            lin_apply_t(p, p + 9, c);
            for (int k = 0; k < 3; k++)
                ray[k] = x[k] + x[3] * c[k];
            lin_normalise(ray);
            if (least > 1)
                memcpy(first, ray, sizeof first);
            least = fmin(least, lin_dot(ray, first));
        }
        if (least <= 1.001)
            b->sorted[n++] = (float)(acos(fmax(-1, fmin(1, least))) * b->best.focal);
    }
    return (double)num_median(b->sorted, (size_t)n);
}

/* Share of the redundancy beyond chance and of the views; then parallax against the errors. */
static void rate_result(struct bundle *b, struct bundle_result *out)
{
    const double wanted = 4 * fmax(0.5, (double)out->rms_px);
    double all, in;
    memcpy(b->a.in, b->best.in, (size_t)b->tracks->n * sizeof *b->a.in);
    in = count_redundancy(b, false, &all);
    if (all < 1)
        return;
    double share = fmax(0, (in / all - CHANCE) / (1 - CHANCE));
    double parallax = pow(parallax_px(b) / wanted, 4);
    out->agreement = (float)(share * out->n_placed / b->n_views);
    out->confidence = (float)(share * out->n_placed / b->n_views * parallax / (1 + parallax));
}

static err_t write_result(struct bundle *b, struct bundle_result *out)
{
    struct world w;
    err_t e = find_world(b, &w);
    if (e)
        return e;
    b->a.pose = b->best.pose;
    b->a.focal = b->best.focal;
    out->sightings = b->tracks->n;
    out->from_tracks = b->best.from_tracks;
    write_cameras(b, &w, out);
    write_points(b, &w, out);
    write_scales(b, &w, out);
    rate_result(b, out);
    return OK;
}

/* ---- run ---- */

static err_t layout_result(struct bundle_result *out, struct arena *keep, int n_views, int n_tracks)
{
    err_t e = arena_zalloc(keep, (size_t)n_views, sizeof *out->cams, &out->cams);
    if (!e)
        e = arena_alloc(keep, 3 * (size_t)n_tracks, sizeof *out->points, &out->points);
    if (!e)
        e = arena_alloc(keep, (size_t)n_views, sizeof *out->depth_scale, &out->depth_scale);
    if (!e)
        e = arena_zalloc(keep, (size_t)n_views, sizeof *out->placed, &out->placed);
    return e;
}

void bundle_plan(struct plan *p, int n_views, const struct match_tracks *t)
{
    struct bundle_result out;
    struct bundle b;
    struct input x;
    const size_t mark = arena_mark(&p->tmp);
    if (layout_result(&out, &p->keep, n_views, t->n_tracks) || layout(&b, &x, &p->tmp, n_views, t))
        plan_refuse(p);
    arena_step(&p->tmp, adjust_plan(n_views, t->n_tracks));
    arena_step(&p->tmp, viewgraph_plan(n_views, t->n));
    arena_step(&p->tmp, similarity_plan(n_views));
    arena_reset(&p->tmp, mark);
}

/* Relative poses for a wrong focal length are wrong, and adjustment then converges slowly. So it
 * starts again where the focal length comes out different. */
static err_t from_focal(struct bundle *b, double focal)
{
    err_t e = OK;
    b->a.prior_focal = log(focal);
    for (int k = 0; k < 3 && !e; k++) {
        e = from_tracks(b, focal);
        if (fabs(log(b->a.focal / focal)) < 0.05)
            break;
        focal = b->a.focal;
    }
    return e;
}

static err_t run_starts(struct bundle *b)
{
    const double focal = start_focal(b), usual = FOV60 * b->v->size;
    b->best.focal = focal;
    b->a.prior_focal = log(focal);
    b->a.prior = b->cfg->focal > 0 ? 10 : b->cfg->start ? 4 : 2;
    b->a.focal_fixed = b->cfg->focal_known;
    if (b->cfg->rig_known)
        return from_rig(b);
    err_t e = b->cfg->start ? from_cameras(b) : OK;
    b->a.focal_fixed = b->cfg->focal_known;
    if (!e)
        e = from_focal(b, focal);
    /* a network's focal length may be worse than none */
    if (!e && !(b->cfg->focal > 0) && fabs(log(focal / usual)) > 0.05)
        e = from_focal(b, usual);
    return e;
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
    if (e)
        return e;
    if (own.start && !are_usable(own.start, n_views))
        own.start = NULL;
    own.rig_known &= own.start != NULL;
    struct bundle b = {.r = r, .cfg = &own, .tracks = tracks, .n_views = n_views, .v = v};
    b.a.n_views = n_views;
    b.a.n_tracks = tracks->n_tracks;
    b.scale = 1;
    e = layout_result(out, r->keep, n_views, tracks->n_tracks);
    if (!e)
        e = load_tracks(&b);
    if (!e && tracks->n > 0)
        e = run_starts(&b);
    if (b.best.focal <= 0)
        b.best.focal = start_focal(&b);
    if (!e)
        e = write_result(&b, out);
    arena_reset(r->tmp, mark);
    if (e)
        *out = (struct bundle_result){0};
    return e;
}
