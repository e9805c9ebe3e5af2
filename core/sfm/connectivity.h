/* connectivity.h - which views of a bundle are tied to the others by what was seen.
 * Pure function; any thread. */
#ifndef SFM_CONNECTIVITY_H
#define SFM_CONNECTIVITY_H

#include "core/sfm/adjust.h"

enum {
    CONNECTIVITY_VIEWS_MAX = 64,
    CONNECTIVITY_VIEW = 10, // inliers of a placed view
    CONNECTIVITY_LINK = 8   // common inliers of two views that are tied
};

/* Take back (placed) views that have too few inliers, views that do not agree with the points that
 * others place, views whose distance only hangs on one other view, and all but the largest set of
 * views that are tied. */
void connectivity_prune(struct adjust *a);

#endif
