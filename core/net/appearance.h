/* appearance.h - one appearance per patch from photographs of different exposures: tokens of the
 * pictures, modulated by their exposures, are averaged over all views by the geometric attention of
 * the backbone (core/net/README.md 2.6 to 2.8). In a team a rank fuses the views that are dealt to
 * it, from the values of all.
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_APPEARANCE_H
#define NET_APPEARANCE_H

#include "core/base/plan.h"
#include "core/net/graph.h"
#include "core/net/layer.h"

/* Count the memory of appearance_run. */
void appearance_plan(struct plan *p, const struct net *net, int n_views, int size);

/* v->log2t and v->mid_log2t give the exposures, t->q and t->k the attention.
 * out:  arrays in r->keep.
 * err:  ERR_NOMEM (see appearance_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t appearance_run(const struct run *r, const struct net *net, const struct views *v,
                              const struct tokens *t, struct irradiance *out);

/* Exposure code of a picture `stops` (log2) longer than the middle of the set.
 * n:    even.
 * out:  (n) sines and cosines in turn. */
void appearance_code(float stops, int n, float *out);

/* Log2 range of the exposures, at least half a stop (core/photo/README.md 1.2). */
float appearance_range(const struct views *v);

/* A picture as layer_conv_run takes it, 3 channels. */
struct appearance_picture {
    const float *planes; // (3, size, size) of prep_to_float
    int size;
};
layer_fetch_fn appearance_fetch;

#endif
