/* meter.h - the fewest exposures that cover a scene (core/photo/README.md 4): histogram of log2
 * radiance from probes, least cover of its occupied bins, choice of shift, coverage afterwards.
 * A pixel is covered if one frame has it below `headroom` and the frames that have it so merge to
 * at least `snr`.
 * Gain stays 1. In the dark, light is what is wanting: where a pixel has the asked ratio of 10,
 * gain 8 is worth 0.2 % with a converter of 12 bits, 3 % with 10, nothing with display values; and
 * what noise a device has at which gain, nobody tells.
 * Radiance is relative: 1 saturates the sensor in 1 s at gain 1.
 * Pure; any thread. */
#ifndef PHOTO_METER_H
#define PHOTO_METER_H

#include "core/photo/crf.h"
#include "core/photo/metering.h"

/* For a camera of that kind. */
void meter_defaults(const struct raw *kind, double time_min_s, double time_max_s,
                    double time_step_s, struct meter_config *out);

/* err: ERR_ARG names field and bound. */
MUST_USE err_t meter_begin(const struct meter_config *cfg, struct meter *m);

/* The time of the next probe at gain 1, s, or 0 when enough is known (after one to three). */
double meter_probe(const struct meter *m);

/* A probe's pixels; exposure is time x gain. crf NULL: sRGB for display values; the same for all
 * probes. */
void meter_add(struct meter *m, const struct raw *px, const struct crf *crf, double exposure_s);

/* err: ERR_AGAIN (more probes are wanted) */
MUST_USE err_t meter_plan(const struct meter *m, struct meter_result *out);

struct meter_cover {
    double clipped, dark; // shares of places clipped in all frames, below snr in all
    double extend_s;      // one more exposure that would help most; 0: none
};

/* What n frames at those exposures cover; same size each. */
void meter_check(const struct meter_config *cfg, const struct raw *frames, int n,
                 const struct crf *crf, const double *exposure_s, struct meter_cover *out);

#endif
