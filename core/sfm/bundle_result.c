/* From the best answer to the result: its world, cameras, points, and how far it can be trusted. */
#include "core/sfm/bundle_inner.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/connectivity.h"
#include "core/sfm/covariance.h"
#include "core/sfm/similarity.h"

#include <math.h>
#include <string.h>

static const double CHANCE = 0.2;        // redundancy that wrong matches may have
static const double FAR = 1e-6;          // least w of a point in the result
static const double LEAST_SPREAD = 1e-6; // of cameras, typical point at 1: they stood still

double bundle_result_redundancy(const struct bundle *b, const bool *in, bool soft, double *all)
{
    const struct adjust *a = &b->a;
    double sum = 0;
    *all = 0;
    for (int t = 0; t < a->n_tracks; t++) {
        const int seen = a->first[t + 1] - a->first[t];
        double n = 0;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            double e2 = soft ? adjust_error(a, a->point + 4 * (size_t)t, &a->obs[i]) : 0;
            n += in[i] ? fmax(0, 1 - e2 / (BUNDLE_GATE * BUNDLE_GATE)) : 0;
        }
        sum += fmax(0, 2 * n - 3);
        *all += seen > 1 ? 2 * seen - 3 : 0;
    }
    return sum;
}

/* Similarity from the adjusted world to that of the result. */
struct world {
    double scale, r[9], t[3]; // x_out = scale r x + t
};

/* X_view = S X_sensor with S (x, y) = (-y, x). */
void bundle_result_turn(double pose[ADJUST_POSE], int quarters)
{
    for (int k = 0; k < (quarters & 3); k++)
        for (int i = 0; i < 4; i++) {
            double *x = i < 3 ? pose + i : pose + 9, *y = i < 3 ? pose + 3 + i : pose + 10;
            const double old = *x;
            *x = -*y;
            *y = old;
        }
}

static struct camera camera_of(const struct bundle *b, int v)
{
    const struct extent *px = &b->v->extent[v];
    const float f = b->cfg->pinhole ? b->cfg->pinhole[v] : (float)adjust_focal(&b->a, v);
    double p[ADJUST_POSE];
    memcpy(p, b->best.pose + (size_t)ADJUST_POSE * (size_t)v, sizeof p);
    bundle_result_turn(p, bundle_turned(b, v));
    struct camera cam = {
        px->w, px->h, f, f / bundle_aspect(b), 0.5f * (float)px->w, 0.5f * (float)px->h, {0}, {0}};
    double q[4];
    rotation_to_quat(p, q);
    for (int k = 0; k < 4; k++)
        cam.q[k] = (float)q[k];
    for (int k = 0; k < 3; k++)
        cam.t[k] = (float)p[9 + k];
    return cam;
}

/* Makes the root of the mean squared distance of the placed cameras from their middle 1: the unit
 * means nothing, and viewers of the scene expect one of this kind. */
static void choose_unit(const struct bundle *b, struct world *out)
{
    double sum[3] = {0}, square = 0, c[3];
    int n = 0;
    for (int v = 0; v < b->n_views; v++) {
        const double *p = b->best.pose + (size_t)ADJUST_POSE * (size_t)v;
        if (!b->best.placed[v])
            continue;
        lin_apply_t(p, p + 9, c);
        square += lin_dot(c, c);
        for (int k = 0; k < 3; k++)
            sum[k] += c[k];
        n++;
    }
    const double spread = n > 0 ? sqrt(fmax(0, square / n - lin_dot(sum, sum) / n / n)) : 0;
    if (!(spread > LEAST_SPREAD))
        return;
    for (int k = 0; k < 3; k++)
        out->t[k] /= spread * out->scale;
    out->scale = 1 / spread;
}

