/* completion.h - depth where stereo is not sure, by the completion branch of a network.
 * Runs on the pool inside struct run, by all ranks of its team; the result does not depend on their
 * numbers. */
#ifndef RECON_COMPLETION_H
#define RECON_COMPLETION_H

#include "core/base/plan.h"
#include "core/net/graph.h"
#include "core/stereo/sweep.h"

/* d:    from sweep_run and far_run for these views.
 * out:  *share of the pixels of the maps whose depth is the branch's now.
 * err:  ERR_NOMEM (see completion_plan), ERR_CANCELLED, those of complete_run and of the team. Then
 *       *d may be partly changed. */
MUST_USE err_t completion_run(const struct run *r, const struct net *net, const struct views *v,
                              const struct tonemap *tone, struct depthmaps *d, float *share);

/* Count the memory. maps: (n) shapes of the depth maps. */
void completion_plan(struct plan *p, const struct net *net, const struct extent *maps, int n);

#endif
