/* room.h - rooms: where things stand, what lights them, and where a camera may stand.
 * Pure computation; any thread. */
#ifndef WORLD_ROOM_H
#define WORLD_ROOM_H

#include "sim/world/builder.h"

/* Fill b->w, whose kind is set, with a room. */
void room_build(struct builder *b);

/* What is seen far away through windows or over a fence: ground at z = -depth, houses and trees,
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

/* Box in the root's frame to the world's. */
void room_box(const struct frame *root, const float box[2][3], float lo[3], float hi[3]);

#endif
