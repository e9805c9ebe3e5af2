/* solid.h - a solid of a world made ready for rays. Every shape is a unit shape (cube, sphere,
 * frustum of radius 1 and height 2, ring of radius 1, square) seen through an affine map, so that
 * one product takes a ray to it and distances along the ray stay the same.
 * Pure computation; any thread. */
#ifndef WORLD_SOLID_H
#define WORLD_SOLID_H

#include "sim/world/world.h"

struct solid {
    float m[9], b[3]; // to the frame of the unit shape: m x + b
    float k;          // frustum: taper; torus: radius of the tube
    enum world_shape shape;
    int material;
    float det; // m^3, volume of the world over volume of the frame
};

void solid_of(const struct world_solid *w, struct solid *out);

/* Axis-parallel box of the world around it, m. */
void solid_bounds(const struct world_solid *w, float lo[3], float hi[3]);

/* Distance along d, > 0 and < most, to where the ray from o meets the surface first, from
 * outside or inside; `most` if nowhere. o and d belong to the world, d need not be a unit
 * vector. */
float solid_hit(const struct solid *s, const float o[3], const float d[3], float most);

/* Outer normals at p, m, on the surface: unit vectors of the world and of the solid's frame. A
 * WORLD_RECT's is +z. */
void solid_normal(const struct solid *s, const struct world_solid *w, const float p[3],
                  float world[3], float local[3]);

/* Whether p, m, is inside; never inside a WORLD_RECT. */
bool solid_inside(const struct solid *s, const float p[3]);

#endif
