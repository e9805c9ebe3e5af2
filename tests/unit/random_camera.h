/* random_camera.h - random cameras for tests of worlds and rotations. */
#ifndef UNIT_RANDOM_CAMERA_H
#define UNIT_RANDOM_CAMERA_H

#include "core/base/types.h"

#include <math.h>

enum { SIZE = 48 }; // px

static uint64_t rng;

static inline float uniform(void)
{
    rng = rng * 6364136223846793005ull + 1442695040888963407ull;
    return (float)(rng >> 40) * 0x1p-23f - 1.0f;
}

static inline struct camera random_camera(void)
{
    struct camera c = {SIZE, SIZE, 50, 50, SIZE / 2, SIZE / 2, {0}, {uniform(), uniform(), 0}};
    float len = 0;
    for (int k = 0; k < 4; k++) {
        c.q[k] = uniform();
        len += c.q[k] * c.q[k];
    }
    for (int k = 0; k < 4; k++)
        c.q[k] /= sqrtf(len);
    return c;
}

#endif
