/* Bundle adjustment (Triggs et al., "Bundle adjustment: a modern synthesis", 2000). Unknowns: a
 * twist for each pose, ln focal length and terms of each lens as far as they are free, and three
 * directions across each unit 4-vector of a point (Householder basis, Hartley and Zisserman
 * A4.1.2). Points are eliminated track by track (Schur complement); the reduced system of poses,
 * then lenses, is dense. The gauge is left to the damping. Cauchy loss by weights 1 / (1 + e^2 /
 * kernel^2). Tracks are divided into a fixed number of groups, each with its own sum. Groups are
 * added in order, so that the result does not depend on the threads. */
#include "core/sfm/adjust.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/sfm/adjust_inner.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { GROUPS_MANY = 4, MANY = 64 }; // GROUPS_MANY: of more than MANY views
static const double BEHIND = 1e30, NEAREST = 1e-9,
                    WIDEST = 2, // tangent of 63 degrees
    DONE = 3e-6,                // relative gain of a last step
    TERM_PRIOR = 0.5,           // 1 / expected size of a distortion term
    FISHEYE_PRIOR = 10,         // the same: 0.083 stereographic, -0.042 of equal areas
    CENTRE_PRIOR = 10;          // focal length / expected shift of the principal point

/* ---- one observation ---- */

static void to_camera(const double *pose, const double point[4], double out[3])
{
    lin_apply(pose, point, out);
    for (int k = 0; k < 3; k++)
        out[k] += pose[9 + k] * point[3];
}

static const struct lens *lens_of(const struct adjust *a, int view)
{
    return &a->lens[a->lens_of[view]].lens;
}

/* Pixel of a point in camera coordinates. */
static bool image_of(const struct lens *l, const double x[3], double out[2])
{
    if (l->model != LENS_PINHOLE)
        return lens_project(l, x, out);
    out[0] = l->fx * x[0] / x[2];
    out[1] = l->fx * x[1] / x[2];
    return x[2] > NEAREST;
}

double adjust_error(const struct adjust *a, const double point[4],
                    const struct adjust_observation *s)
{
    double x[3], px[2];
    to_camera(a->pose + (size_t)ADJUST_POSE * (size_t)s->view, point, x);
    if (!image_of(lens_of(a, s->view), x, px))
        return BEHIND;
    double du = px[0] - (double)s->u, dv = px[1] - (double)s->v;
    double e = (du * du + dv * dv) * (double)s->weight * (double)s->weight;
    return e < BEHIND ? e : BEHIND;
}

bool adjust_too_wide(const struct adjust_lens *l)
{
    const double corner[2] = {l->lens.cx + l->frame, l->lens.cy};
    double ray[3];
    if (l->lens.model == LENS_OPENCV_FISHEYE || !(l->frame > 0))
        return false;
    return !lens_unproject(&l->lens, corner, ray) || hypot(ray[0], ray[1]) > WIDEST * ray[2];
}

void adjust_ray(const struct adjust *a, const struct adjust_observation *s, double ray[3])
{
    const struct lens *l = lens_of(a, s->view);
    const double px[2] = {(double)s->u, (double)s->v};
    if (l->model != LENS_PINHOLE && lens_unproject(l, px, ray))
        return;
    ray[0] = px[0] / l->fx;
    ray[1] = px[1] / l->fx;
    ray[2] = 1;
    lin_normalise(ray);
}

double adjust_depth(const struct adjust *a, int view, const double point[4])
{
    double x[3];
    to_camera(a->pose + (size_t)ADJUST_POSE * (size_t)view, point, x);
    if (fabs(point[3]) < DBL_MIN)
        return x[2] < 0 ? -INFINITY : INFINITY;
    return x[2] / point[3];
}

/* Householder vector v that reflects the point onto the last axis. returns: 2 / |v|^2. */
static double householder(const double point[4], double v[4])
{
    memcpy(v, point, 4 * sizeof *v);
    v[3] += v[3] < 0 ? -1 : 1;
    return 2 / (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3]);
}

