/* With the rotation known, a sighting gives two linear equations for the translation, and two
 * sightings are enough: random pairs, scored by the truncated error of all (MSAC). The best one of
 * each candidate rotation is polished in all six degrees of freedom, Gauss-Newton with Cauchy
 * weights that narrow. */
#include "core/sfm/resect.h"

#include "core/base/lin.h"

#include <math.h>
#include <string.h>

enum { DRAWS = 60, STEPS = 12, POINTS_LEAST = 6, POINTS_MOST = 512 };
static const double SHARE = 0.5; // least share of the points

struct resect {
    struct adjust *a;
    int view, n;
    int track[POINTS_MOST], at[POINTS_MOST]; // points that two other views place; sightings of them
    double gate;
    uint32_t state;
};

static void collect_points(struct resect *s)
{
    const struct adjust *a = s->a;
    for (int t = 0; t < a->n_tracks && s->n < POINTS_MOST; t++) {
        int n = 0, at = -1;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            n += a->in[i];
            at = a->seen[i].view == s->view ? i : at;
        }
        if (n > 1 && at >= 0) {
            s->track[s->n] = t;
            s->at[s->n++] = at;
        }
    }
}

static const double *point_of(const struct resect *s, int k)
{
    return s->a->point + 4 * (size_t)s->track[k];
}

static double *pose_of(const struct resect *s)
{
    return s->a->pose + (size_t)ADJUST_POSE * (size_t)s->view;
}

/* Truncated cost of the view's pose. */
static double cost_of(const struct resect *s, double gate, int *inliers)
{
    double sum = 0;
    *inliers = 0;
    for (int i = 0; i < s->n; i++) {
        double e = adjust_error(s->a, point_of(s, i), &s->a->seen[s->at[i]]);
        *inliers += e < gate * gate;
        sum += fmin(e, gate * gate);
    }
    return sum;
}

/* Equations of a sighting: u (r3 X + t3 w) = r1 X + t1 w, and the same for v. */
static void add_equations(const struct resect *s, int i_point, double h[9], double g[3])
{
    const double *x = point_of(s, i_point), w = x[3];
    double y[3], ray[3];
    adjust_ray(s->a, &s->a->seen[s->at[i_point]], ray);
    lin_apply(pose_of(s), x, y);
    for (int k = 0; k < 2; k++) {
        const double u = ray[k] / fmax(ray[2], 0.05); // hardly ever beyond 87 degrees
        const double row[3] = {k ? 0 : w, k ? w : 0, -u * w}, right = u * y[2] - y[k];
        for (int i = 0; i < 3; i++) {
            g[i] += row[i] * right;
            for (int j = 0; j < 3; j++)
                h[3 * i + j] += row[i] * row[j];
        }
    }
}

static int draw_point(struct resect *s)
{
    s->state = s->state * 1664525u + 1013904223u;
    return (int)(((uint64_t)(s->state >> 8) * (uint32_t)s->n) >> 24);
}

/* Translation of a random pair of points. */
static bool draw_translation(struct resect *s)
{
    double h[9] = {0}, g[3] = {0}, *pose = pose_of(s);
    for (int k = 0; k < 2; k++)
        add_equations(s, draw_point(s), h, g);
    for (int k = 0; k < 3; k++)
        h[4 * k] += 1e-12;
    if (!lin_cholesky(h, 3))
        return false;
    lin_solve(h, 3, g);
    if (!isfinite(lin_dot(g, g)))
        return false;
    memcpy(pose + 9, g, sizeof g);
    return true;
}

static void polish_step(struct resect *s, double kernel)
{
    double h[36] = {0}, g[6] = {0};
    for (int n = 0; n < s->n; n++) {
        struct adjust_jacobian d;
        if (!adjust_jacobian(s->a, point_of(s, n), &s->a->seen[s->at[n]], &d))
            continue;
        double e2 = d.error[0] * d.error[0] + d.error[1] * d.error[1];
        double w = 1 / (1 + e2 / (kernel * kernel));
        for (int k = 0; k < 2; k++)
            lin_add_equation(h, g, 6, d.pose[k], w * w, d.error[k]);
    }
    for (int k = 0; k < 6; k++)
        h[7 * k] += 1e-6 * h[7 * k] + 1e-12;
    if (!lin_cholesky(h, 6))
        return;
    lin_solve(h, 6, g);
    if (lin_dot(g, g) < 1 && lin_dot(g + 3, g + 3) < 1e6)
        adjust_move_pose(pose_of(s), g);
}

/* Best translation and polish for the rotation that is in the pose; returns the cost. */
static double try_rotation(struct resect *s, int *inliers)
{
    double best[ADJUST_POSE], least = INFINITY;
    memcpy(best, pose_of(s), sizeof best);
    for (int k = 0; k < DRAWS; k++) {
        if (k > 0 && !draw_translation(s))
            continue;
        double cost = cost_of(s, 8 * s->gate, inliers);
        if (cost < least) {
            least = cost;
            memcpy(best, pose_of(s), sizeof best);
        }
    }
    memcpy(pose_of(s), best, sizeof best);
    for (int k = 0; k < STEPS; k++)
        polish_step(s, fmax(s->gate / 2, 8 * s->gate * pow(0.6, k)));
    return cost_of(s, s->gate, inliers);
}

/* Rotation of the view as a placed neighbour and their edge have it. */
static bool from_neighbour(const struct viewgraph *g, const struct adjust *a, int view, int other,
                           double pose[ADJUST_POSE])
{
    const int low = view < other ? view : other, high = view < other ? other : view;
    if (low == high || !a->placed[other] || !g->edge)
        return false;
    const struct viewgraph_edge *e = &g->edge[high * (high - 1) / 2 + low];
    const double *from = a->pose + (size_t)ADJUST_POSE * (size_t)other;
    double r[9];
    if (e->pose.inliers == 0)
        return false;
    for (int k = 0; k < 9; k++)
        r[k] = view == high ? e->pose.r[k] : e->pose.r[3 * (k % 3) + k / 3];
    lin_product(r, from, pose);
    lin_apply(r, from + 9, pose + 9);
    return true;
}

int resect_view(const struct viewgraph *g, struct adjust *a, int view, double gate)
{
    struct resect s = {.a = a, .view = view, .gate = gate, .state = 1u + (uint32_t)view};
    double old[ADJUST_POSE], best[ADJUST_POSE], least = INFINITY;
    int most = 0;
    collect_points(&s);
    if (s.n < POINTS_LEAST)
        return 0;
    memcpy(old, pose_of(&s), sizeof old);
    memcpy(best, old, sizeof best);
    for (int other = 0; other < a->n_views; other++) {
        int inliers;
        if (other != view && !from_neighbour(g, a, view, other, pose_of(&s)))
            continue;
        double cost = try_rotation(&s, &inliers);
        if (cost < least && inliers > 0) {
            least = cost;
            most = inliers;
            memcpy(best, pose_of(&s), sizeof best);
        }
    }
    if (most < SHARE * s.n) // ambiguous: another place may fit as well
        most = 0;
    memcpy(pose_of(&s), most ? best : old, sizeof best);
    return most;
}
