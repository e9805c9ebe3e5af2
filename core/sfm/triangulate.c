/* From pairs of observations, the inverse depth along the one ray that brings it nearest to the
 * other (linear, and 0 for parallel rays); the pair that most observations agree with wins, and
 * Gauss-Newton on these refines it. */
#include "core/sfm/triangulate.h"

#include "core/base/lin.h"
#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { BLOCK = 256, PAIRS_MOST = 24, POINT_STEPS = 4 };

static void viewing_ray(const struct adjust *a, const struct adjust_observation *s,
                        double centre[3], double dir[3])
{
    const double *pose = a->pose + (size_t)ADJUST_POSE * (size_t)s->view;
    double x[3];
    adjust_ray(a, s, x);
    lin_apply_t(pose, x, dir);
    lin_apply_t(pose, pose + 9, centre);
    for (int k = 0; k < 3; k++)
        centre[k] = -centre[k];
}

static void point_of_pair(const struct adjust *a, const struct adjust_observation *s,
                          const struct adjust_observation *other, double point[4])
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

/* Whether an observation takes part. */
static bool is_used(const struct adjust *a, int i)
{
    return a->placed[a->obs[i].view] && !(a->held && a->held[i]);
}

/* Truncated cost of a point over the observations of its track. */
static double point_cost(const struct adjust *a, int track, const double point[4], double gate2)
{
    double sum = 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++)
        if (is_used(a, i))
            sum += fmin(adjust_error(a, point, &a->obs[i]), gate2);
    return sum;
}

/* Gauss-Newton on the observations within the gate, as long as the cost falls. returns: the cost.
 * */
static double point_polish(const struct adjust *a, int track, double gate2, double cost,
                           double point[4])
{
    for (int step = 0; step < POINT_STEPS; step++) {
        double h[9] = {0}, g[3] = {0}, next[4];
        struct adjust_jacobian s;
        for (int i = a->first[track]; i < a->first[track + 1]; i++) {
            if (!is_used(a, i) || !adjust_jacobian(a, point, &a->obs[i], &s) ||
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

/* Pair number k of n observations: of all pairs, or of PAIRS_MOST of them. */
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
        const struct adjust_observation *s = &a->obs[from + i], *t = &a->obs[from + j];
        if (!is_used(a, from + i) || !is_used(a, from + j))
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
        a->in[i] = is_used(a, i) && adjust_error(a, point, &a->obs[i]) < gate2;
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

err_t triangulate_points(const struct run *r, struct adjust *a, double gate)
{
    struct points_job job = {r, a, gate * gate};
    return pool_for(r->pool, (a->n_tracks + BLOCK - 1) / BLOCK, points_block, &job);
}