/* Pixel of a point in camera coordinates, its derivatives by these (2 x 3) and by the unknowns of
 * the lens. */
static bool image_slopes(const struct lens *l, const double x[3], double px[2], double by[6],
                         double by_lens[2][ADJUST_LENS])
{
    double by_param[2 * LENS_PARAMS] = {0};
    memset(by_lens, 0, 2 * sizeof *by_lens);
    if (l->model == LENS_PINHOLE) {
        const double scale = l->fx / x[2];
        const double rows[6] = {scale, 0, -scale * x[0] / x[2], 0, scale, -scale * x[1] / x[2]};
        if (!(x[2] > NEAREST))
            return false;
        memcpy(by, rows, sizeof rows);
        px[0] = scale * x[0];
        px[1] = scale * x[1];
    } else if (!lens_project_grad(l, x, px, by, by_param))
        return false;
    for (int k = 0; k < 2; k++) {
        by_lens[k][0] = px[k] - (k ? l->cy : l->cx);
        for (int i = 0; i < LENS_TERMS; i++)
            by_lens[k][1 + i] = by_param[LENS_PARAMS * k + 4 + i];
        for (int i = 0; i < 2; i++)
            by_lens[k][ADJUST_CENTRE + i] = by_param[LENS_PARAMS * k + 2 + i];
    }
    return true;
}

bool adjust_jacobian(const struct adjust *a, const double point[4],
                     const struct adjust_observation *s, struct adjust_jacobian *out)
{
    const double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)s->view;
    double x[3], px[2], rows[6], v[4], factor = householder(point, v);
    to_camera(pose, point, x);
    if (!image_slopes(lens_of(a, s->view), x, px, rows, out->lens))
        return false;
    const double obs[2] = {(double)s->u, (double)s->v}, weight = (double)s->weight;
    for (int k = 0; k < 2; k++) {
        const double by[3] = {weight * rows[3 * k], weight * rows[3 * k + 1],
                              weight * rows[3 * k + 2]};
        double by_point[4], along = 0;
        out->error[k] = weight * (px[k] - obs[k]);
        for (int i = 0; i < ADJUST_LENS; i++)
            out->lens[k][i] *= weight;
        lin_cross(x, by, out->pose[k]);
        for (int i = 0; i < 3; i++)
            out->pose[k][3 + i] = by[i] * point[3];
        lin_apply_t(pose, by, by_point);
        by_point[3] = lin_dot(by, pose + 9);
        for (int i = 0; i < 4; i++)
            along += by_point[i] * v[i];
        for (int i = 0; i < 3; i++)
            out->point[k][i] = by_point[i] - factor * along * v[i];
    }
    return true;
}

void adjust_move_pose(double pose[ADJUST_POSE], const double twist[6])
{
    double turn[9], old[ADJUST_POSE];
    memcpy(old, pose, sizeof old);
    rotation_exp(twist, turn);
    lin_product(turn, old, pose);
    lin_apply(turn, old + 9, pose + 9);
    for (int k = 0; k < 3; k++)
        pose[9 + k] += twist[3 + k];
}

void adjust_move_point(double point[4], const double by[3])
{
    double v[4], factor = householder(point, v), len = 0;
    double along = v[0] * by[0] + v[1] * by[1] + v[2] * by[2];
    for (int i = 0; i < 4; i++) {
        point[i] += (i < 3 ? by[i] : 0) - factor * along * v[i];
        len += point[i] * point[i];
    }
    for (int i = 0; i < 4; i++)
        point[i] /= sqrt(len);
}

/* ---- normal equations ---- */

static double cauchy_loss(double e2, double kernel2)
{
    return 0.5 * kernel2 * log1p(e2 / kernel2);
}

/* Groups of tracks. The sums of each are a whole system, so large ones have fewer. */
static int groups_of(int n_views)
{
    return n_views > MANY ? GROUPS_MANY : ADJUST_GROUPS;
}

