/* room.h - rooms: furniture, lamps and daylight, and the box for cameras.
 * Pure computation; any thread. */
#ifndef WORLD_ROOM_H
#define WORLD_ROOM_H

#include "sim/world/builder.h"

/* Fill b->w, whose kind is set, with a room. */
void room_build(struct builder *b);

/* The distant view through windows or over a fence: ground at z = -depth, houses and trees,
 * `count` of them between near and far m from the origin. */
struct room_view {
    float depth, near, far; // m
    int count;
};
void room_outside(struct builder *b, const struct frame *root, const struct room_view *v);

/* Sky and sun: radiance of the sky, irradiance of the sun over that of the whole sky (0: none),
 * direction of the sun in the root's frame, rad. */
struct room_sky {
    float radiance, sun, azimuth, height;
};
void room_light(struct builder *b, const struct frame *root, const struct room_sky *s);

/* A box of the root's frame in the frame of the world. */
void room_box(const struct frame *root, const float box[2][3], float lo[3], float hi[3]);

#endif
