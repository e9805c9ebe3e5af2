/* sandwich.h - what the errors of observations that are near each other have in common. Matches of
 * neighbouring points, and of one point in several takes, are wrong together. So variances are made
 * from what the errors of whole parts of a picture did to the unknowns, instead of an error that is
 * expected of each observation alone: H^-1 (sum_c g_c g_c^T) H^-1, with g_c the gradient of part c
 * (Liang and Zeger, "Longitudinal data analysis using generalized linear models", 1986; the factor
 * for few parts: Cameron and Miller, "A practitioner's guide to cluster-robust inference", 2015).
 * Pure computation. */
#ifndef SFM_SANDWICH_H
#define SFM_SANDWICH_H

#include "core/sfm/adjust_inner.h"

struct sandwich {
    const struct normal *m;
    int n;          // parts, and unknowns of lenses, of which something was expected
    double alone;   // variance of an error, if it shared nothing; infinite: too few observations
    double factor;  // of covariances
    double *slope;  // (observations, 6 + ADJUST_LENS) of the cost, points eliminated
    int *part;      // (n_tracks) of the picture that a track was first seen in; -1: none
    double *effect; // (n)
};

/* Of the observations that are in, at the present state.
 * err:  ERR_NOMEM (m->r->tmp, see sandwich_plan). */
MUST_USE err_t sandwich_begin(const struct normal *m, struct sandwich *out);
size_t sandwich_plan(int n_views, int n_lenses, int n_tracks, int n_obs);

/* Variance of an unknown. Few parts tell it badly: less than `alone` times what stands in H^-1 is
 * chance.
 * row: (m->n) that of the unknown in H^-1 */
double sandwich_variance(struct sandwich *s, const double *row);

#endif
