/* world.h - a procedural place to photograph: solids with materials, lamps, sun and sky, made from
 * a seed. Lengths are metres, z is up, radiance is linear and relative (1 is about a white wall in
 * the middle of the room's light).
 * Pure computation; any thread. The same seed gives the same world on every machine. */
#ifndef WORLD_WORLD_H
#define WORLD_WORLD_H

#include "core/base/plan.h"
#include "sim/world/solids.h"

/* Make the world of `seed`. `kind` WORLD_ANY draws ROOM or YARD.
 * out:  arrays live in `keep`, at most WORLD_SOLIDS, WORLD_MATERIALS, WORLD_LIGHTS.
 * err:  ERR_NOMEM (see world_plan), ERR_ARG (kind). On error *out is zeroed. */
MUST_USE err_t world_make(struct arena *keep, uint64_t seed, enum world_kind kind,
                          struct world *out);
void world_plan(struct plan *p);

/* How a rig photographs a world. */
struct world_path {
    int n;           // cameras
    float spread;    // 0..1: 0 all in one place, 0.2 steps of a few degrees, 1 around the subject
    float fov_deg;   // horizontal field of view, 20..120; 0 drawn by the seed, 40..85
    bool jitter;     // free hand: heights, targets and rolls differ; else a regular rig
    float orbit_deg; // of a world that has room around its focus: cameras on a circle around it, so
                     // far from each other; 0: spread counts
    bool walk; // of such a world: twice around it, the second time nearer to it, back to where it
               // began; the camera swings to both sides of the focus
};

/* Cameras around the focus, outside of every solid, square pictures of `size` px: on a circle, on a
 * walk, or on an arc or grid inside `stand`, where a camera inside a solid is pulled towards the
 * middle.
 * out:  cams[path->n] */
void world_cameras(const struct world *w, const struct world_path *path, uint64_t seed, int size,
                   struct camera *cams);

/* A light that is switched: outdoors the sun where it shines, elsewhere a lamp near the focus,
 * which the world has beside its own, as bright as those of a room or up to eight times weaker. On
 * and off, all else is the same. */
void world_switch_light(struct world *w, uint64_t seed, bool on);

#endif