/* Tracks of a group. */
static void tracks_of(const struct normal *m, int g, int *from, int *to)
{
    *from = (int)((long)m->a->n_tracks * g / m->n_groups);
    *to = (int)((long)m->a->n_tracks * (g + 1) / m->n_groups);
}

/* Sums of one track for its point. */
struct track_sum {
    double h[9], g[3];
    int n, n_blocks; // observations, lenses
    struct lens_block *block;
};

/* Derivatives by the free unknowns of a lens, side by side. */
static int free_slopes(const struct adjust_lens *l, const struct adjust_jacobian *s,
                       double out[2][ADJUST_LENS])
{
    int n = 0;
    for (int i = 0; i < ADJUST_LENS; i++) {
        if (!l->free[i])
            continue;
        out[0][n] = s->lens[0][i];
        out[1][n++] = s->lens[1][i];
    }
    return n;
}

/* Add the camera blocks of an observation to the group's sums. */
static void add_camera(struct normal *m, int view, const struct adjust_jacobian *s, double w,
                       double *sum, double *rhs)
{
    const int n = m->n, lens = m->a->lens_of[view];
    const double more = 1 + m->damping;
    double by[2][ADJUST_LENS];
    const int n_free = free_slopes(&m->a->lens[lens], s, by);
    for (int p = 0; p < 6; p++) {
        double *row = sum + (size_t)(6 * view + p) * (size_t)n + (size_t)(6 * view);
        for (int q = 0; q <= p; q++)
            row[q] += w * (p == q ? more : 1) *
                      (s->pose[0][p] * s->pose[0][q] + s->pose[1][p] * s->pose[1][q]);
        rhs[6 * view + p] -= w * (s->pose[0][p] * s->error[0] + s->pose[1][p] * s->error[1]);
    }
    for (int p = 0; p < n_free; p++) {
        double *row = sum + (size_t)(m->at[lens] + p) * (size_t)n;
        for (int q = 0; q < 6; q++)
            row[6 * view + q] += w * (s->pose[0][q] * by[0][p] + s->pose[1][q] * by[1][p]);
        for (int q = 0; q <= p; q++)
            row[m->at[lens] + q] +=
                w * (p == q ? more : 1) * (by[0][p] * by[0][q] + by[1][p] * by[1][q]);
        rhs[m->at[lens] + p] -= w * (by[0][p] * s->error[0] + by[1][p] * s->error[1]);
    }
}

static struct lens_block *block_of(struct track_sum *t, int lens)
{
    int k = 0;
    while (k < t->n_blocks && t->block[k].lens != lens)
        k++;
    if (k == t->n_blocks) {
        t->block[t->n_blocks++].lens = lens;
        memset(t->block[k].w, 0, sizeof t->block[k].w);
    }
    return &t->block[k];
}

static void add_point(const struct adjust *a, int view, const struct adjust_jacobian *s, double w,
                      struct track_sum *t, double cross[18])
{
    const int lens = a->lens_of[view];
    double by[2][ADJUST_LENS];
    const int n_free = free_slopes(&a->lens[lens], s, by);
    struct lens_block *block = block_of(t, lens);
    for (int p = 0; p < 3; p++) {
        for (int q = 0; q < 3; q++)
            t->h[3 * p + q] +=
                w * (s->point[0][p] * s->point[0][q] + s->point[1][p] * s->point[1][q]);
        t->g[p] -= w * (s->point[0][p] * s->error[0] + s->point[1][p] * s->error[1]);
        for (int q = 0; q < n_free; q++)
            block->w[3 * q + p] += w * (s->point[0][p] * by[0][q] + s->point[1][p] * by[1][q]);
        for (int q = 0; q < 6; q++)
            cross[3 * q + p] =
                w * (s->pose[0][q] * s->point[0][p] + s->pose[1][q] * s->point[1][p]);
    }
}

/* Damp the point's block and invert it; false leaves the point out of this step. */
static bool point_inverse(const struct normal *m, const struct track_sum *t, double inverse[9])
{
    double h[9];
    memcpy(h, t->h, sizeof h);
    for (int k = 0; k < 3; k++)
        h[4 * k] += m->damping * h[4 * k] + 1e-10 * (t->h[0] + t->h[4] + t->h[8]);
    return lin_inverse3(h, inverse);
}

