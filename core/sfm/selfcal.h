/* selfcal.h - the lenses of physical cameras from photographs of a still scene: which distortion
 * terms each needs, and their values. Each model of a ladder (none, k1, k1 k2, k1 k2 p1 p2; then
 * the fisheye with 1, 2 and 4 terms, where the lens is that wide) is fitted without some of the
 * observations, and kept only where it predicts these clearly better than the model before and a
 * term that is new is 4 standard errors from 0; for the first term it is enough that it moves the
 * corners by half a pixel and predictions are not worse by a standard error. The principal point,
 * where it is asked for, comes after k1 k2, with k1 at least; it is kept where it is 4 standard
 * errors from the middle and predictions become no worse.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_SELFCAL_H
#define SFM_SELFCAL_H

#include "core/sfm/adjust.h"

enum { SELFCAL_HELD_LEAST = 40 }; // observations that must be left out to judge a lens

enum selfcal_stop {
    SELFCAL_ENOUGH, // the next model predicted no better
    SELFCAL_FEW,    // too few points in three views to judge it
    SELFCAL_FULL,   // the ladder has no further model
};

/* How the model of one lens was chosen; its values are in struct adjust. */
struct selfcal_lens {
    enum selfcal_stop stop;
    int held;                      // observations that were left out
    double error_before;           // mean squared error of these, in expected errors, each at most
    double error;                  // that of an inlier: without distortion, and with the model kept
    double deviation[ADJUST_LENS]; // standard errors of ln focal length, terms and principal point
                                   // (px); 0: fixed
};

/* Number of terms that a lens has, as far as they are not 0 or belong to its model. */
int selfcal_terms(const struct lens *l);

struct selfcal_config {
    double gate, scale; // expected errors of an inlier; of the expected errors
    bool principal;     // look for principal points, too
};

/* Choose and fit the models from the present state, in which the views that matter are placed.
 * out:  (a->n_lenses); a: cameras, points and lenses adjusted, the terms of the models free
 * err:  ERR_NOMEM (see selfcal_plan), ERR_CANCELLED. */
MUST_USE err_t selfcal_run(const struct run *r, struct adjust *a, const struct selfcal_config *cfg,
                           struct selfcal_lens *out);
size_t selfcal_plan(int n_views, int n_lenses, int n_tracks, int n_obs);

#endif
