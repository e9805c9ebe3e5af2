/* Bundle adjustment (Triggs et al., "Bundle adjustment: a modern synthesis", 2000). Unknowns: a
 * twist for each pose, ln of the one focal length, and three directions across each unit 4-vector
 * of a point (Householder basis, Hartley and Zisserman A4.1.2). Points are eliminated track by
 * track (Schur complement); the reduced system of 6 V + 1 unknowns is dense. The gauge is left to
 * the damping. Cauchy loss by weights 1 / (1 + e^2 / kernel^2).
 * Tracks are divided into a fixed number of groups, each with its own sum. Groups are added in
 * order, so that the result does not depend on the threads.
 * Points: from pairs of sightings, the inverse depth along the one ray that brings it nearest to
 * the other (linear, and 0 for parallel rays); the pair that most sightings agree with wins, and
 * Gauss-Newton on these refines it. */
#include "core/sfm/adjust.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { GROUPS = 8, BLOCK = 256, PAIRS_MOST = 24, POINT_STEPS = 4 };
static const double BEHIND = 1e30, NEAREST = 1e-9,
                    DONE = 3e-6; // DONE: relative gain of a last step

/* ---- one sighting ---- */

static void to_camera(const double *pose, const double point[4], double out[3])
{
    lin_apply(pose, point, out);
    for (int k = 0; k < 3; k++)
        out[k] += pose[9 + k] * point[3];
}

double adjust_error(const struct adjust *a, const double point[4], const struct adjust_seen *s)
{
    double x[3];
    to_camera(a->pose + (size_t)ADJUST_POSE * (size_t)s->view, point, x);
    if (!(x[2] > NEAREST))
        return BEHIND;
    double du = a->focal * x[0] / x[2] - (double)s->u, dv = a->focal * x[1] / x[2] - (double)s->v;
    double e = (du * du + dv * dv) * (double)s->weight * (double)s->weight;
    return e < BEHIND ? e : BEHIND;
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

bool adjust_jacobian(const struct adjust *a, const double point[4], const struct adjust_seen *s,
                     struct adjust_jacobian *out)
{
    const double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)s->view;
    double x[3], v[4], factor = householder(point, v);
    to_camera(pose, point, x);
    if (!(x[2] > NEAREST))
        return false;
    const double scale = a->focal * (double)s->weight / x[2];
    const double seen[2] = {(double)s->u, (double)s->v};
    for (int k = 0; k < 2; k++) {
        const double by[3] = {k ? 0 : scale, k ? scale : 0, -scale * x[k] / x[2]};
        double by_point[4], along = 0;
        out->focal[k] = scale * x[k];
        out->error[k] = scale * x[k] - seen[k] * (double)s->weight;
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

/* ---- points ---- */

static void viewing_ray(const struct adjust *a, const struct adjust_seen *s, double centre[3],
                        double dir[3])
{
    const double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)s->view;
    const double x[3] = {(double)s->u / a->focal, (double)s->v / a->focal, 1};
    lin_apply_t(pose, x, dir);
    lin_normalise(dir);
    lin_apply_t(pose, pose + 9, centre);
    for (int k = 0; k < 3; k++)
        centre[k] = -centre[k];
}

static void point_of_pair(const struct adjust *a, const struct adjust_seen *s,
                          const struct adjust_seen *other, double point[4])
{
    double c[3], d[3], c2[3], d2[3], move[3], turn[3], len = 0;
    viewing_ray(a, s, c, d);
    viewing_ray(a, other, c2, d2);
    const double base[3] = {c[0] - c2[0], c[1] - c2[1], c[2] - c2[2]};
    lin_cross(base, d2, move);
    lin_cross(d, d2, turn);
    double mm = lin_dot(move, move), inverse = mm > 0 ? -lin_dot(move, turn) / mm : 0;
    inverse = inverse > 0 && inverse < 1e9 ? inverse : 0;
    for (int k = 0; k < 4; k++) {
        point[k] = k < 3 ? inverse * c[k] + d[k] : inverse;
        len += point[k] * point[k];
    }
    for (int k = 0; k < 4; k++)
        point[k] /= sqrt(len);
}

/* Truncated cost of a point over the sightings of its track. */
static double point_cost(const struct adjust *a, int track, const double point[4], double gate2)
{
    double sum = 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++)
        if (a->placed[a->seen[i].view])
            sum += fmin(adjust_error(a, point, &a->seen[i]), gate2);
    return sum;
}

