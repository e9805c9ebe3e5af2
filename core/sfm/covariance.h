/* covariance.h - how well adjusted cameras and lenses are known: the inverse of the normal
 * equations. Photographs say nothing of where the world's origin, axes and unit are, so covariances
 * of poses are those of a world whose cameras on the whole do not turn, shift or spread: their mean
 * turn is 0, so is the mean shift of their centres, and the shift away from their middle, weighted
 * by the distance from it. No camera is special.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_COVARIANCE_H
#define SFM_COVARIANCE_H

#include "core/sfm/adjust.h"

/* Covariance of a twist (pose.h), row-major: rotation in rad, then the centre's shift along the
 * camera's axes. */
enum { COVARIANCE_POSE = 36, COVARIANCE_GAUGE = 7 };

/* Of the present state, by the errors of the observations that are in (sandwich.h).
 * lens: (n_lenses, ADJUST_LENS) standard errors of the unknowns: 0 where one is fixed
 * pose: (n_views, COVARIANCE_POSE), in the world of `a`; 0 where a view is not placed; NULL: not
 *       asked for
 *       Both are infinite where nothing determines them.
 * err:  ERR_NOMEM (r->tmp, see covariance_plan), ERR_CANCELLED. */
MUST_USE err_t covariance_run(const struct run *r, struct adjust *a, double *lens, double *pose);
size_t covariance_plan(int n_views, int n_lenses, int n_tracks, int n_obs);

/* Standard errors of a pose: the roots of the traces of rotation, rad, and shift. */
void covariance_deviations(const double pose[COVARIANCE_POSE], double out[2]);

/* ---- for other systems of equations ---- */

/* What is fixed of n cameras: their mean turn, mean shift, and their unit where it is free. */
struct covariance_gauge {
    int n, counted;
    const double *pose;       // (n, ADJUST_POSE)
    const bool *in;           // (n) whether a camera counts; NULL: all do
    bool scales;              // the unit is free
    double middle[3], square; // of their centres, and the sum of squared distances from it
    double weight[2];         // of turns and of lengths
};

struct covariance_gauge covariance_find_gauge(const double *pose, const bool *in, int n,
                                              bool scales);

/* Rows of a camera: what is fixed, and how a motion of the world that changes only that
 * moves it. */
void covariance_gauge_rows(const struct covariance_gauge *g, int camera,
                           double fixed[6][COVARIANCE_GAUGE], double moves[6][COVARIANCE_GAUGE]);

/* Fix it in equations whose first unknowns are the twists of the cameras.
 * h: (n, n) lower triangle */
void covariance_fix_gauge(struct covariance_gauge *g, double *h, int n);

/* Variance of unknown k. step: (n), its row of the inverse */
double covariance_of_unknown(const double *factor, int n, int k, double *step);

/* The covariance of a camera, in expected errors, from the factor (lin_cholesky) of these. step:
 * (n), scratch */
void covariance_of_pose(const struct covariance_gauge *g, const double *factor, int n, int camera,
                        double *step, double out[COVARIANCE_POSE]);

#endif
