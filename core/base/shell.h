/* shell.h - the sphere around the cameras on which everything lies that is infinitely far: sky.
 * Pure functions; any thread. */
#ifndef BASE_SHELL_H
#define BASE_SHELL_H

#include "core/base/types.h"

struct shell {
    float middle[3]; // of the cameras, scene units
    float radius;    // 0: the cameras are in one place, nothing can be told to be far
};

/* SHELL_FAR times as far from the middle as the farthest camera: from it to the middle a direction
 * changes by 0.2 degrees; viewers that sort by 16 bits of depth still tell apart what is near. */
#define SHELL_FAR 300.0f
#define SHELL_OPACITY 0.98f // of a splat on it: behind it there is nothing
#define SHELL_INSIDE 0.4f   // of the depth of the shell, at most: what is not on it

struct shell shell_of(const struct camera *cams, int n);

/* Whether a point belongs to the shell and not to the scene inside. */
bool shell_has(const struct shell *s, const float point[3]);

/* z in the camera of the point of the shell that is seen at pixel (u, v) of cam. */
float shell_depth(const struct shell *s, const struct camera *cam, float u, float v);

#endif