/* Gauss-Newton on the sightings within the gate, as long as the cost falls. returns: the cost. */
static double point_polish(const struct adjust *a, int track, double gate2, double cost,
                           double point[4])
{
    for (int step = 0; step < POINT_STEPS; step++) {
        double h[9] = {0}, g[3] = {0}, next[4];
        struct adjust_jacobian s;
        for (int i = a->first[track]; i < a->first[track + 1]; i++) {
            if (!a->placed[a->seen[i].view] || !adjust_jacobian(a, point, &a->seen[i], &s) ||
                s.error[0] * s.error[0] + s.error[1] * s.error[1] >= gate2)
                continue;
            for (int k = 0; k < 2; k++)
                lin_add_equation(h, g, 3, s.point[k], 1, s.error[k]);
        }
        double trace = h[0] + h[4] + h[8];
        for (int k = 0; k < 3; k++)
            h[4 * k] += 1e-9 * trace;
        if (!lin_cholesky(h, 3))
            return cost;
        lin_solve(h, 3, g);
        memcpy(next, point, sizeof next);
        adjust_move_point(next, g);
        double now = point_cost(a, track, next, gate2);
        if (!(now < cost))
            return cost;
        memcpy(point, next, sizeof next);
        bool done = cost - now < 1e-4 * cost;
        cost = now;
        if (done)
            break;
    }
    return cost;
}

/* Pair number k of n sightings: of all pairs, or of PAIRS_MOST of them. */
static void pair_of(int k, int n, int *i, int *j)
{
    int all = n * (n - 1) / 2;
    int at = all <= PAIRS_MOST ? k : (int)(((long)k * 2 + 1) * all / (2 * PAIRS_MOST));
    int gap = 1;
    while (at >= n - gap) {
        at -= n - gap;
        gap++;
    }
    *i = at;
    *j = at + gap;
}

static void place_point(struct adjust *a, int track, double gate2)
{
    const int from = a->first[track], n = a->first[track + 1] - from;
    double *point = a->point + 4 * (size_t)track;
    double old[4], best;
    int count = 0;
    memcpy(old, point, sizeof old);
    best = point_cost(a, track, old, gate2);
    best = isfinite(best) ? best : INFINITY;
    for (int k = 0; k < num_min(n * (n - 1) / 2, PAIRS_MOST); k++) {
        double now[4];
        int i, j;
        pair_of(k, n, &i, &j);
        const struct adjust_seen *s = &a->seen[from + i], *t = &a->seen[from + j];
        if (!a->placed[s->view] || !a->placed[t->view])
            continue;
        point_of_pair(a, s, t, now);
        double cost = point_cost(a, track, now, gate2);
        if (cost < best) {
            best = cost;
            memcpy(point, now, sizeof now);
        }
    }
    point_polish(a, track, gate2, best, point);
    for (int i = from; i < from + n; i++) {
        a->in[i] = a->placed[a->seen[i].view] && adjust_error(a, point, &a->seen[i]) < gate2;
        count += a->in[i];
    }
    for (int i = from; i < from + n && count < 2; i++)
        a->in[i] = false;
}

struct points_job {
    const struct run *r;
    struct adjust *a;
    double gate2;
};

static err_t points_block(void *ctx, int chunk, int worker)
{
    struct points_job *job = ctx;
    (void)worker;
    err_t e = run_check(job->r, "placing points");
    for (int t = chunk * BLOCK; t < num_min((chunk + 1) * BLOCK, job->a->n_tracks) && !e; t++)
        place_point(job->a, t, job->gate2);
    return e;
}

err_t adjust_points(const struct run *r, struct adjust *a, double gate)
{
    struct points_job job = {r, a, gate * gate};
    return pool_for(r->pool, (a->n_tracks + BLOCK - 1) / BLOCK, points_block, &job);
}

/* ---- normal equations ---- */

struct normal {
    const struct run *r;
    const struct adjust *a;
    double kernel2, damping;
    int n;         // 6 V + 1 unknowns of cameras
    double *sum;   // (GROUPS, n, n) lower triangles
    double *rhs;   // (GROUPS, n)
    double *cross; // (GROUPS, V, 18 + 18) W and W H^-1 of the sightings of a track
    double *step;  // (n)
    double *trial; // (n_tracks, 4)
    double cost[GROUPS];
};

