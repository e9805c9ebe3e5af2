/* park.h - an open place under the sky: a monument, tree or pavilion on a lawn with room all around
 * it, bushes and trees near and far, houses with many equal windows, hills at the horizon.
 * Pure computation; any thread. */
#ifndef WORLD_PARK_H
#define WORLD_PARK_H

#include "sim/world/builder.h"

/* Fill b->w with a park. */
void park_build(struct builder *b);

#endif
