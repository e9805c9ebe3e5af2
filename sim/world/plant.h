/* plant.h - plants: in pots, and trees.
 * Pure computation; any thread. */
#ifndef WORLD_PLANT_H
#define WORLD_PLANT_H

#include "sim/world/builder.h"

/* A plant in a pot; a tree. Both as a struct piece makes them. */
void plant_pot(struct builder *b, const struct frame *f, const float half[2], float height);
void plant_tree(struct builder *b, const struct frame *f, const float half[2], float height);

#endif
