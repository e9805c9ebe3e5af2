/* With the rotation known, an observation gives two linear equations for the translation, and two
 * observations are enough: random pairs, scored by the truncated error of all (MSAC). The best one
 * of each candidate rotation is polished in all six degrees of freedom, Gauss-Newton with Cauchy
 * weights that narrow. */
#include "core/sfm/resect.h"

#include "core/base/lin.h"

#include <math.h>
#include <string.h>

enum { DRAWS = 60, STEPS = 12, POINTS_LEAST = 6, POINTS_MOST = 512 };
enum { LENS = 2, UNKNOWNS = 6 + LENS, LENS_LEAST = 16 }; // LENS_LEAST: points that tell a lens
static const double SHARE = 0.5;                         // least share of the points
static const double SHARE_ALONE = 0.25; // where no other pose explains half as many
static const double TERM_MOST = 0.6;    // of a lens's first term
static const double FISHEYE_GAIN = 0.8; // share of the cost that a fisheye must stay below
static const double WIDE_GAIN = 0.6;    // that a lens must stay below which should be a fisheye

struct resect {
    struct adjust *a;
    int view, n;
    int track[POINTS_MOST],
        at[POINTS_MOST]; // points that two other views place; observations of them
    double gate;
    int n_lens; // unknowns of the lens that move with the pose
    uint32_t state;
};

