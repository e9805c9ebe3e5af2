/* part.h - which part of a photograph a step sees. Where photographs are large, random parts of
 * several of them in a step teach as much as the whole of one and cost less: splats that were drawn
 * once need no second look so soon. Pure computation. thread: any. */
#ifndef REFINE_PART_H
#define REFINE_PART_H

#include "core/base/types.h"

/* Photographs with a longer edge of PART_FROM px are seen in parts, PART_DRAWS a step, of about a
 * PART_SIDES-th of each side (core/refine/README.md 2). */
enum { PART_FROM = 1024, PART_SIDES = 3, PART_DRAWS = 4 };

/* A camera that sees the picture from (x, y) px of its photograph on. */
struct part {
    struct camera cam;
    int x, y;
};

struct part part_whole(const struct camera *cam);

/* unit: px, sides and corners of the part are multiples of it; rng: SplitMix. */
struct part part_random(const struct camera *cam, int unit, uint64_t *rng);

#endif
