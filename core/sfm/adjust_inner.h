/* adjust_inner.h - the normal equations of adjust.c, for it and what is made from them. */
#ifndef SFM_ADJUST_INNER_H
#define SFM_ADJUST_INNER_H

#include "core/sfm/adjust.h"

enum { ADJUST_GROUPS = 8 }; // of tracks, at most

/* A lens that a track was seen through: W of its free unknowns, and W H^-1. */
struct lens_block {
    int lens;
    double w[3 * ADJUST_LENS], wh[3 * ADJUST_LENS];
};

struct normal {
    const struct run *r;
    const struct adjust *a;
    double kernel2, damping;
    int n_groups;
    int n;                    // unknowns of cameras: 6 V, then the free ones of the lenses
    int *at;                  // (n_lenses + 1) first unknown of each lens
    double *sum;              // (groups, n, n) lower triangles
    double *rhs;              // (groups, n)
    double *cross;            // (groups, V, 18 + 18) W and W H^-1 of the observations of a track
    struct lens_block *block; // (groups, V)
    double *step;             // (n)
    double *trial;            // (n_tracks, 4)
    double cost[ADJUST_GROUPS];
};

/* The state before a step. */
struct backup {
    double *pose;
    struct adjust_lens *lens;
};

/* The unknowns of a, and room for their equations, in r->tmp; no damping.
 * err:  ERR_NOMEM (see adjust_plan). */
MUST_USE err_t adjust_begin_system(const struct run *r, struct adjust *a, double kernel,
                                   struct normal *m, struct backup *b);

/* The equations of cameras and lenses at the present damping, points eliminated: m->sum (lower
 * triangle) and m->rhs.
 * err:  ERR_CANCELLED. */
MUST_USE err_t adjust_sum_system(struct normal *m);

/* Weight of what is expected of an unknown of a lens at its present value: 1 / deviation. */
double adjust_prior_weight(const struct adjust_lens *l, int unknown);

#endif
