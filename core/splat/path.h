/* path.h - where cameras are and where a virtual one may go.
 * Pure computation.
 * thread: any. */
#ifndef SPLAT_PATH_H
#define SPLAT_PATH_H

#include "core/base/types.h"

/* Its optical axis in the world, unit length. */
void path_axis(const struct camera *cam, double axis[3]);

/* The camera nearest to `to`: by the distance of the centres, by the angle of the axes where
 * distances are equal. n >= 1. */
int path_nearest(const struct camera *cams, int n, const struct camera *to);

/* Frame i of n of a circle through the region of the input cameras: around their mean centre, in
 * the plane in which they spread, with their standard deviation as radii; every frame looks at the
 * point where their optical axes come nearest to each other, or, if they do not (parallel or
 * diverging), at `far` in front of the mean camera.
 * far:  scene units, > 0.
 * out:  intrinsics of the first camera. */
void path_orbit(const struct camera *cams, int n_cams, double far, int i, int n,
                struct camera *out);

/* At share u (0..1) of a smooth way through the cameras in their order, from the first to the last,
 * at an even speed: what is at `far` moves evenly across the picture. Cameras that nearly agree are
 * one stop.
 * far:  scene units, > 0.
 * out:  intrinsics between those of its two neighbours; all cameras are for one picture size. */
void path_through(const struct camera *cams, int n_cams, double far, double u, struct camera *out);

#endif
