/* furniture.h - furniture of rooms, made of basic shapes; every piece differs by the
 * random numbers.
 * Pure computation; any thread. */
#ifndef WORLD_FURNITURE_H
#define WORLD_FURNITURE_H

#include "sim/world/builder.h"

enum { FURNITURE_WALL = 7, FURNITURE_MIDDLE = 5 };
extern const struct piece furniture_wall[FURNITURE_WALL];     // stand with the back to a wall
extern const struct piece furniture_middle[FURNITURE_MIDDLE]; // may be seen from all sides

/* Draw the size of a piece. */
void furniture_size(struct builder *b, const struct piece *p, float half[2], float *height);

void furniture_chair(struct builder *b, const struct frame *f);

/* A table with chairs, as a struct piece makes it. */
void furniture_set(struct builder *b, const struct frame *f, const float half[2], float height);

void furniture_floor_lamp(struct builder *b, const struct frame *f, float radiance);

/* A picture, mirror or clock on a wall: the frame's origin is its middle, y leaves the wall. */
void furniture_picture(struct builder *b, const struct frame *f, const float half[2]);

#endif