static double *group_cross(const struct normal *m, int group)
{
    return m->cross + 36 * (size_t)group * (size_t)m->a->n_views;
}

/* Linearise one track: its sums, W of observation i in cross + 36 i, and the camera blocks if sum
 * is not NULL. */
static void linearise_track(struct normal *m, int track, int group, double *sum, double *rhs,
                            struct track_sum *t)
{
    const struct adjust *a = m->a;
    double *cross = group_cross(m, group);
    *t = (struct track_sum){.block = m->block + (size_t)group * (size_t)a->n_views};
    for (int i = a->first[track]; i < a->first[track + 1]; i++, t->n++) {
        struct adjust_jacobian s;
        double *w = cross + 36 * (size_t)t->n;
        memset(w, 0, 18 * sizeof *w);
        if (!a->in[i] || !adjust_jacobian(a, a->point + 4 * (size_t)track, &a->obs[i], &s))
            continue;
        double e2 = s.error[0] * s.error[0] + s.error[1] * s.error[1];
        double weight = 1 / (1 + e2 / m->kernel2);
        if (sum)
            add_camera(m, a->obs[i].view, &s, weight, sum, rhs);
        add_point(a, a->obs[i].view, &s, weight, t, w);
    }
}

/* block -= u v^T of two 6 x 3 matrices. */
static void subtract_product(const double *u, const double *v, double *block, size_t stride)
{
    for (int p = 0; p < 6; p++)
        for (int q = 0; q < 6; q++)
            block[(size_t)p * stride + (size_t)q] -= lin_dot(u + 3 * p, v + 3 * q);
}

/* The rows of lens `l` of the elimination: with its own and the other lenses, and with the poses.
 * */
static void eliminate_lens(const struct normal *m, int track, const struct track_sum *t,
                           const struct lens_block *l, double *sum)
{
    const struct adjust *a = m->a;
    const double *cross = group_cross(m, 0) + (t->block - m->block) * 36;
    const size_t n = (size_t)m->n;
    const int from = m->at[l->lens], n_free = m->at[l->lens + 1] - from;
    for (int p = 0; p < n_free; p++) {
        double *row = sum + (size_t)(from + p) * n;
        for (int k = 0; k < t->n_blocks; k++) {
            const struct lens_block *other = &t->block[k];
            const int to = m->at[other->lens], end = m->at[other->lens + 1];
            for (int q = to; q < end && q <= from + p; q++) // the lower triangle
                row[q] -= lin_dot(l->wh + 3 * p, other->w + 3 * (q - to));
        }
        for (int i = 0; i < t->n; i++) {
            const int at = a->first[track] + i;
            const double *w = cross + 36 * (size_t)i;
            for (int q = 0; q < 6 && a->in[at]; q++)
                row[6 * a->obs[at].view + q] -= lin_dot(l->wh + 3 * p, w + 3 * q);
        }
    }
}

/* sum -= W H^-1 W^T between all observations of a track and the lenses. */
static void eliminate_point(const struct normal *m, int track, const struct track_sum *t,
                            double *sum, double *rhs)
{
    const struct adjust *a = m->a;
    double *cross = group_cross(m, 0) + (t->block - m->block) * 36;
    const size_t n = (size_t)m->n;
    double inverse[9];
    if (!point_inverse(m, t, inverse))
        return;
    for (int k = 0; k < t->n_blocks; k++) {
        struct lens_block *l = &t->block[k];
        for (int p = 0; p < m->at[l->lens + 1] - m->at[l->lens]; p++) {
            lin_apply(inverse, l->w + 3 * p, l->wh + 3 * p);
            rhs[m->at[l->lens] + p] -= lin_dot(l->wh + 3 * p, t->g);
        }
    }
    for (int k = 0; k < t->n_blocks; k++)
        eliminate_lens(m, track, t, &t->block[k], sum);
    for (int i = 0; i < t->n; i++) {
        const int at = a->first[track] + i;
        const size_t row = 6 * (size_t)a->obs[at].view;
        double *w = cross + 36 * (size_t)i, *wh = w + 18;
        if (!a->in[at])
            continue;
        for (int p = 0; p < 6; p++) {
            lin_apply(inverse, w + 3 * p, wh + 3 * p);
            rhs[row + (size_t)p] -= lin_dot(wh + 3 * p, t->g);
        }
        for (int j = 0; j <= i; j++) // views ascend: the lower triangle
            if (a->in[at - i + j])
                subtract_product(wh, cross + 36 * (size_t)j,
                                 sum + row * n + 6 * (size_t)a->obs[at - i + j].view, n);
    }
}

