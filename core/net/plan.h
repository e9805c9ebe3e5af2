/* plan.h - how much of an arena a stage needs: buffers that are held until its end, and steps that
 * take and give back something on top of them. Sums stop at SIZE_MAX. */
#ifndef NET_PLAN_H
#define NET_PLAN_H

#include "core/net/layer.h"

struct plan {
    size_t held, peak; // bytes, start at 0
};

/* A step that takes `bytes` and gives them back. */
static inline void plan_step(struct plan *p, size_t bytes)
{
    size_t top = arena_add(p->held, bytes);
    p->peak = top > p->peak ? top : p->peak;
}

/* A buffer of n elements that stays. */
static inline void plan_hold(struct plan *p, size_t n, size_t elem)
{
    p->held = arena_add(p->held, arena_need(n, elem));
    plan_step(p, 0);
}

/* Bytes of layer_workspaces_init, hence of layer_run too. */
static inline size_t plan_rooms(int k, int threads)
{
    size_t need = arena_need((size_t)threads, sizeof(struct layer_workspace));
    for (int i = 0; i < threads; i++)
        need = arena_add(need, layer_workspace_need(k));
    return need;
}

#endif
