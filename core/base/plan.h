/* plan.h - memory of a chain of steps, counted by the code that will allocate it.
 * X_plan(&plan, sizes) counts what X_run(r, ...) takes from r->keep and r->tmp, so that the plan of
 * a chain reads like the chain: kept memory adds up, scratch counts only while it is held.
 */
#ifndef BASE_PLAN_H
#define BASE_PLAN_H

#include "core/base/arena.h"

struct team;

struct plan {
    struct arena keep, tmp;  // both count
    int threads;             // in the pool
    const struct team *team; // as in struct run: a rank needs memory for its own part
};

/* Without a team; the caller sets it. */
struct plan plan_begin(int threads);

/* The request cannot be planned: both peaks become SIZE_MAX. */
void plan_refuse(struct plan *p);

#endif
