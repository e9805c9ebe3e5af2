/* bvh.h - a hierarchy of boxes around the solids of a world, to find the first solid that a ray
 * meets, or any. Pure computation; any thread. */
#ifndef WORLD_BVH_H
#define WORLD_BVH_H

#include "core/base/plan.h"
#include "sim/world/solid.h"

struct bvh_node;

struct bvh {
    int n; // solids
    const struct world *w;
    struct solid *solids;   // (n) as in w
    struct bvh_node *nodes; // the root is the first
};

/* Build over the solids of w, which must outlive *out.
 * out:  arrays live in `keep`
 * err:  ERR_NOMEM (see bvh_plan) */
MUST_USE err_t bvh_build(struct arena *keep, const struct world *w, struct bvh *out);
void bvh_plan(struct plan *p);

/* The first solid along d from o nearer than `most`, or -1. *t: its distance in lengths of d, else
 * `most`. */
int bvh_first(const struct bvh *b, const float o[3], const float d[3], float most, float *t);

/* Any solid except `skip` (-1: none) between o and o + most d, or -1. `guess`: a solid to try
 * first, or -1. */
int bvh_any(const struct bvh *b, const float o[3], const float d[3], float most,
            const int skip_guess[2]);

#endif
