/* density.h - the number of Gaussians: order in memory, removal and splitting, with the optimiser's
 * moments. Everything is a permutation or copy of whole splats over a set of parallel arrays.
 * Deterministic. */
#ifndef REFINE_DENSITY_H
#define REFINE_DENSITY_H

#include "core/base/types.h"

/* The optimiser's view of the splats: parameters and Adam moments move together. */
struct density {
    struct gaussians *g;
    float *m1[G_PLANES_MAX], *m2[G_PLANES_MAX]; // (cap) per plane
    float *score;                               // (cap) priority of splitting, >= 0
    /* scratch (cap) */
    uint64_t *key;
    uint32_t *order;
    float *tmp;
};

/* Bytes and memory for everything but g. */
size_t density_plan(int cap, int degree);
MUST_USE err_t density_init(struct density *d, struct arena *a, struct gaussians *g, int degree);

/* Sort the splats along a Morton curve, so that neighbours in space are neighbours in memory.
 * Positions are finite (density_prune). */
void density_sort(struct density *d);

/* Remove splats with opacity below `min_opacity`, or with a number that is not finite. returns:
 * number removed. */
int density_prune(struct density *d, float min_opacity);

/* Split the splats of highest score (> 0), at most `count` and at most what the capacity leaves:
 * each becomes two, half as long apart along its longest axis. Scores are reset. returns: number
 * split. */
int density_split(struct density *d, int count);

#endif
