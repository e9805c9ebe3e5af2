/* pairs.h - the matches of the views of a scene: which comparisons are worth their time. Up to
 * PAIR_ALL views are compared all with all; of more, each with those that look most like it, with
 * its neighbours in the order of the views, and with neighbours of its neighbours.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef SFM_PAIRS_H
#define SFM_PAIRS_H

#include "core/base/plan.h"
#include "core/sfm/division.h"
#include "core/sfm/pair.h"

/* Scratch of a worker. */
struct pairs_room {
    float *picture; // (corner_scratch)
    struct pair_workspace pair;
};

struct pairs {
    struct pair_views views;   // k and prior are the caller's
    int n, cap;                // pairs that are compared; room
    bool bent;                 // views are not those of pinholes
    struct pair *pair;         // (cap)
    int *index;                // (views, views) of the pair of two views, or -1
    int *near;                 // (views, some) that look alike
    int *tree;                 // (views) number of the part that a view is connected with
    float *roll;               // (views) radians from x to y, among those that are connected
    bool *isolated;            // (cap) pairs that are compared with stretched views
    struct pairs_room *rooms;  // (workers)
};

/* The pair of views a and b, or NULL if they are not compared. */
static inline struct pair *pairs_of(const struct pairs *s, int a, int b)
{
    const int i = s->index[a * s->views.n + b];
    return i < 0 ? NULL : s->pair + i;
}

/* Memory of *s, of which views.prior is read.
 * err:  ERR_NOMEM. */
MUST_USE err_t pairs_layout(struct pairs *s, struct arena *tmp, const struct views *v, int threads);

/* Corners of all views and the matches of the pairs along epipolar lines. lenses: NULL if the views
 * are those of pinholes; else their bends are found, and focal lengths where there are any.
 * err:  ERR_NOMEM (see pairs_plan), ERR_CANCELLED. */
MUST_USE err_t pairs_run(const struct run *r, const struct views *v, struct division_lenses *lenses,
                         struct pairs *s);

/* After pairs_layout: count what pairs_run takes. */
void pairs_plan(struct plan *p, const struct pairs *s, int n_lenses);

#endif
