/* viewgraph.h - cameras from tracks alone: relative poses of all pairs of views, rotations that
 * agree with most of them, then centres and points together.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_VIEWGRAPH_H
#define SFM_VIEWGRAPH_H

#include "core/sfm/adjust.h"
#include "core/sfm/twoview.h"

enum { VIEWGRAPH_VIEWS_MAX = 512 };

struct viewgraph_edge {
    struct twoview pose; // of view b as seen from a, a < b
    int n;               // common tracks
    bool ok;             // enough of them fit, and the rotation agrees with the others
};

struct viewgraph {
    int n_views;
    struct viewgraph_edge *edge; // pairs a < b at b (b - 1) / 2 + a
};

static inline int viewgraph_edges(int n_views)
{
    return n_views * (n_views - 1) / 2;
}

/* Relative poses of all pairs, for a->focal.
 * out:  g->edge, room for viewgraph_edges(a->n_views)
 * err:  ERR_NOMEM (see viewgraph_plan), ERR_CANCELLED. */
MUST_USE err_t viewgraph_pairs(const struct run *r, const struct adjust *a, struct viewgraph *g);

/* Rotations of the largest connected set of views; the others are not placed, all centres are 0.
 * Edges that contradict the others lose `ok`.
 * out:  *n_placed, number of views that are placed, 0 if no pair is known
 * err:  ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t viewgraph_rotations(const struct run *r, struct viewgraph *g, struct adjust *a,
                                   int *n_placed);

/* in <- observations that agree with most of the other observations of their track.
 * err:  ERR_CANCELLED. */
MUST_USE err_t viewgraph_vote(const struct run *r, const struct viewgraph *g, struct adjust *a);

/* Of the placed views only those stay that see the most in common, with parallax: up to `most`. The
 * equations for centres have solutions in which a group of views that shares only far points with
 * the others moves as it likes; these views are no such groups. */
void viewgraph_core(const struct viewgraph *g, int most, struct adjust *a);

/* Centres of the placed views from their rotations and the observations that are in; all 0 if no
 * pair has parallax or the equations have no solution.
 * err:  ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t viewgraph_centres(const struct run *r, const struct viewgraph *g, struct adjust *a,
                                 bool *found);

size_t viewgraph_plan(int n_views, int n_obs); // r->tmp, of the one that takes most

#endif
