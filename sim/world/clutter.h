/* clutter.h - small things that stand on furniture: vases, cups, books, balls, plants, lamps.
 * Pure computation; any thread. */
#ifndef WORLD_CLUTTER_H
#define WORLD_CLUTTER_H

#include "sim/world/builder.h"

/* Put small things on a level surface of half[0] x half[1] at the frame's origin. */
void clutter_put(struct builder *b, const struct frame *f, const float half[2]);

/* Put one of them, at most r from the frame's origin. */
void clutter_one(struct builder *b, const struct frame *f, float r);

#endif
