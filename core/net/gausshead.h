/* gausshead.h - the Gaussian head, one view at a time: a raw Gaussian for every pixel from the
 * trunk's map and from the fused appearance, upsampled to full resolution by the picture's own fine
 * structure (core/net/README.md 2.9).
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_GAUSSHEAD_H
#define NET_GAUSSHEAD_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* Count the memory of gausshead_run. */
void gausshead_plan(struct plan *p, const struct net *net, int n_views, int size);

/* Inputs of the head. */
struct gausshead_in {
    const struct views *views;
    const struct tokens *tokens;
    const struct irradiance *irr; // NULL without the appearance branch
};

/* In a team a rank computes the views that are dealt to it, and what all have computed is gathered.
 * out:  features and confidence of io in r->keep, and n. summary: (n_views, 2 hdr) for metanet_run,
 *       not written without the appearance branch; then the sensitivities are 0.
 * err:  ERR_NOMEM (see gausshead_plan), ERR_FORMAT (metanet_init), ERR_CANCELLED. */
MUST_USE err_t gausshead_run(const struct run *r, const struct net *net,
                             const struct gausshead_in *in, struct prediction *io, float *summary);

#endif
