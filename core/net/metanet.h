/* metanet.h - the hypernetwork that predicts the tone curve: a summary of each view, pooled over
 * views, becomes the parameters of the curve (core/net/README.md 2.10).
 * The inputs of its first layer are, per pixel, the guide map, the raw Gaussians and an exposure
 * code that is the same for the whole view. The three parts are computed separately, so that they
 * need not be in memory at once; the code becomes a bias.
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_METANET_H
#define NET_METANET_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* The first layer, split by inputs. */
struct metanet {
    const struct net *net;
    struct weight guide, raw; // panels in r->tmp
    float *code;              // (panels, hdr, PANEL) sums over the kernel
};

/* Count what metanet_init takes and does not give back, and what the calls for a view take. */
void metanet_init_plan(struct plan *p, const struct net *net);
void metanet_view_plan(struct plan *p, const struct net *net, int size);

/* out:  points into net; panels in r->tmp.
 * err:  ERR_NOMEM (see metanet_init_plan), ERR_FORMAT (rotated weights that cannot be split). */
MUST_USE err_t metanet_init(const struct run *r, const struct net *net, struct metanet *out);

/* One view in progress. */
struct metanet_view {
    const struct metanet *m;
    int view, n_views, size;
    float *sums; // (grid, grid, hdr) of the first layer
};

/* sums = bias + contributions of the guide map and the exposure.
 * guide: (size, size, hdr). code: (hdr) of appearance_code.
 * err:  ERR_NOMEM (see metanet_view_plan), ERR_CANCELLED. */
MUST_USE err_t metanet_guide(const struct run *r, const struct metanet_view *v, const float *guide,
                             const float *code);

/* Add the raw Gaussians of this view and finish it. Overwrites the sums.
 * summary: (2 hdr) mean and maximum over the view.
 * err:  as above. */
MUST_USE err_t metanet_summarise(const struct run *r, const struct metanet_view *v,
                                 const struct prediction *p, float *summary);

/* summary: (n_views, 2 hdr).
 * out:  theta and tone of io; parameters that no image needs are 0 unless r->tap is set.
 * err:  ERR_NOMEM (r->tmp, see metanet_plan), ERR_CANCELLED. */
void metanet_plan(struct plan *p, const struct net *net);
MUST_USE err_t metanet_run(const struct run *r, const struct net *net, const float *summary,
                           int n_views, float mid_log2t, struct prediction *io);

/* Plane of raw channel c (0..87, core/net/README.md 2.9) of one view, (size, size). */
float *metanet_plane(const struct prediction *p, int c, int view, int size);

#endif