static err_t normal_group(void *ctx, int g, int worker)
{
    struct normal *m = ctx;
    const size_t n = (size_t)m->n;
    double *sum = m->sum + (size_t)g * n * n, *rhs = m->rhs + (size_t)g * n;
    int from, to;
    (void)worker;
    memset(sum, 0, n * n * sizeof *sum);
    memset(rhs, 0, n * sizeof *rhs);
    tracks_of(m, g, &from, &to);
    for (int t = from; t < to; t++) {
        struct track_sum track;
        linearise_track(m, t, g, sum, rhs, &track);
        eliminate_point(m, t, &track, sum, rhs);
    }
    return run_check(m->r, "bundle adjustment");
}

/* Fix unknown k: its row and column become those of the identity. */
static void fix_unknown(double *s, int n, int k, double *rhs)
{
    for (int i = 0; i < n; i++)
        s[i > k ? (size_t)i * (size_t)n + (size_t)k : (size_t)k * (size_t)n + (size_t)i] = 0;
    s[(size_t)k * (size_t)n + (size_t)k] = 1;
    rhs[k] = 0;
}

/* Expected value of an unknown of a lens less its present one; its weight, and what that is
 * multiplied with where the gap is not credible (Welsch). */
static double prior_gap(const struct adjust_lens *l, int unknown, double *weight, double *doubt)
{
    const double term = l->lens.model == LENS_OPENCV_FISHEYE ? FISHEYE_PRIOR : TERM_PRIOR;
    const double focal = l->prior_focal - log(l->lens.fx);
    *weight = unknown == 0 ? l->prior : unknown < ADJUST_CENTRE ? term : CENTRE_PRIOR / l->lens.fx;
    *doubt = unknown == 0 && l->prior_reach > 0 ? exp(-0.5 * pow(focal / l->prior_reach, 2)) : 1;
    if (unknown >= ADJUST_CENTRE)
        return unknown == ADJUST_CENTRE ? -l->lens.cx : -l->lens.cy;
    return unknown == 0 ? focal : -l->lens.term[unknown - 1];
}

double adjust_prior_weight(const struct adjust_lens *l, int unknown)
{
    double weight, doubt;
    prior_gap(l, unknown, &weight, &doubt);
    return weight * doubt;
}

static void add_priors(const struct normal *m, double *s)
{
    for (int i = 0; i < m->a->n_lenses; i++)
        for (int p = 0, k = m->at[i]; p < ADJUST_LENS; p++) {
            double weight, doubt, gap = prior_gap(&m->a->lens[i], p, &weight, &doubt);
            weight *= doubt;
            if (!m->a->lens[i].free[p])
                continue;
            s[(size_t)k * (size_t)m->n + (size_t)k] += weight * weight;
            m->rhs[k++] += weight * weight * gap;
        }
}

