/* shade_fit.h - vignetting, gain and balance of colours of physical cameras, and light that was
 * another in each photograph, from surfaces that several views show: with the right ones these have
 * one radiance wherever they are seen. A term stays only where it predicts squares of the views
 * that were left out clearly better.
 * Gauge: the geometric mean of the cameras' gains is 1 in each colour, that of the light too. Where
 * the response is yet to be found, light has no trend over the exposures either (a curve that is
 * steeper everywhere looks the same), nor means of exposures that differ far more than photographs
 * of one exposure do: that is an image processor's doing.
 * Pure computation, single thread. thread: any. */
#ifndef REFINE_SHADE_FIT_H
#define REFINE_SHADE_FIT_H

#include "core/base/types.h"
#include "core/photo/shade.h"
#include "core/refine/light_change.h"
#include "core/stereo/sweep.h"

enum {
    SHADE_FIT_CAMERAS = 32, // more are not modelled
    SHADE_FIT_PLACES = 256  // more views are not compared
};

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

#define SHADE_FIT_DRIFT_MOST 3.0 // stops, no photograph's light is farther from the mean

/* Light of the photographs, judged for all of them together; 0.03 stops at least, root mean square,
 * or it is not kept. Then their white balance (automatic in most cameras), in the same way. */
struct shade_fit_drift {
    bool kept, coloured;        // coloured: the white balance is, too
    int held;                   // left-out observations of surfaces
    double error_before, error; // of all of them, as above: without it, and with it
    double error_grey;          // without white balance, where that was tried
    float *stops;               // (n) of the caller; 0 if not kept
    float (*balance)[3];        // (n) of the caller, stops of R,G,B beside these; NULL: not asked
};

struct shade_fit_input {
    const struct views *v; // with cameras, one photograph of each place; light is not read
    const struct depthmaps *depth;
    const struct tonemap *tone;
    bool tone_known;           // else its slope is only known by the exposures
    const struct shade *shade; // (n) maps of r^2; models are not read
    const int *camera;         // (n) which one, 0 .. n_cameras - 1
    int n_cameras;             // 1 .. SHADE_FIT_CAMERAS; 0: nothing is asked about cameras, and
                               // their numbers are any
};

/* out: (n_cameras); all 0 where too few surfaces are shared. change: what is left of differences.
 * err: ERR_NOMEM (see shade_fit_plan), ERR_CANCELLED. */
MUST_USE err_t shade_fit_run(const struct run *r, const struct shade_fit_input *in,
                             struct shade_fit_camera *out, struct shade_fit_drift *drift,
                             struct light_change *change);

/* Bytes of r->tmp. */
size_t shade_fit_plan(int n_views);

#endif
