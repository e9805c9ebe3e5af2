/* resect.h - place one more view from points that other views have placed.
 * Pure functions, random draws from a fixed seed; any thread. */
#ifndef SFM_RESECT_H
#define SFM_RESECT_H

#include "core/sfm/adjust.h"
#include "core/sfm/viewgraph.h"

/* Pose of a view that is not placed, from the points of its tracks. The rotation comes from a
 * placed neighbour's edge, also from a rejected one, or from the present pose; the
 * translation from pairs of points; both are polished on the points within the gate (expected
 * errors). Returns the number of these, 0 if they are less than half of all points, and less than
 * a quarter or no more than twice as many as another pose explains of the rest: matches of what
 * looks alike are many in some scenes, but agree with no one pose. The pose is the old one then. */
int resect_view(const struct viewgraph *g, struct adjust *a, int view, double gate);

/* Of the points of a placed view's tracks that it does not see where they are, how many one other
 * pose explains: few if they are mere wrong matches, as many as it has another place to be. The
 * rotation comes from placed neighbours' edges. The pose stays. */
int resect_other(const struct viewgraph *g, struct adjust *a, int view, double gate);

/* Like resect_view, but half of the points is the least, for a view whose lens nothing is known of:
 * several fields of view with and without distortion are tried, and focal length and first term
 * move with the pose. On success the lens of the view is the one that fits. */
int resect_lens(const struct viewgraph *g, struct adjust *a, int view, double gate);

#endif
