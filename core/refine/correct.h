/* correct.h - what the network predicts, corrected by what is known better: cameras, depth and the
 * photographs. Pure computation on the pool inside struct run; the result does not depend on the
 * number of threads. */
#ifndef REFINE_CORRECT_H
#define REFINE_CORRECT_H

#include "core/net/graph.h"
#include "core/stereo/seed.h"

/* The factor from the network's world to that of cameras that are known better, and p's geometry,
 * points and features moved to that world divided by the factor: sizes stay those that the network
 * knows. Pixels are unprojected anew, by these cameras.
 * cams: (n_views) for p->geom.size.
 * depth_scale: (n_views) factor of each view's depth, then the median is that of the world; NULL:
 *       the distances of the cameras say (similarity.h).
 * err:  ERR_NOMEM (r->tmp, see correct_cameras_plan), ERR_CANCELLED. */
MUST_USE err_t correct_cameras(const struct run *r, const struct camera *cams,
                               const float *depth_scale, struct prediction *p, float *scale);
void correct_cameras_plan(struct plan *p, int n_views);

/* Leave views out: cameras, depth, points, Gaussians and depth_scale (n_views) of the others move
 * up; pose and matches do not. */
void correct_drop(const bool *keep, float *depth_scale, struct prediction *p);

/* Results of the steps before, once cameras are known. */
struct correct_known {
    struct seed_input seen;     // one picture of each place with all that its exposures show, p's
                                // cameras, depth
    const struct views *views;  // what the network saw
    const struct tonemap *tone; // response of the camera
};

/* Where the photographs are sure, they overrule the network. Pixels of sure depth move there, the
 * others to where the views agree (consensus.h), all at the middle of the pixel and not at its
 * corner, as the network has it (core/net/README.md 2.11); Gaussians grow as their distance does,
 * so that they cover as many pixels as before, but with a standard deviation of one pixel at most.
 * A pixel that is neither black nor saturated has the photograph's radiance; others keep the
 * network's, under the known curve, which becomes p's, as far as this curve reaches.
 * Pixels are left out (their confidence is no number, see voxel_merge) where another view shows the
 * same surface and says more than twice as much about its radiance. Of a pixel whose depth is not
 * sure, every view may be that other one that has its point in the picture; it is also left out
 * where a view looks through it to what it is sure of, and where more views show another radiance
 * (by more than a stop) than the same.
 * Display colours (p->linear) stay as they are.
 * scale: of correct_cameras.
 * err:  ERR_NOMEM (r->tmp, see correct_plan). */
MUST_USE err_t correct_run(const struct run *r, const struct correct_known *known, float scale,
                           struct prediction *p);
void correct_plan(struct plan *p, int n_views, int size);

#endif
