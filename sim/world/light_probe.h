/* light_probe.h - indirect light: irradiance gathered at the points of a grid in the six directions
 * of its axes, and interpolated between them. Pure computation on the pool; the result does not
 * depend on the number of threads. */
#ifndef WORLD_LIGHT_PROBE_H
#define WORLD_LIGHT_PROBE_H

#include "sim/world/light.h"

struct light_probe_cube;

struct light_probes {
    int n[3];                     // along x, y, z
    float lo[3], step[3];         // m, of the first point; between points
    struct light_probe_cube *all; // (n[2], n[1], n[0])
};

/* Gather for the world of `lights`.
 * out:  lives in r->keep
 * err:  ERR_NOMEM (see light_probe_plan), ERR_CANCELLED */
MUST_USE err_t light_probe_build(const struct run *r, const struct light_set *lights,
                                 struct light_probes *out);
void light_probe_plan(struct plan *p);

/* Irradiance at p, m, on a surface with normal n. */
void light_probe_irradiance(const struct light_probes *s, const float p[3], const float n[3],
                            float out[3]);

#endif