/* World of `start` if there is one, else that of the first placed camera; but for its unit, unless
 * the cameras are known. */
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
            double p[ADJUST_POSE];
            memcpy(p, b->best.pose + (size_t)ADJUST_POSE * (size_t)v, sizeof p);
            bundle_result_turn(p, bundle_turned(b, v));
            memcpy(out->r, p, sizeof out->r);
            memcpy(out->t, p + 9, sizeof out->t);
        }
        if (b->cfg->start) {
            from[n] = camera_of(b, v);
            to[n++] = b->cfg->start[v];
        }
    }
    err_t e = b->cfg->start && n > 0 ? similarity_fit(b->r, from, to, n, &w) : OK;
    if (e)
        return e;
    if (b->cfg->start && n > 0 && w.scale > 0 && isfinite(w.scale + w.t[0] + w.t[1] + w.t[2])) {
        out->scale = w.scale;
        rotation_from_quat(w.q, out->r);
        memcpy(out->t, w.t, sizeof out->t);
    }
    if (!b->cfg->rig_known)
        choose_unit(b, out);
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
            double weight = (double)a->obs[i].weight;
            sum += adjust_error(a, x, &a->obs[i]) / (weight * weight);
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
            const struct match_observation *s = &b->tracks->obs[i];
            if (s->view != v || !b->best.in[i])
                continue;
            double z = w->scale * adjust_depth(a, v, b->best.point + 4 * (size_t)s->track);
            float ratio = (float)z / bundle_depth_at(b, s);
            if (ratio > 0 && isfinite(ratio))
                b->sorted[n++] = ratio;
        }
        if (n >= CONNECTIVITY_VIEW)
            out->depth_scale[v] = num_median(b->sorted, (size_t)n);
    }
}

/* A twist's covariance in the view: turned about the axis, lengths of the result's world. */
static void turn_covariance(int quarters, double scale, double c[COVARIANCE_POSE])
{
    static const int from[6] = {1, 0, 2, 4, 3, 5}; // x' = -y, y' = x, for both halves
    static const double sign[6] = {-1, 1, 1, -1, 1, 1};
    double was[COVARIANCE_POSE];
    for (int k = 0; k < (quarters & 3); k++) {
        memcpy(was, c, sizeof was);
        for (int i = 0; i < COVARIANCE_POSE; i++)
            c[i] = sign[i / 6] * sign[i % 6] * was[6 * from[i / 6] + from[i % 6]];
    }
    for (int i = 0; i < COVARIANCE_POSE; i++)
        c[i] *= (i / 6 < 3 ? 1 : scale) * (i % 6 < 3 ? 1 : scale);
}

static void write_poses(struct bundle *b, const struct world *w, struct bundle_result *out)
{
    for (int v = 0; v < b->n_views; v++) {
        int n = 0;
        turn_covariance(bundle_turned(b, v), w->scale, out->pose_covariance + COVARIANCE_POSE * v);
        for (int i = 0; i < b->tracks->n; i++) {
            const struct match_observation *s = &b->tracks->obs[i];
            if (s->view == v && b->best.in[i])
                b->sorted[n++] =
                    (float)adjust_depth(&b->a, v, b->best.point + 4 * (size_t)s->track);
        }
        out->depth[v] = (float)(w->scale * (double)num_median(b->sorted, (size_t)n));
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
            const double *p = b->best.pose + (size_t)ADJUST_POSE * (size_t)a->obs[i].view;
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
            b->sorted[n++] =
                (float)(acos(fmax(-1, fmin(1, least))) * adjust_focal(a, a->obs[a->first[t]].view));
    }
    return (double)num_median(b->sorted, (size_t)n);
}

/* Share of the redundancy beyond chance and of the views; then parallax against the errors. */
static void rate_result(struct bundle *b, struct bundle_result *out)
{
    const double wanted = 4 * fmax(0.5, (double)out->rms_px);
    double all, in;
    in = bundle_result_redundancy(b, b->best.in, false, &all);
    if (all < 1)
        return;
    double share = fmax(0, (in / all - CHANCE) / (1 - CHANCE));
    double parallax = pow(parallax_px(b) / wanted, 4);
    out->agreement = (float)(share * out->n_placed / b->n_views);
    out->confidence = (float)(share * out->n_placed / b->n_views * parallax / (1 + parallax));
}

err_t bundle_result_write(struct bundle *b, struct bundle_result *out)
{
    struct world w;
    b->a.pose = b->best.pose;
    b->a.lens = b->best.lens;
    err_t e = find_world(b, &w);
    if (e)
        return e;
    for (int i = 0; i < b->a.n_lenses; i++)
        out->lenses[i] = b->best.lens[i].lens;
    out->observations = b->tracks->n;
    out->from_tracks = b->best.from_tracks;
    write_cameras(b, &w, out);
    write_points(b, &w, out);
    write_scales(b, &w, out);
    if (b->cfg->measure_poses)
        write_poses(b, &w, out);
    rate_result(b, out);
    return OK;
}
