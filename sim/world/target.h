/* target.h - a calibration target in a world: a flat sheet of cells before the cameras of a rig,
 * whose pose is drawn from a seed.
 * Pure computation; any thread. */
#ifndef WORLD_TARGET_H
#define WORLD_TARGET_H

#include "core/base/err.h"
#include "sim/world/world.h"

struct target {
    struct texture_cells cells;
    uint64_t seed;   // of its pose
    int first, last; // cameras that it stands before; it faces the middle of them
    float distance;  // m from there, within 15 %
};

/* Add the sheet to the world, where nothing stands between it and the cameras if such a pose is
 * found. It is tilted by 6 to 35 degrees, rolled by up to 25, and off to a side by up to a fifth of
 * the distance.
 * cams: of the rig. The target outlives the world.
 * err:  ERR_ARG (cameras that cams, n of them, does not have), ERR_LIMIT (a full world). */
MUST_USE err_t target_add(struct world *w, const struct target *t, const struct camera *cams,
                          int n);

#endif
