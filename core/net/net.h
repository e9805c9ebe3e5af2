/* net.h - the network: weights bound to the structs that use them, and the graph itself
 * (core/net/README.md 2). Files follow the paper's figure: backbone, camera, dpt, appearance,
 * gausshead, metanet; net_run in net.c calls them one after the other.
 * Immutable after net_bind, free to share. Pure computation on the pool inside struct run, by all
 * ranks of its team (core/net/README.md 2.13). */
#ifndef NET_NET_H
#define NET_NET_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* Bind every tensor. floats: NET_FLOAT_ bits wanted.
 * out:  points into m, which must outlive it.
 * err:  ERR_FORMAT (a tensor is missing). */
MUST_USE err_t net_bind(const struct model *m, unsigned floats, struct net *out);

/* Count the memory of a forward pass. */
void net_plan(struct plan *p, const struct net *net, int n_views, int size);

/* The forward pass. v->size is a multiple of 14; without the appearance branch exposures are
 * ignored.
 * out:  arrays in r->keep; features, points and confidence are NULL without a Gaussian head.
 * err:  ERR_ARG (fewer than 2 views, size, more than INT_MAX pixels), ERR_NOMEM (see net_plan),
 *       ERR_CANCELLED, ERR_FORMAT (a stage's output exceeds the bound of finite.h),
 *       ERR_UNSUPPORTED (a tap in a team), those of the team. On error *out is zeroed. */
MUST_USE err_t net_run(const struct run *r, const struct net *net, const struct views *v,
                       struct prediction *out);

#endif
