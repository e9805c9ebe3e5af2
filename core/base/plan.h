/* plan.h - memory of a chain of steps, counted by the code that will allocate it.
 * X_plan(&plan, sizes) counts what X_run(r, ...) takes from r->keep and r->tmp, so that the plan of
 * a chain reads as the chain does: what stays adds up, what is given back counts while it is held.
 */
#ifndef BASE_PLAN_H
#define BASE_PLAN_H

#include "core/base/arena.h"

struct plan {
    struct arena keep, tmp; // both count
    int threads;            // of the pool
};

struct plan plan_begin(int threads);

/* What is asked cannot be done: both peaks become SIZE_MAX. */
void plan_refuse(struct plan *p);

#endif
