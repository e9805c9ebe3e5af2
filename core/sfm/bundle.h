/* bundle.h - accurate cameras: bundle adjustment of cameras, their lenses and points on tracks
 * (Triggs et al., "Bundle adjustment: a modern synthesis", 2000): Levenberg-Marquardt,
 * points eliminated (Schur complement), Cauchy loss, graduated from wide to narrow.
 * It starts from the network's cameras and from the tracks alone (two-view geometry by RANSAC,
 * rotations averaged, centres and points linear: of all views, and of a few to which the others are
 * added); the best result wins.
 * Pure computation; deterministic: random draws come from a fixed seed. */
#ifndef SFM_BUNDLE_H
#define SFM_BUNDLE_H

#include "core/base/types.h"
#include "core/sfm/match.h"
#include "core/sfm/selfcal.h"

enum { BUNDLE_VIEWS_MAX = 512 };
#define BUNDLE_FOCAL 0.8660254037844386 // usual, over the longer edge: 60 degrees

/* Lens of a physical camera: fx = fy, the terms, and cx, cy, for px from the middle of its views as
 * they were taken. */
struct bundle_lens {
    struct lens start;  // fx 0: from the cameras of the start, else that of 60 degrees
    bool focal_guessed; // fx is a guess from the matches; else it is right within some percent
};

struct bundle_config {
    const struct camera *start; // (n_views) for the views, or NULL: none; ignored if one of them is
                                // not finite or not valid
    const float *start_depth; // (extents of the views) of `start`, or NULL; only its scale is used
    int n_lenses;             // 0: one for all views, about which nothing is known
    const struct bundle_lens *lens; // (n_lenses)
    const int *lens_of;             // (n_views) which lens took it
    const int *turned; // (n_views) quarter turns clockwise from the sensor to the view, or NULL
    const float
        *pinhole;     // (n_views) px, focal length of the pinhole that the view was resampled to
                      // through lens.start, or NULL: views are as taken
    bool focal_known; // keep the focal lengths
    bool find_distortion; // else lenses have the terms of lens.start
    bool find_principal;  // with find_distortion; else principal points are those of lens.start
    bool measure_poses;   // find how well they are known
    bool rig_known;       // rotations and centres of `start` relative to each other are
                          // calibrated: only focal (if not known) and points move
};

struct bundle_result {
    struct camera
        *cams; // (n_views), fx = fy x v->aspect of the lens, or of the pinhole that the view was
               // resampled to; principal point at the centre;
    // world: that of `start` (best similarity) or the first placed camera's; unless
    // rig_known, the cameras' distances from their middle are 1 (root of the mean square)
    float *points;      // (n_tracks, 3), NaN where a track was rejected; finite, but very far away,
                        // where rays are parallel
    float *depth_scale; // (n_views) median of triangulated over start_depth, in out's world; 1 if
                        // not known
    int n_lenses;
    struct lens *lenses;          // (n_lenses) as bundle_lens.start
    struct selfcal_lens *selfcal; // (n_lenses); zero unless find_distortion
    double *pose_covariance;      // (n_views, COVARIANCE_POSE) in out's world (covariance.h)
    float *depth;                 // (n_views) median of its points, out's world; 0: it has none
                                  // both are 0 unless measure_poses
    float rms_px;                 // of the inliers
    int inliers, observations;
    int n_placed;    // views connected to the others by enough inliers
    bool *placed;    // (n_views); the cameras of others are those of `start`, moved along, or
                     // copies of the nearest placed one
    float agreement; // 0..1: share of inliers beyond chance x share of placed views
    float
        confidence; // 0: nothing is known .. 1; agreement x parallax. Agreement without confidence:
                    // the camera only rotated or stood still
    bool from_tracks; // the start from tracks won
};

/* v:    only n, size, aspect and extent are read
 * out:  lives in r->keep
 * err:  ERR_ARG (1 to BUNDLE_VIEWS_MAX views; tracks that violate match.h), ERR_NOMEM (see
 *       bundle_plan), ERR_CANCELLED. On error *out is zeroed. Too few tracks are no
 *       error: confidence is 0 and cams those of `start`, or all in one place. */
MUST_USE err_t bundle_run(const struct run *r, const struct views *v,
                          const struct match_tracks *tracks, const struct bundle_config *cfg,
                          struct bundle_result *out);

/* Count the memory of bundle_run; of t only n and n_tracks are read. */
void bundle_plan(struct plan *p, int n_views, int n_lenses, const struct match_tracks *t);

#endif
