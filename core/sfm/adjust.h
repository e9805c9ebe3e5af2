/* adjust.h - the least squares of bundle adjustment: cameras, their lenses and points that minimise
 * the robust reprojection error of observations.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_ADJUST_H
#define SFM_ADJUST_H

#include "core/base/types.h"

/* One observation: px right of and below the middle of the sensor. */
struct adjust_observation {
    float u, v, weight; // weight: 1 / expected error in px
    int view;
};

/* Unknowns of a lens: ln focal length, terms, principal point. */
enum { ADJUST_CENTRE = 1 + LENS_TERMS, ADJUST_LENS = ADJUST_CENTRE + 2 };

/* Lens of a physical camera for px of its views. */
struct adjust_lens {
    struct lens lens; // fx = fy; cx, cy: px from the middle; model PINHOLE: these are 0, and terms
                      // are not looked at
    bool free[ADJUST_LENS];    // which unknowns move
    double frame;              // px from the middle to the corners of its photographs; 0: not known
    double prior_focal, prior; // expected ln focal length, and its weight: 1 / deviation
    double prior_reach; // of ln focal length: farther off the expectation is wrong; 0: it is not
};

/* Poses are R row-major and t of X_cam = R X + t; points are homogeneous (x, y, z, w) of length 1
 * with w >= 0, unless noise puts them beyond infinity. Far points need no special case. */
struct adjust {
    int n_views, n_tracks;
    const int *first; // (n_tracks + 1) observations of track i are first[i]..first[i+1]
    const struct adjust_observation *obs; // by track, then view; a track has a view at most once
    int n_lenses;
    struct adjust_lens *lens; // (n_lenses)
    const int *lens_of;       // (n_views) index of its lens
    bool poses_fixed;
    double *pose;     // (n_views, 12)
    bool *placed;     // (n_views) observations of views that are not placed do not count
    double *point;    // (n_tracks, 4)
    bool *in;         // (observations) whether it counts
    const bool *held; // (observations) left out of everything, to be predicted; NULL: none
};

enum { ADJUST_POSE = 12 };

/* Levenberg-Marquardt on the observations that are in, with the Cauchy loss of width `kernel`
 * expected errors. Never raises the cost.
 * err:  ERR_NOMEM (r->tmp, see adjust_plan), ERR_CANCELLED. */
MUST_USE err_t adjust_run(const struct run *r, struct adjust *a, double kernel, int steps);
size_t adjust_plan(int n_views, int n_lenses, int n_tracks);

/* Whether a perspective lens has no ray for the corners of its photographs, or one more than 63
 * degrees from the axis: such lenses are fisheyes. */
bool adjust_too_wide(const struct adjust_lens *l);

/* Unit ray of an observation in its camera; outside the image circle that of a pinhole. */
void adjust_ray(const struct adjust *a, const struct adjust_observation *s, double ray[3]);

/* Focal length of the lens that a view was taken through, px. */
static inline double adjust_focal(const struct adjust *a, int view)
{
    return a->lens[a->lens_of[view]].lens.fx;
}

/* Squared distance of an observation from its point in expected errors; 1e30 where the camera has
 * no pixel for the point. */
double adjust_error(const struct adjust *a, const double point[4],
                    const struct adjust_observation *s);

/* Depth of a point in a view, scene units; below 0 behind it, infinite where w = 0. */
double adjust_depth(const struct adjust *a, int view, const double point[4]);

/* Errors (u, v, in expected errors) of one observation and their derivatives by the twist of the
 * pose (pose.h), the unknowns of the lens, and the three directions across the point. False where
 * the camera has no pixel for the point. */
struct adjust_jacobian {
    double error[2], pose[2][6], lens[2][ADJUST_LENS], point[2][3];
};
bool adjust_jacobian(const struct adjust *a, const double point[4],
                     const struct adjust_observation *s, struct adjust_jacobian *out);

/* Move a pose by a twist, a point along its three directions. */
void adjust_move_pose(double pose[ADJUST_POSE], const double twist[6]);
void adjust_move_point(double point[4], const double by[3]);

/* Put the placed cameras' mean at the origin and the typical point at distance 1. */
void adjust_normalise(struct adjust *a);

#endif