err_t adjust_sum_system(struct normal *m)
{
    const struct adjust *a = m->a;
    const int n = m->n;
    err_t e = pool_for(m->r->pool, m->n_groups, normal_group, m);
    double *s = m->sum;
    for (int g = 1; g < m->n_groups && !e; g++) {
        for (size_t i = 0; i < (size_t)n * (size_t)n; i++)
            s[i] += m->sum[(size_t)g * (size_t)n * (size_t)n + i];
        for (int i = 0; i < n; i++)
            m->rhs[i] += m->rhs[(size_t)g * (size_t)n + (size_t)i];
    }
    if (e)
        return e;
    add_priors(m, s);
    for (int k = 0; k < n; k++)
        if ((k < 6 * a->n_views && (a->poses_fixed || !a->placed[k / 6])) ||
            !(s[(size_t)k * (size_t)n + (size_t)k] > 0))
            fix_unknown(s, n, k, m->rhs);
    return OK;
}

static err_t camera_step(struct normal *m, bool *ok)
{
    err_t e = adjust_sum_system(m);
    memcpy(m->step, m->rhs, (size_t)m->n * sizeof *m->step);
    *ok = !e && lin_cholesky(m->sum, m->n);
    if (*ok)
        lin_solve(m->sum, m->n, m->step);
    return e;
}

/* ---- steps ---- */

static double track_cost(const struct adjust *a, int track, const double point[4], double kernel2)
{
    double sum = 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++)
        if (a->in[i])
            sum += cauchy_loss(adjust_error(a, point, &a->obs[i]), kernel2);
    return sum;
}

/* Points follow the cameras: H d = g - W^T step. */
static err_t back_group(void *ctx, int g, int worker)
{
    struct normal *m = ctx;
    const struct adjust *a = m->a;
    const double *cross = group_cross(m, g);
    int from, to;
    (void)worker;
    tracks_of(m, g, &from, &to);
    for (int t = from; t < to; t++) {
        struct track_sum track;
        double inverse[9], by[3], *point = m->trial + 4 * (size_t)t;
        memcpy(point, a->point + 4 * (size_t)t, 4 * sizeof *point);
        linearise_track(m, t, g, NULL, NULL, &track);
        if (!point_inverse(m, &track, inverse))
            continue;
        for (int i = 0; i < track.n_blocks; i++) {
            const struct lens_block *l = &track.block[i];
            for (int k = 0; k < 3 * (m->at[l->lens + 1] - m->at[l->lens]); k++)
                track.g[k % 3] -= l->w[k] * m->step[m->at[l->lens] + k / 3];
        }
        for (int i = 0; i < 6 * track.n; i++) {
            const double *w = cross + 36 * (size_t)(i / 6) + 3 * (size_t)(i % 6);
            const double by_view = m->step[6 * a->obs[a->first[t] + i / 6].view + i % 6];
            for (int k = 0; k < 3; k++)
                track.g[k] -= w[k] * by_view;
        }
        lin_apply(inverse, track.g, by);
        if (lin_dot(by, by) < 1)
            adjust_move_point(point, by);
    }
    return OK;
}

static err_t cost_group(void *ctx, int g, int worker)
{
    struct normal *m = ctx;
    int from, to;
    (void)worker;
    tracks_of(m, g, &from, &to);
    m->cost[g] = 0;
    for (int t = from; t < to; t++)
        m->cost[g] += track_cost(m->a, t, m->a->point + 4 * (size_t)t, m->kernel2);
    return run_check(m->r, "bundle adjustment");
}

static err_t total_cost(struct normal *m, double *out)
{
    err_t e = pool_for(m->r->pool, m->n_groups, cost_group, m);
    *out = 0;
    for (int g = 0; g < m->n_groups && !e; g++)
        *out += m->cost[g];
    return e;
}

static double prior_cost(const struct adjust *a)
{
    double sum = 0;
    for (int i = 0; i < a->n_lenses * ADJUST_LENS; i++) {
        const struct adjust_lens *l = &a->lens[i / ADJUST_LENS];
        double weight, doubt, d = prior_gap(l, i % ADJUST_LENS, &weight, &doubt);
        const double counts =
            doubt < 1 ? pow(l->prior_reach, 2) * (1 - doubt * doubt) : d * d; // its integral
        sum += l->free[i % ADJUST_LENS] ? 0.5 * counts * weight * weight : 0;
    }
    return sum;
}

