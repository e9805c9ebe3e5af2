/* depth.h - the depth head: a depth for every pixel of every view, one view at a time, and the
 * points that follow from it (core/net/README.md 2.5 and 2.11). In a team the depths are gathered.
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_DEPTH_H
#define NET_DEPTH_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* Count the memory of depth_run. */
void depth_plan(struct plan *p, const struct net *net, int n_views, int size);

/* Depths are exponents of the head's outputs, which are first clamped to +-80: then they are finite
 * and > 0 for any outputs, and no depth of a real scene comes near the bound (core/net/README.md 5,
 * hazard 12).
 * out:  io->depth, in r->keep; n_views and size of io must be set.
 * err:  ERR_NOMEM (see depth_plan), ERR_CANCELLED. */
MUST_USE err_t depth_run(const struct run *r, const struct net *net, const struct tokens *t,
                         struct geometry *io);

/* World points of a view. Pixel (i, j) lies at u = i, v = j, not at its centre as elsewhere: the
 * network was trained with it (core/net/README.md 2.11).
 * points:  (size, size, 3). */
void depth_unproject(const struct geometry *g, int view, float *points);

#endif
