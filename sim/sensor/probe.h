/* probe.h - indirect light: gathered at the points of a grid in the six directions of its axes, and
 * interpolated between them. Pure computation on the pool;
 * the result does not depend on the number of threads. */
#ifndef SENSOR_PROBE_H
#define SENSOR_PROBE_H

#include "sim/world/light.h"

struct probe_cube;

struct probes {
    int n[3];               // along x, y, z
    float lo[3], step[3];   // m, of the first point; between points
    struct probe_cube *all; // (n[2], n[1], n[0])
};

/* Gather for the world of `lights`.
 * out:  lives in r->keep
 * err:  ERR_NOMEM (see probe_plan), ERR_CANCELLED */
MUST_USE err_t probe_build(const struct run *r, const struct light_set *lights, struct probes *out);
void probe_plan(struct plan *p);

/* Irradiance at p, m, on a surface with normal n. */
void probe_light(const struct probes *s, const float p[3], const float n[3], float out[3]);

#endif
