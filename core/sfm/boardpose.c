/* The plane-to-plane homography of board and undistorted picture, by linear least squares with the
 * last entry 1: board points are taken from their middle, which lies before the camera. Its columns
 * are, up to a factor, the first two of R, and t (Zhang, PAMI 2000, 3.1). The second pose has the
 * normal of the board mirrored at the line of sight (Schweighofer and Pinz, "Robust pose estimation
 * from a planar target", PAMI 2006). */
#include "core/sfm/boardpose.h"

#include "core/base/lin.h"
#include "core/base/rotation.h"

#include <math.h>
#include <string.h>

enum { UNKNOWN = 8, LEAST = 4, STEPS = 15 };
static const double AHEAD = 0.15, // least z of a unit ray that a homography can use
    KERNEL = 3, WORST = 1e12;     // px; px^2

static void board_middle(const struct boardfit_corner *c, int n, double out[2])
{
    out[0] = out[1] = 0;
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 2; k++)
            out[k] += c[i].at[k] / n;
}

/* Homography from board, taken from its middle, to the plane z = 1. */
static bool find_homography(const struct lens *l, const struct boardfit_corner *c, int n,
                            const double middle[2], double out[9])
{
    double h[UNKNOWN * UNKNOWN] = {0}, g[UNKNOWN] = {0};
    int used = 0;
    for (int i = 0; i < n; i++) {
        const double x = c[i].at[0] - middle[0], y = c[i].at[1] - middle[1];
        double ray[3];
        if (!lens_unproject(l, c[i].px, ray) || ray[2] < AHEAD)
            continue;
        const double u = ray[0] / ray[2], v = ray[1] / ray[2];
        const double a[UNKNOWN] = {x, y, 1, 0, 0, 0, -u * x, -u * y},
                     b[UNKNOWN] = {0, 0, 0, x, y, 1, -v * x, -v * y};
        lin_add_equation(h, g, UNKNOWN, a, 1, -u);
        lin_add_equation(h, g, UNKNOWN, b, 1, -v);
        used++;
    }
    if (used < LEAST || !lin_cholesky(h, UNKNOWN))
        return false;
    lin_solve(h, UNKNOWN, g);
    memcpy(out, g, sizeof g);
    out[8] = 1;
    return true;
}

/* Pose of a homography; t is that of the middle. */
static bool split_homography(const double h[9], double pose[BOARDFIT_POSE])
{
    double a[3] = {h[0], h[3], h[6]}, b[3] = {h[1], h[4], h[7]}, c[3], q[4], r[9];
    const double length = sqrt(lin_normalise(a) * lin_normalise(b));
    if (!(length > 1e-12) || !isfinite(length))
        return false;
    lin_cross(a, b, c);
    for (int k = 0; k < 3; k++) {
        r[3 * k] = a[k];
        r[3 * k + 1] = b[k];
        r[3 * k + 2] = c[k];
    }
    rotation_to_quat(r, q);
    rotation_from_quat(q, pose);
    for (int k = 0; k < 3; k++)
        pose[9 + k] = h[3 * k + 2] / length;
    return true;
}

/* The pose with the normal on the other side of the line of sight. */
static void mirror_pose(const double pose[BOARDFIT_POSE], double out[BOARDFIT_POSE])
{
    double sight[3] = {pose[9], pose[10], pose[11]}, axis[3], turn[9];
    const double normal[3] = {pose[2], pose[5], pose[8]};
    lin_normalise(sight);
    lin_cross(normal, sight, axis);
    const double angle = 2 * atan2(lin_normalise(axis), lin_dot(normal, sight));
    for (int k = 0; k < 3; k++)
        axis[k] *= angle;
    rotation_exp(axis, turn);
    lin_product(turn, pose, out);
    memcpy(out + 9, pose + 9, 3 * sizeof *out);
}

static void set_origin(const double middle[2], double pose[BOARDFIT_POSE])
{
    for (int k = 0; k < 3; k++)
        pose[9 + k] -= pose[3 * k] * middle[0] + pose[3 * k + 1] * middle[1];
}

/* Least squares from a pose; its cost, WORST if a corner is behind. */
static err_t polish_pose(struct arena *tmp, const struct lens *l, const struct boardfit_corner *c,
                         int n, double pose[BOARDFIT_POSE], double *cost)
{
    static const int lens_of[1] = {0};
    struct boardfit_lens lens = {.lens = *l};
    double camera[1][BOARDFIT_POSE] = {{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}},
           board[1][BOARDFIT_POSE];
    bool fixed = false, moves = true;
    struct boardfit b = {1, 1, 1, n, lens_of, &lens, camera, board, &fixed, &moves, c, 1, {0}};
    memcpy(board[0], pose, sizeof board[0]);
    err_t e = boardfit_run(tmp, &b, KERNEL, STEPS, cost);
    memcpy(pose, board[0], sizeof board[0]);
    return e;
}

err_t boardpose_find(struct arena *tmp, const struct lens *l, const struct boardfit_corner *corner,
                     int n, double pose[BOARDFIT_POSE], double *error)
{
    double middle[2], h[9], other[BOARDFIT_POSE], cost[2] = {WORST, WORST};
    struct boardfit_corner *c;
    const size_t mark = arena_mark(tmp);
    *error = INFINITY;
    board_middle(corner, n, middle);
    if (!find_homography(l, corner, n, middle, h) || !split_homography(h, pose))
        return OK;
    mirror_pose(pose, other);
    set_origin(middle, pose);
    set_origin(middle, other);
    err_t e = arena_alloc(tmp, (size_t)n, sizeof *c, &c);
    for (int i = 0; i < n && !e; i++) {
        c[i] = corner[i];
        c[i].camera = c[i].take = 0;
    }
    if (!e)
        e = polish_pose(tmp, l, c, n, pose, &cost[0]);
    if (!e)
        e = polish_pose(tmp, l, c, n, other, &cost[1]);
    if (cost[1] < cost[0])
        memcpy(pose, other, sizeof other);
    if (!e && fmin(cost[0], cost[1]) < WORST)
        *error = fmin(cost[0], cost[1]) / n;
    arena_reset(tmp, mark);
    return e;
}

size_t boardpose_plan(int n)
{
    return arena_add(arena_need((size_t)n, sizeof(struct boardfit_corner)),
                     boardfit_plan(1, 1, 1, 0));
}
