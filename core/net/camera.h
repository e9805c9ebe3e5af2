/* camera.h - cameras of the views from their camera tokens: four rounds of refinement by a small
 * transformer across the views (core/net/README.md 2.4). Activations are floats in every precision.
 * In a team every rank computes all cameras, from the gathered camera tokens.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_CAMERA_H
#define NET_CAMERA_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* Count the memory of camera_run. */
void camera_plan(struct plan *p, const struct net *net, int n_views);

/* out:  n_views, size, pose and cams, in r->keep; depth is NULL.
 * err:  ERR_NOMEM (see camera_plan), ERR_CANCELLED. */
MUST_USE err_t camera_run(const struct run *r, const struct net *net, const struct tokens *t,
                          int size, struct geometry *out);

/* The camera of a pose after activation, for size x size. Where the formulas give none, the nearest
 * valid value replaces it: no rotation for a quaternion of length 0 or not finite, 0 for a
 * translation that is not finite, and a field of view counts as at most pi - 1e-3 (hazards 14, 15
 * of core/net/README.md 5).
 * thread: any. */
void camera_decode(const float pose[NET_POSE], int size, struct camera *out);

#endif