static size_t count_unknowns(int n_views, int n_lenses)
{
    return 6 * (size_t)n_views + ADJUST_LENS * (size_t)n_lenses;
}

/* Move the free unknowns of the lenses. False where one has no meaning any more. */
static bool move_lenses(const struct normal *m, struct adjust *a)
{
    bool ok = true;
    for (int i = 0; i < a->n_lenses; i++) {
        struct adjust_lens *l = &a->lens[i];
        const double *step = m->step + m->at[i];
        if (l->free[0])
            l->lens.fx = l->lens.fy = l->lens.fx * exp(fmax(-0.5, fmin(0.5, *step++)));
        for (int k = 0; k < LENS_TERMS; k++)
            l->lens.term[k] += l->free[1 + k] ? *step++ : 0;
        l->lens.cx += l->free[ADJUST_CENTRE] ? *step++ : 0;
        l->lens.cy += l->free[ADJUST_CENTRE + 1] ? *step++ : 0;
        ok = ok && isfinite(l->lens.fx) && lens_init(&l->lens) == OK;
    }
    return ok;
}

static void back_up(const struct adjust *a, const struct backup *b)
{
    memcpy(b->pose, a->pose, (size_t)ADJUST_POSE * (size_t)a->n_views * sizeof *a->pose);
    memcpy(b->lens, a->lens, (size_t)a->n_lenses * sizeof *a->lens);
}

static void swap_points(struct normal *m, struct adjust *a)
{
    double *point = a->point;
    a->point = m->trial;
    m->trial = point;
}

static void go_back(struct normal *m, const struct backup *b, struct adjust *a)
{
    swap_points(m, a);
    memcpy(a->pose, b->pose, (size_t)ADJUST_POSE * (size_t)a->n_views * sizeof *a->pose);
    memcpy(a->lens, b->lens, (size_t)a->n_lenses * sizeof *a->lens);
}

/* Apply the step to poses and lenses; swap in the points of m->trial. */
static bool apply_step(struct normal *m, struct adjust *a)
{
    for (int v = 0; v < a->n_views; v++)
        adjust_move_pose(a->pose + (size_t)ADJUST_POSE * (size_t)v, m->step + 6 * v);
    swap_points(m, a);
    return move_lenses(m, a);
}

static err_t minimise_cost(struct normal *m, struct adjust *a, const struct backup *before,
                           int steps)
{
    double cost, now = 0, ease = 0.1;
    err_t e = total_cost(m, &cost);
    cost += prior_cost(a);
    m->damping = 1e-4;
    for (int k = 0; k < steps && !e && m->damping < 1e7; k++) {
        bool ok;
        e = camera_step(m, &ok);
        if (!e && ok)
            e = pool_for(m->r->pool, m->n_groups, back_group, m);
        if (e || !ok) {
            m->damping *= 10;
            continue;
        }
        back_up(a, before);
        ok = apply_step(m, a);
        e = total_cost(m, &now);
        now += prior_cost(a);
        if (!e && ok && now < cost) {
            bool done = cost - now < DONE * cost;
            cost = now;
            m->damping = fmax(m->damping * ease, 1e-9);
            ease = fmax(ease * 0.5, 0.1);
            if (done)
                break;
            continue;
        }
        go_back(m, before, a);
        m->damping *= 4;
        ease = 0.8;
    }
    return e;
}

static err_t layout(struct normal *m, struct backup *b, struct arena *tmp, const int count[3])
{
    const size_t n = count_unknowns(count[0], count[1]), v = (size_t)count[0];
    const size_t lenses = (size_t)count[1], groups = (size_t)groups_of(count[0]);
    err_t e = arena_alloc(tmp, groups * n * n, sizeof(double), &m->sum);
    if (!e)
        e = arena_alloc(tmp, groups * n, sizeof(double), &m->rhs);
    if (!e)
        e = arena_alloc(tmp, groups * 36 * v, sizeof(double), &m->cross);
    if (!e)
        e = arena_alloc(tmp, groups * v, sizeof *m->block, &m->block);
    if (!e)
        e = arena_alloc(tmp, n, sizeof(double), &m->step);
    if (!e)
        e = arena_alloc(tmp, lenses + 1, sizeof *m->at, &m->at);
    if (!e)
        e = arena_alloc(tmp, ADJUST_POSE * v, sizeof(double), &b->pose);
    if (!e)
        e = arena_alloc(tmp, lenses, sizeof *b->lens, &b->lens);
    return e ? e : arena_alloc(tmp, 4 * (size_t)count[2], sizeof(double), &m->trial);
}