static double cauchy_loss(double e2, double kernel2)
{
    return 0.5 * kernel2 * log1p(e2 / kernel2);
}

static void group_of(int n_tracks, int g, int *from, int *to)
{
    *from = (int)((long)n_tracks * g / GROUPS);
    *to = (int)((long)n_tracks * (g + 1) / GROUPS);
}

/* Sums of one track for its point. */
struct track_sum {
    double h[9], g[3], focal[3]; // point; focal by point
    int n;                       // sightings
};

/* Add the camera blocks of a sighting to the group's sums. */
static void add_camera(struct normal *m, int view, const struct adjust_jacobian *s, double w,
                       double *sum, double *rhs)
{
    const int n = m->n, f = n - 1;
    const double more = 1 + m->damping;
    for (int p = 0; p < 6; p++) {
        double *row = sum + (size_t)(6 * view + p) * (size_t)n + (size_t)(6 * view);
        for (int q = 0; q <= p; q++)
            row[q] += w * (p == q ? more : 1) *
                      (s->pose[0][p] * s->pose[0][q] + s->pose[1][p] * s->pose[1][q]);
        sum[(size_t)f * (size_t)n + (size_t)(6 * view + p)] +=
            w * (s->pose[0][p] * s->focal[0] + s->pose[1][p] * s->focal[1]);
        rhs[6 * view + p] -= w * (s->pose[0][p] * s->error[0] + s->pose[1][p] * s->error[1]);
    }
    sum[(size_t)f * (size_t)n + (size_t)f] +=
        w * more * (s->focal[0] * s->focal[0] + s->focal[1] * s->focal[1]);
    rhs[f] -= w * (s->focal[0] * s->error[0] + s->focal[1] * s->error[1]);
}

