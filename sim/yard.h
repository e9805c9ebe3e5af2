/* yard.h - a place outdoors: before a house, with fences, trees, garden furniture, sun and sky.
 * Pure computation; any thread. */
#ifndef SIM_YARD_H
#define SIM_YARD_H

#include "sim/builder.h"

/* Fill b->w. */
void yard_build(struct builder *b);

#endif