size_t adjust_plan(int n_views, int n_lenses, int n_tracks)
{
    struct arena tmp = arena_counter();
    struct normal m;
    struct backup b;
    return layout(&m, &b, &tmp, (int[3]){n_views, n_lenses, n_tracks}) ? SIZE_MAX : tmp.peak;
}

err_t adjust_begin_system(const struct run *r, struct adjust *a, double kernel, struct normal *m,
                          struct backup *b)
{
    *m = (struct normal){
        .r = r, .a = a, .kernel2 = kernel * kernel, .n_groups = groups_of(a->n_views)};
    err_t e = layout(m, b, r->tmp, (int[3]){a->n_views, a->n_lenses, a->n_tracks});
    m->n = 6 * a->n_views;
    for (int i = 0; i < a->n_lenses && !e; i++) {
        m->at[i] = m->n;
        for (int k = 0; k < ADJUST_LENS; k++)
            m->n += a->lens[i].free[k];
    }
    if (!e)
        m->at[a->n_lenses] = m->n;
    return e;
}

err_t adjust_run(const struct run *r, struct adjust *a, double kernel, int steps)
{
    const size_t mark = arena_mark(r->tmp), points = 4 * (size_t)a->n_tracks;
    struct normal m;
    struct backup before;
    double *own = a->point;
    err_t e = adjust_begin_system(r, a, kernel, &m, &before);
    if (!e)
        e = minimise_cost(&m, a, &before, steps);
    if (a->point != own) { // the arena's array is released
        memcpy(own, a->point, points * sizeof *own);
        a->point = own;
    }
    arena_reset(r->tmp, mark);
    return e;
}

/* ---- gauge ---- */

void adjust_normalise(struct adjust *a)
{
    double mean[3] = {0}, c[3], sum = 0;
    int n = 0, n_far = 0;
    for (int v = 0; v < a->n_views; v++) {
        const double *p = a->pose + (size_t)ADJUST_POSE * (size_t)v;
        lin_apply_t(p, p + 9, c);
        for (int k = 0; k < 3 && a->placed[v]; k++)
            mean[k] -= c[k];
        n += a->placed[v];
    }
    for (int k = 0; k < 3 && n > 0; k++)
        mean[k] /= n;
    for (int t = 0; t < a->n_tracks; t++) {
        const double *x = a->point + 4 * (size_t)t, w = fabs(x[3]) + 1e-9;
        const double d[3] = {x[0] - mean[0] * x[3], x[1] - mean[1] * x[3], x[2] - mean[2] * x[3]};
        double far = 0.5 * log(lin_dot(d, d) / (w * w));
        if (!isfinite(far) || !a->in[a->first[t]])
            continue;
        sum += far;
        n_far++;
    }
    double scale = n_far > 0 ? exp(-sum / n_far) : 1;
    for (int v = 0; v < a->n_views; v++) {
        double *p = a->pose + (size_t)ADJUST_POSE * (size_t)v;
        lin_apply(p, mean, c);
        for (int k = 0; k < 3; k++)
            p[9 + k] = scale * (p[9 + k] + c[k]);
    }
    for (int t = 0; t < a->n_tracks; t++) {
        double *x = a->point + 4 * (size_t)t, len = 0;
        for (int k = 0; k < 3; k++)
            x[k] = scale * (x[k] - mean[k] * x[3]);
        for (int k = 0; k < 4; k++)
            len += x[k] * x[k];
        for (int k = 0; k < 4 && len > 0; k++)
            x[k] /= sqrt(len);
    }
}
