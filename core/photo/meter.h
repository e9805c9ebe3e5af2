/* meter.h - the fewest exposures that cover a scene (core/photo/README.md 4): histogram of log2
 * radiance from probes, least cover of its occupied bins, check of the frames taken.
 * A pixel is covered if at least one frame has it below `headroom` and these frames merge to a
 * signal to noise of at least `snr`.
 * Gain stays 1: at a signal to noise of 10 a gain of 8 improves it by 0.2 % with a converter of 12
 * bits, by 3 % with 10 bits and not at all with display values, and devices do not report their
 * noise per gain.
 * Radiance is relative: 1 saturates the sensor in 1 s at gain 1.
 * Pure; any thread. */
#ifndef PHOTO_METER_H
#define PHOTO_METER_H

#include "core/photo/crf.h"
#include "core/photo/metering.h"

/* Defaults for a camera with frames like `kind`. */
void meter_defaults(const struct raw *kind, double time_min_s, double time_max_s,
                    double time_step_s, struct meter_config *out);

/* err: ERR_ARG names field and bound. */
MUST_USE err_t meter_begin(const struct meter_config *cfg, struct meter *m);

/* The time of the next probe at gain 1, s, or 0 when enough is known (after one to three). */
double meter_probe(const struct meter *m);

/* A probe's pixels; exposure is time x gain. crf NULL: sRGB for display values; the same for all
 * probes. */
void meter_add(struct meter *m, const struct raw *px, const struct crf *crf, double exposure_s);

/* The exposures to take.
 * err:  ERR_AGAIN (another probe is needed). */
MUST_USE err_t meter_choose(const struct meter *m, struct meter_result *out);

struct meter_coverage {
    double clipped, dark; // shares of places clipped in all frames, below snr in all
    double extend_s;      // the additional exposure that helps most; 0: none
};

/* Coverage by n frames of one size at those exposures. */
void meter_check(const struct meter_config *cfg, const struct raw *frames, int n,
                 const struct crf *crf, const double *exposure_s, struct meter_coverage *out);

#endif
