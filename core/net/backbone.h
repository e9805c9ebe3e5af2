/* backbone.h - from views to tokens: DINOv2 on each view, then pairs of frame and global blocks
 * (core/net/README.md 2.1 to 2.3).
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_BACKBONE_H
#define NET_BACKBONE_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* Count the memory of backbone_run. */
void backbone_plan(struct plan *p, const struct net *net, int n_views, int size);

/* out:  arrays in r->keep, which may be r->tmp.
 * err:  ERR_NOMEM (see backbone_plan), ERR_CANCELLED. */
MUST_USE err_t backbone_run(const struct run *r, const struct net *net, const struct views *v,
                            struct tokens *out);

/* The position embedding of DINOv2 for a grid of n x n patches: bicubic with antialias, a = -0.5,
 * corners not aligned (core/net/README.md 2.1, point 3).
 * grid: (NET_POS_GRID, NET_POS_GRID, width).
 * out:  (n, n, width). */
void backbone_positions(const float *grid, int width, int n, float *out);

/* Angles of rotary embedding (core/net/README.md 2.3) for a view of n x n patches and heads of
 * `head` channels. bf16: rounded as in the released training (core/net/README.md 1.2).
 * out:  cosine, sine (NET_SPECIAL + n n, head / 2), rows then columns; 1 and 0 for the special
 *       tokens. */
void backbone_angles(int n, int head, bool bf16, float *cosine, float *sine);

#endif
