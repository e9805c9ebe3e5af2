/* slant.h - depth maps made finer by a plane through each pixel: windows of the matching cost that
 * lie in the surface instead of facing the camera, at depths that the maps of other views share.
 * Good planes spread from pixel to pixel and are changed at random (PatchMatch stereo, Bleyer,
 * Rhemann and Rother, BMVC 2011; the neighbours' depths as in Schoenberger et al., ECCV 2016).
 * Pure functions; any thread; the result depends on the input alone. */
#ifndef STEREO_SLANT_H
#define STEREO_SLANT_H

#include "core/stereo/match.h"

struct slant_neighbour {
    const struct match_light *light;
    const float *rho, *sure; // (h, w) of `light`: inverse depth, and how sure it is, 0 .. 1
    double h[12];            // transfer_map of the view into it
};

/* One view; the first of the neighbours are the best. */
struct slant {
    const struct match_light *own;
    int n_near; // 1 .. MATCH_NEAR_MAX
    struct slant_neighbour near[MATCH_NEAR_MAX];
    const float *contrast; // (h, w) of match_cost
    float step;            // of inverse depth, about one pixel in a neighbour; above 0
    float *slope;          // (h, w, 2) scratch
    float *cost;           // (h, w) out: matching cost of the planes, 0 .. 1.1
};

/* io: rho (h, w), inverse depths, 0 or more; only better ones are taken. */
void slant_refine(const struct slant *s, float *rho);

#endif
