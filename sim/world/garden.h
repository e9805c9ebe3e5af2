/* garden.h - garden furniture, rocks, crates and barrels.
 * Pure computation; any thread. */
#ifndef WORLD_GARDEN_H
#define WORLD_GARDEN_H

#include "sim/world/builder.h"

enum { GARDEN_PIECES = 7 };
extern const struct piece garden_pieces[GARDEN_PIECES];

#endif
