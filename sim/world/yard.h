/* yard.h - an outdoor place: before a house, with fences, trees, garden furniture, sun and sky.
 * Pure computation; any thread. */
#ifndef WORLD_YARD_H
#define WORLD_YARD_H

#include "sim/world/builder.h"

/* Fill b->w with a yard. */
void yard_build(struct builder *b);

#endif