static void collect_points(struct resect *s)
{
    const struct adjust *a = s->a;
    for (int t = 0; t < a->n_tracks && s->n < POINTS_MOST; t++) {
        int n = 0, at = -1;
        for (int i = a->first[t]; i < a->first[t + 1]; i++) {
            n += a->in[i];
            at = a->obs[i].view == s->view ? i : at;
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
        double e = adjust_error(s->a, point_of(s, i), &s->a->obs[s->at[i]]);
        *inliers += e < gate * gate;
        sum += fmin(e, gate * gate);
    }
    return sum;
}

/* Equations of an observation: u (r3 X + t3 w) = r1 X + t1 w, and the same for v. */
static void add_equations(const struct resect *s, int i_point, double h[9], double g[3])
{
    const double *x = point_of(s, i_point), w = x[3];
    double y[3], ray[3];
    adjust_ray(s->a, &s->a->obs[s->at[i_point]], ray);
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

static struct lens *lens_of(const struct resect *s)
{
    return &s->a->lens[s->a->lens_of[s->view]].lens;
}

/* Move the lens; one that cannot be stays. */
static void move_lens(const struct resect *s, const double *by)
{
    struct lens *l = lens_of(s), old = *l;
    if (s->n_lens == 0)
        return;
    l->fx = l->fy = l->fx * exp(fmax(-0.2, fmin(0.2, by[0])));
    l->term[0] += fmax(-0.1, fmin(0.1, by[1]));
    if (!(fabs(l->term[0]) < TERM_MOST) || lens_init(l) != OK)
        *l = old;
}

static void polish_step(struct resect *s, double kernel)
{
    const int n = 6 + s->n_lens;
    double h[UNKNOWNS * UNKNOWNS] = {0}, g[UNKNOWNS] = {0};
    for (int i = 0; i < s->n; i++) {
        struct adjust_jacobian d;
        if (!adjust_jacobian(s->a, point_of(s, i), &s->a->obs[s->at[i]], &d))
            continue;
        double e2 = d.error[0] * d.error[0] + d.error[1] * d.error[1];
        double w = 1 / (1 + e2 / (kernel * kernel)), row[UNKNOWNS];
        for (int k = 0; k < 2; k++) {
            memcpy(row, d.pose[k], sizeof d.pose[k]);
            memcpy(row + 6, d.lens[k], (size_t)s->n_lens * sizeof *row);
            lin_add_equation(h, g, n, row, w * w, d.error[k]);
        }
    }
    for (int k = 0; k < n; k++)
        h[(n + 1) * k] += 1e-6 * h[(n + 1) * k] + 1e-12;
    if (!lin_cholesky(h, n))
        return;
    lin_solve(h, n, g);
    if (lin_dot(g, g) < 1 && lin_dot(g + 3, g + 3) < 1e6) {
        adjust_move_pose(pose_of(s), g);
        move_lens(s, g + 6);
    }
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

/* Best pose of the view with the lens that it has, from all its neighbours; returns the cost. */
static double try_neighbours(const struct viewgraph *g, struct resect *s, int *inliers)
{
    struct adjust *a = s->a;
    const struct lens start = *lens_of(s);
    struct lens lens = start;
    double old[ADJUST_POSE], best[ADJUST_POSE], least = INFINITY;
    memcpy(old, pose_of(s), sizeof old);
    memcpy(best, old, sizeof best);
    *inliers = 0;
    for (int other = 0; other < a->n_views; other++) {
        int n;
        memcpy(pose_of(s), old, sizeof old);
        *lens_of(s) = start;
        if (other != s->view && !from_neighbour(g, a, s->view, other, pose_of(s)))
            continue;
        double cost = try_rotation(s, &n);
        if (cost < least && n > 0) {
            least = cost;
            *inliers = n;
            lens = *lens_of(s);
            memcpy(best, pose_of(s), sizeof best);
        }
    }
    memcpy(pose_of(s), best, sizeof best);
    *lens_of(s) = lens;
    return least;
}

static bool begin_resect(struct adjust *a, int view, double gate, struct resect *s)
{
    *s = (struct resect){.a = a, .view = view, .gate = gate, .state = 1u + (uint32_t)view};
    collect_points(s);
    return s->n >= POINTS_LEAST;
}

/* Of the points that the pose does not explain, how many one other does; the pose stays. */
static int explain_rest(const struct viewgraph *g, struct resect *s)
{
    double old[ADJUST_POSE];
    int n = 0, most;
    for (int i = 0; i < s->n; i++)
        if (adjust_error(s->a, point_of(s, i), &s->a->obs[s->at[i]]) >= s->gate * s->gate) {
            s->track[n] = s->track[i];
            s->at[n++] = s->at[i];
        }
    s->n = n;
    if (n < POINTS_LEAST)
        return 0;
    memcpy(old, pose_of(s), sizeof old);
    (void)try_neighbours(g, s, &most);
    memcpy(pose_of(s), old, sizeof old);
    return most;
}

int resect_view(const struct viewgraph *g, struct adjust *a, int view, double gate)
{
    struct resect s;
    double old[ADJUST_POSE];
    int most;
    if (!begin_resect(a, view, gate, &s))
        return 0;
    const int n = s.n;
    memcpy(old, pose_of(&s), sizeof old);
    (void)try_neighbours(g, &s, &most);
    if (most >= SHARE * n || (most >= SHARE_ALONE * n && most > 2 * explain_rest(g, &s)))
        return most;
    memcpy(pose_of(&s), old, sizeof old); // ambiguous: another place may fit as well
    return 0;
}

int resect_other(const struct viewgraph *g, struct adjust *a, int view, double gate)
{
    struct resect s;
    return begin_resect(a, view, gate, &s) ? explain_rest(g, &s) : 0;
}

int resect_lens(const struct viewgraph *g, struct adjust *a, int view, double gate)
{
    /* focal lengths over the present one, which is that of a usual lens */
    static const struct {
        enum lens_model model;
        double focal, term;
    } trial[] = {{LENS_SIMPLE_RADIAL, 1, 0},        {LENS_SIMPLE_RADIAL, 0.7, -0.1},
                 {LENS_SIMPLE_RADIAL, 0.45, -0.15}, {LENS_SIMPLE_RADIAL, 1.5, 0},
                 {LENS_OPENCV_FISHEYE, 0.55, 0},    {LENS_OPENCV_FISHEYE, 0.4, 0}};
    struct resect s;
    double old[ADJUST_POSE], best[ADJUST_POSE], least = INFINITY;
    int most = 0;
    if (!begin_resect(a, view, gate, &s))
        return 0;
    const struct lens before = *lens_of(&s);
    struct lens lens = before;
    s.n_lens = LENS;
    memcpy(old, pose_of(&s), sizeof old);
    memcpy(best, old, sizeof best);
    for (size_t i = 0; i < sizeof trial / sizeof *trial; i++) {
        const double f = before.fx * trial[i].focal;
        int inliers;
        *lens_of(&s) = (struct lens){trial[i].model, f, f, 0, 0, {trial[i].term}, 0};
        memcpy(pose_of(&s), old, sizeof old);
        if (lens_init(lens_of(&s)) != OK)
            continue;
        double cost = try_neighbours(g, &s, &inliers);
        if (trial[i].model == LENS_OPENCV_FISHEYE) // narrow ones fit as well as the others
            cost /= FISHEYE_GAIN;
        else if (adjust_too_wide(&a->lens[a->lens_of[view]]))
            cost /= WIDE_GAIN;
        if (cost < least && inliers > 0) {
            least = cost;
            most = inliers;
            lens = *lens_of(&s);
            memcpy(best, pose_of(&s), sizeof best);
        }
    }
    const bool found = most >= SHARE * s.n && most >= LENS_LEAST;
    memcpy(pose_of(&s), found ? best : old, sizeof best);
    *lens_of(&s) = found ? lens : before;
    return found ? most : 0;
}
