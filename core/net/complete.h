/* complete.h - the completion branch: a U-Net that corrects a depth map of one view and fills its
 * holes, guided by the photograph (core/net/README.md 2.14). Only of a network with
 * net_dims.complete; no part of net_run.
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_COMPLETE_H
#define NET_COMPLETE_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* A map of one view. */
struct complete_in {
    int h, w;        // px, any
    const float *px; // (h, w, NET_COMPLETE_IN), within +-FINITE_MAX
};

/* Count the memory of complete_run; of the map its size alone is read. */
void complete_plan(struct plan *p, const struct net *net, const struct complete_in *in);

/* out:  (h, w, NET_COMPLETE_OUT); what the numbers mean, here and in the input, says
 *       core/stereo/fill.h.
 * err:  ERR_NOMEM (r->tmp, see complete_plan), ERR_CANCELLED, ERR_FORMAT (the output exceeds the
 *       bound of finite.h). */
MUST_USE err_t complete_run(const struct run *r, const struct net *net,
                            const struct complete_in *in, float *out);

#endif
