/* yard.h - an outdoor place: before a house, with fences, trees, garden furniture, sun and sky.
 * Pure computation; any thread. */
#ifndef WORLD_YARD_H
#define WORLD_YARD_H

#include "sim/world/builder.h"

/* The front of a house with windows, dark or lit, along x of the frame within `wide` m to both
 * sides; y leaves it. */
void yard_front(struct builder *b, const struct frame *f, float wide, bool night);

/* Fill b->w with a yard. */
void yard_build(struct builder *b);

#endif
