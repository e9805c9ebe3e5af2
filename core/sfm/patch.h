/* patch.h - the same small piece of surface in two pictures, to a fraction of a pixel: inverse
 * compositional alignment (Baker & Matthews, "Lucas-Kanade 20 years on", 2004) by an affine map,
 * invariant to gain and offset of the grey values.
 * Pure functions; any thread. */
#ifndef SFM_PATCH_H
#define SFM_PATCH_H

#include "core/sfm/corner.h"

#include <stdbool.h>

enum { PATCH_REACH = 7, PATCH_EDGE = 2 * PATCH_REACH + 1, PATCH_AREA = PATCH_EDGE * PATCH_EDGE };

/* The template: px around a point of a level. */
struct patch {
    float weight[PATCH_AREA];    // sum 1
    float light[PATCH_AREA];     // mean 0, variance 1
    float slope[PATCH_AREA][6];  // of light by the parameters, without gain and offset
    double factor[36], small[4]; // Cholesky factors of the normal equations: affine; shift only
};

/* Position of a patch in a picture: pixel (i, j) of the patch, counted from its middle, lies at
 * (u + m0 i + m1 j, v + m2 i + m3 j) px of a level. */
struct patch_position {
    float u, v, m[4];
    float sigma;       // px of the level, expected error of u and v
    float correlation; // correlation of the grey values, at most 1
};

/* Cut the patch around (u, v) px of `l`; pixel centres are at + 0.5.
 * False if it has too little information: border, saturation, a straight edge. */
bool patch_make(const struct corner_level *l, float u, float v, struct patch *out);

/* Refine *at, the estimated position of the patch on `l`. False if it is not found there. */
bool patch_find(const struct patch *p, const struct corner_level *l, struct patch_position *at);

#endif
