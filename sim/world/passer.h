/* passer.h - somebody who walks through a place that is photographed: a textured ellipsoid, of a
 * person's size where there is room, that stands before everything else in the picture and in
 * another place in each photograph. It is lit like the place, which it neither shades nor lights:
 * pixels that it does not touch stay what they were.
 * Pure computation on the pool; the result does not depend on the number of threads. */
#ifndef WORLD_PASSER_H
#define WORLD_PASSER_H

#include "sim/world/render.h"

#define PASSER_SHARE_MIN 0.002 // of the pixels of a photograph
#define PASSER_SHARE_MAX 0.3

struct passer {
    uint64_t seed;
    float share; // of the pixels that it covers, PASSER_SHARE_MIN..PASSER_SHARE_MAX
};

/* A photograph that it is in. */
struct passer_shot {
    const struct camera *cam;
    const struct render_quality *quality;
    uint64_t number; // places in photographs of different numbers differ
};

/* Paint it over a picture.
 * radiance: (3, h, w) in and out, of cam->w x cam->h.
 * mask:     out, (h, w): 0 where the picture has changed, 255 elsewhere.
 * err:      ERR_ARG (share, quality), ERR_CANCELLED */
MUST_USE err_t passer_draw(const struct run *r, const struct render_world *s,
                           const struct passer *p, const struct passer_shot *shot, float *radiance,
                           uint8_t *mask);

#endif
