/* render.h - photographs of a world with exact radiance, depth and normals. Ray casting with soft
 * shadows from lamps, windows and sun, indirect light from a grid of probes, and one mirror bounce
 * for gloss.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef WORLD_RENDER_H
#define WORLD_RENDER_H

#include "sim/world/world.h"

struct light_dice;   // sim/world/light.h
struct render_world; // a world prepared for pictures: hierarchy of boxes, probes

struct render_quality {
    int samples; // rays per pixel and axis, 1..8: 1 for training, 4 for reference pictures
    int shadow;  // shadow rays per light and sample, 1..64
    const struct lens *lens; // in the place of the camera's fx, fy, cx, cy: pixels beyond its image
                             // circle are black and infinitely far; NULL: a pinhole
};

/* Prepare w, which must outlive *out.
 * out:  lives in r->keep.
 * err:  ERR_NOMEM (see render_open_plan), ERR_CANCELLED */
MUST_USE err_t render_open(const struct run *r, const struct world *w, struct render_world **out);
void render_open_plan(struct plan *p);

/* A ray that hits nothing has the radiance of the sky and the depth RENDER_FAR. */
#define RENDER_FAR 1000.0f // m

/* The planes of a picture; any pointer may be NULL. */
struct render_maps {
    float *radiance; // (3, h, w) linear, >= 0, finite
    float *depth;    // (h, w) z in the camera at the pixel's centre, m
    float *normal;   // (3, h, w) world, unit, towards the camera; 0 where nothing is hit
};

/* One picture of cam->w x cam->h, both 1..4096. Shadows of large lights are smoothed over 5 x 5 px
 * of one surface with fewer than 4 rays a pixel, over 3 x 3 with fewer than 16; not behind a lens.
 * err:  ERR_ARG (camera, quality), ERR_NOMEM (r->tmp, see render_plan), ERR_CANCELLED */
MUST_USE err_t render_run(const struct run *r, const struct render_world *s,
                          const struct camera *cam, const struct render_quality *q, uint64_t seed,
                          const struct render_maps *out);
void render_plan(struct plan *p, int w, int h);

/* What render_run asks of a camera and a quality; err: ERR_ARG. */
MUST_USE err_t render_check(const struct camera *cam, const struct render_quality *q);

/* Distance along the unit direction d from o to the first surface, m; RENDER_FAR if none. */
float render_ray(const struct render_world *s, const float o[3], const float d[3]);

/* Irradiance at p, m, on a surface with the unit normal n that is not of the world.
 * out:  of R,G,B */
void render_light(const struct render_world *s, const float p[3], const float n[3],
                  const struct light_dice *dice, float out[3]);

#endif
