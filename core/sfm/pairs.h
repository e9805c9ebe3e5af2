/* pairs.h - the matches of every two of many views: which comparisons are worth their time.
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
    int n;                     // pairs of views
    bool bent;                 // views are not those of pinholes
    struct pair *pair;         // (n) see pairs_index
    int *tree;                 // (views) number of the part that a view is connected with
    float *roll;               // (views) radians from x to y, among those that are connected
    int n_isolated, *isolated; // (n) pairs that are compared with stretched views
    struct pairs_room *rooms;  // (workers)
};

/* Index of a pair of views, a < b, among those of n views. */
static inline int pairs_index(int n, int a, int b)
{
    return a * (2 * n - a - 1) / 2 + b - a - 1;
}

/* Memory of *s, of which views.prior is read.
 * err:  ERR_NOMEM. */
MUST_USE err_t pairs_layout(struct pairs *s, struct arena *tmp, const struct views *v, int threads);

/* Corners of all views and the matches of all pairs along epipolar lines. lenses: NULL if the views
 * are those of pinholes; else their bends are found, and focal lengths where there are any.
 * err:  ERR_NOMEM (see pairs_plan), ERR_CANCELLED. */
MUST_USE err_t pairs_run(const struct run *r, const struct views *v, struct division_lenses *lenses,
                         struct pairs *s);

/* After pairs_layout: count what pairs_run takes. */
void pairs_plan(struct plan *p, const struct pairs *s, int n_lenses);

#endif
