/* shade.h - what a physical camera does to light before its response: vignetting, and its gain and
 * balance of colours beside the other cameras of a rig. Radiance is multiplied by
 *   2^(gain of the colour + v2 r^2 + v4 r^4 + v6 r^6),
 * r the distance from the principal point over half the diagonal of the photograph as taken. The
 * exponent instead of the usual 1 + v2 r^2 + ... keeps it above 0, and fits are linear.
 * Pure functions; any thread, shade_apply on the pool. */
#ifndef PHOTO_SHADE_H
#define PHOTO_SHADE_H

#include "core/base/lens.h"
#include "core/base/types.h"

enum { SHADE_TERMS = 3, SHADE_CELLS = 32, SHADE_NODES = (SHADE_CELLS + 1) * (SHADE_CELLS + 1) };

/* Vignetting, gain and white balance of a physical camera. */
struct shade_model {
    double term[SHADE_TERMS]; // stops: v2 v4 v6
    double gain[3];           // stops, R,G,B
};

/* The same over the pixels of a view, whatever its size. */
struct shade {
    float r2[SHADE_NODES]; // r^2 at equal steps from edge to edge, row by row
    struct shade_model model;
};

/* Fill out->r2 for views that a pinhole sees in photographs of w x h px through a lens; NULL: the
 * views are the photographs, whose principal point is the camera's. */
void shade_map(const struct lens *lens, int w, int h, const struct camera *view, struct shade *out);

/* r^2 at x across and y down, 0..1. */
float shade_r2(const struct shade *s, float x, float y);

/* Stops of each colour at r^2. */
void shade_stops(const struct shade_model *m, float r2, float out[3]);

/* Multiply radiance, (3, h, w) of the whole view, by the factor at each pixel's centre.
 * pool: NULL = single thread. */
void shade_apply(struct pool *pool, const struct shade *s, int w, int h, float *radiance);

/* Largest deviation from 1 in a photograph, stops. */
double shade_most(const struct shade_model *m);

#endif