static void add_point(const struct adjust_jacobian *s, double w, struct track_sum *t,
                      double cross[18])
{
    for (int p = 0; p < 3; p++) {
        for (int q = 0; q < 3; q++)
            t->h[3 * p + q] +=
                w * (s->point[0][p] * s->point[0][q] + s->point[1][p] * s->point[1][q]);
        t->g[p] -= w * (s->point[0][p] * s->error[0] + s->point[1][p] * s->error[1]);
        t->focal[p] += w * (s->point[0][p] * s->focal[0] + s->point[1][p] * s->focal[1]);
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

/* Linearise one track: its sums, W of sighting i in cross + 36 i, and the camera blocks if sum is
 * not NULL. */
static void linearise_track(struct normal *m, int track, double *cross, double *sum, double *rhs,
                            struct track_sum *t)
{
    const struct adjust *a = m->a;
    memset(t, 0, sizeof *t);
    for (int i = a->first[track]; i < a->first[track + 1]; i++, t->n++) {
        struct adjust_jacobian s;
        double *w = cross + 36 * (size_t)t->n;
        memset(w, 0, 18 * sizeof *w);
        if (!a->in[i] || !adjust_jacobian(a, a->point + 4 * (size_t)track, &a->seen[i], &s))
            continue;
        double e2 = s.error[0] * s.error[0] + s.error[1] * s.error[1];
        double weight = 1 / (1 + e2 / m->kernel2);
        if (sum)
            add_camera(m, a->seen[i].view, &s, weight, sum, rhs);
        add_point(&s, weight, t, w);
    }
}

/* block -= u v^T of two 6 x 3 matrices. */
static void subtract_product(const double *u, const double *v, double *block, size_t stride)
{
    for (int p = 0; p < 6; p++)
        for (int q = 0; q < 6; q++)
            block[(size_t)p * stride + (size_t)q] -= lin_dot(u + 3 * p, v + 3 * q);
}

/* sum -= W H^-1 W^T between all sightings of a track and the focal length. */
static void eliminate_point(const struct normal *m, int track, const struct track_sum *t,
                            double *cross, double *sum, double *rhs)
{
    const struct adjust *a = m->a;
    const size_t n = (size_t)m->n, f = n - 1;
    double inverse[9], focal[3];
    if (!point_inverse(m, t, inverse))
        return;
    lin_apply(inverse, t->focal, focal);
    sum[f * n + f] -= lin_dot(focal, t->focal);
    rhs[f] -= lin_dot(focal, t->g);
    for (int i = 0; i < t->n; i++) {
        const int at = a->first[track] + i;
        const size_t row = 6 * (size_t)a->seen[at].view;
        double *w = cross + 36 * (size_t)i, *wh = w + 18;
        if (!a->in[at])
            continue;
        for (int p = 0; p < 6; p++) {
            lin_apply(inverse, w + 3 * p, wh + 3 * p);
            rhs[row + (size_t)p] -= lin_dot(wh + 3 * p, t->g);
            sum[f * n + row + (size_t)p] -= lin_dot(wh + 3 * p, t->focal);
        }
        for (int j = 0; j <= i; j++) // views ascend: the lower triangle
            if (a->in[at - i + j])
                subtract_product(wh, cross + 36 * (size_t)j,
                                 sum + row * n + 6 * (size_t)a->seen[at - i + j].view, n);
    }
}

static err_t normal_group(void *ctx, int g, int worker)
{
    struct normal *m = ctx;
    const size_t n = (size_t)m->n;
    double *sum = m->sum + (size_t)g * n * n, *rhs = m->rhs + (size_t)g * n;
    double *cross = m->cross + (size_t)g * 36 * (size_t)m->a->n_views;
    int from, to;
    (void)worker;
    memset(sum, 0, n * n * sizeof *sum);
    memset(rhs, 0, n * sizeof *rhs);
    group_of(m->a->n_tracks, g, &from, &to);
    for (int t = from; t < to; t++) {
        struct track_sum track;
        linearise_track(m, t, cross, sum, rhs, &track);
        eliminate_point(m, t, &track, cross, sum, rhs);
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

/* Step of the cameras at the present damping. */
static err_t camera_step(struct normal *m, bool *ok)
{
    const struct adjust *a = m->a;
    const int n = m->n;
    err_t e = pool_for(m->r->pool, GROUPS, normal_group, m);
    double *s = m->sum, deviation = (log(a->focal) - a->prior_focal) * a->prior;
    for (int g = 1; g < GROUPS && !e; g++) {
        for (size_t i = 0; i < (size_t)n * (size_t)n; i++)
            s[i] += m->sum[(size_t)g * (size_t)n * (size_t)n + i];
        for (int i = 0; i < n; i++)
            m->rhs[i] += m->rhs[(size_t)g * (size_t)n + (size_t)i];
    }
    if (e)
        return e;
    s[(size_t)n * (size_t)n - 1] += a->prior * a->prior;
    m->rhs[n - 1] -= a->prior * deviation;
    for (int k = 0; k < n; k++)
        if ((k < n - 1 ? a->poses_fixed || !a->placed[k / 6] : a->focal_fixed) ||
            !(s[(size_t)k * (size_t)n + (size_t)k] > 0))
            fix_unknown(s, n, k, m->rhs);
    *ok = lin_cholesky(s, n);
    memcpy(m->step, m->rhs, (size_t)n * sizeof *m->step);
    if (*ok)
        lin_solve(s, n, m->step);
    return OK;
}

/* ---- steps ---- */

static double track_cost(const struct adjust *a, int track, const double point[4], double kernel2)
{
    double sum = 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++)
        if (a->in[i])
            sum += cauchy_loss(adjust_error(a, point, &a->seen[i]), kernel2);
    return sum;
}

/* Points follow the cameras: H d = g - W^T step. */
static err_t back_group(void *ctx, int g, int worker)
{
    struct normal *m = ctx;
    const struct adjust *a = m->a;
    double *cross = m->cross + (size_t)g * 36 * (size_t)a->n_views;
    int from, to;
    (void)worker;
    group_of(a->n_tracks, g, &from, &to);
    for (int t = from; t < to; t++) {
        struct track_sum track;
        double inverse[9], by[3], *point = m->trial + 4 * (size_t)t;
        memcpy(point, a->point + 4 * (size_t)t, 4 * sizeof *point);
        linearise_track(m, t, cross, NULL, NULL, &track);
        if (!point_inverse(m, &track, inverse))
            continue;
        for (int k = 0; k < 3; k++)
            track.g[k] -= track.focal[k] * m->step[m->n - 1];
        for (int i = 0; i < 6 * track.n; i++) {
            const double *w = cross + 36 * (size_t)(i / 6) + 3 * (size_t)(i % 6);
            const double by_view = m->step[6 * a->seen[a->first[t] + i / 6].view + i % 6];
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
    group_of(m->a->n_tracks, g, &from, &to);
    m->cost[g] = 0;
    for (int t = from; t < to; t++)
        m->cost[g] += track_cost(m->a, t, m->a->point + 4 * (size_t)t, m->kernel2);
    return run_check(m->r, "bundle adjustment");
}

static err_t total_cost(struct normal *m, double *out)
{
    err_t e = pool_for(m->r->pool, GROUPS, cost_group, m);
    *out = 0;
    for (int g = 0; g < GROUPS && !e; g++)
        *out += m->cost[g];
    return e;
}

static double prior_cost(const struct adjust *a)
{
    double d = (log(a->focal) - a->prior_focal) * a->prior;
    return 0.5 * d * d;
}

static size_t count_unknowns(int n_views)
{
    return 6 * (size_t)n_views + 1;
}

/* Apply the step to poses and focal length; swap in the points of m->trial. */
static void apply_step(struct normal *m, struct adjust *a, const double *pose)
{
    double *point = a->point;
    for (int v = 0; v < a->n_views; v++) {
        double *p = a->pose + (size_t)ADJUST_POSE * (size_t)v;
        memcpy(p, pose + (size_t)ADJUST_POSE * (size_t)v, ADJUST_POSE * sizeof *p);
        adjust_move_pose(p, m->step + 6 * v);
    }
    a->focal *= exp(fmax(-0.5, fmin(0.5, m->step[m->n - 1])));
    a->point = m->trial;
    m->trial = point;
}

static err_t minimise(struct normal *m, struct adjust *a, double *pose, int steps)
{
    const size_t bytes = (size_t)ADJUST_POSE * (size_t)a->n_views * sizeof *pose;
    double cost, now = 0, ease = 0.1;
    err_t e = total_cost(m, &cost);
    cost += prior_cost(a);
    m->damping = 1e-4;
    for (int k = 0; k < steps && !e && m->damping < 1e7; k++) {
        double focal = a->focal;
        bool ok;
        e = camera_step(m, &ok);
        if (!e && ok)
            e = pool_for(m->r->pool, GROUPS, back_group, m);
        if (e || !ok) {
            m->damping *= 10;
            continue;
        }
        memcpy(pose, a->pose, bytes);
        apply_step(m, a, pose);
        e = total_cost(m, &now);
        now += prior_cost(a);
        if (!e && now < cost) {
            bool done = cost - now < DONE * cost;
            cost = now;
            m->damping = fmax(m->damping * ease, 1e-9);
            ease = fmax(ease * 0.5, 0.1);
            if (done)
                break;
            continue;
        }
        double *point = a->point;
        a->point = m->trial;
        m->trial = point;
        a->focal = focal;
        memcpy(a->pose, pose, bytes);
        m->damping *= 4;
        ease = 0.8;
    }
    return e;
}

static err_t layout(struct normal *m, double **pose, struct arena *tmp, int n_views, int n_tracks)
{
    const size_t n = count_unknowns(n_views), v = (size_t)n_views;
    err_t e = arena_alloc(tmp, GROUPS * n * n, sizeof(double), &m->sum);
    if (!e)
        e = arena_alloc(tmp, GROUPS * n, sizeof(double), &m->rhs);
    if (!e)
        e = arena_alloc(tmp, GROUPS * 36 * v, sizeof(double), &m->cross);
    if (!e)
        e = arena_alloc(tmp, n, sizeof(double), &m->step);
    if (!e)
        e = arena_alloc(tmp, ADJUST_POSE * v, sizeof(double), pose);
    return e ? e : arena_alloc(tmp, 4 * (size_t)n_tracks, sizeof(double), &m->trial);
}

size_t adjust_plan(int n_views, int n_tracks)
{
    struct arena tmp = arena_counter();
    struct normal m;
    double *pose;
    return layout(&m, &pose, &tmp, n_views, n_tracks) ? SIZE_MAX : tmp.peak;
}

err_t adjust_run(const struct run *r, struct adjust *a, double kernel, int steps)
{
    const size_t mark = arena_mark(r->tmp), points = 4 * (size_t)a->n_tracks;
    struct normal m = {
        .r = r, .a = a, .kernel2 = kernel * kernel, .n = (int)count_unknowns(a->n_views)};
    double *own = a->point, *pose;
    err_t e = layout(&m, &pose, r->tmp, a->n_views, a->n_tracks);
    if (!e)
        e = minimise(&m, a, pose, steps);
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
