/* connectivity.h - which views of a bundle are connected by common observations.
 * Pure computation. */
#ifndef SFM_CONNECTIVITY_H
#define SFM_CONNECTIVITY_H

#include "core/sfm/adjust.h"

enum {
    CONNECTIVITY_VIEW = 10, // inliers of a placed view
    CONNECTIVITY_LINK = 8   // common inliers of two connected views
};

/* Unplace views with too few inliers, views that contradict the points of others, views whose
 * distance depends on only one other view, and all but the largest set of connected views.
 * err:  ERR_NOMEM (r->tmp, see connectivity_plan), ERR_CANCELLED. */
MUST_USE err_t connectivity_prune(const struct run *r, struct adjust *a);
size_t connectivity_plan(int n_views);

#endif
