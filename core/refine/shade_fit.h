/* shade_fit.h - vignetting, gain and balance of colours of physical cameras, from surfaces that
 * several views show: with the right ones these have one radiance wherever they are seen. A term
 * stays only where it predicts squares of the views that were left out clearly better.
 * Gauge: the geometric mean of the cameras' gains is 1 in each colour.
 * Pure computation, single thread. thread: any. */
#ifndef REFINE_SHADE_FIT_H
#define REFINE_SHADE_FIT_H

#include "core/base/types.h"
#include "core/photo/shade.h"
#include "core/stereo/sweep.h"

enum { SHADE_FIT_CAMERAS = 32 }; // more are not modelled

enum shade_fit_kind {
    SHADE_FIT_V2,
    SHADE_FIT_V4,
    SHADE_FIT_V6,
    SHADE_FIT_GAIN,
    SHADE_FIT_BALANCE,
    SHADE_FIT_KINDS
};

/* About one camera. Errors are root mean squares of left-out differences of log2 radiance, stops,
 * each at most that of an inlier; gain and balance are judged for all cameras together. */
struct shade_fit_camera {
    struct shade_model model;
    int held;                   // left-out observations of surfaces
    double error_before, error; // without any term, and with those kept
    bool kept[SHADE_FIT_KINDS];
    double without[SHADE_FIT_KINDS]; // error when this term was tried last and left out
};

struct shade_fit_input {
    const struct views *v; // with cameras, one photograph of each place
    const struct depthmaps *depth;
    const struct tonemap *tone;
    const struct shade *shade; // (n) maps of r^2; models are not read
    const int *camera;         // (n) 0 .. n_cameras - 1
    int n_cameras;             // 1 .. SHADE_FIT_CAMERAS
};

/* out: (n_cameras); all 0 where too few surfaces are shared.
 * err: ERR_NOMEM (see shade_fit_plan), ERR_CANCELLED. */
MUST_USE err_t shade_fit_run(const struct run *r, const struct shade_fit_input *in,
                             struct shade_fit_camera *out);

/* Bytes of r->tmp. */
size_t shade_fit_plan(int n_views);

#endif
