/* garden.h - what grows, and what stands outdoors.
 * Pure computation; any thread. */
#ifndef WORLD_GARDEN_H
#define WORLD_GARDEN_H

#include "sim/world/furniture.h"

enum { GARDEN_PIECES = 7 };
extern const struct piece garden_pieces[GARDEN_PIECES];

/* A plant in a pot; a tree. Both as a struct piece makes them. */
void garden_plant(struct builder *b, const struct frame *f, const float half[2], float height);
void garden_tree(struct builder *b, const struct frame *f, const float half[2], float height);

#endif
