/* connectivity.h - which views of a bundle are connected by common observations.
 * Pure computation. */
#ifndef SFM_CONNECTIVITY_H
#define SFM_CONNECTIVITY_H

#include "core/sfm/adjust.h"
#include "core/sfm/viewgraph.h"

enum {
    CONNECTIVITY_VIEW = 10, // inliers of a placed view
    CONNECTIVITY_LINK = 8   // common inliers of two connected views
};

/* Unplace views with too few inliers, views that contradict the points of others, and all but the
 * largest set of views whose distances depend on each other: one that another group of views shares
 * points of one view only with, or only far ones, may have any size beside it, however well both
 * fit.
 * g:    relative poses, for other poses of a view; room for them, zeroed, if there are none
 * gate: expected errors, of what is in
 * err:  ERR_NOMEM (r->tmp, see connectivity_plan), ERR_CANCELLED. */
MUST_USE err_t connectivity_prune(const struct run *r, const struct viewgraph *g, struct adjust *a,
                                  double gate);
size_t connectivity_plan(int n_views);

#endif
