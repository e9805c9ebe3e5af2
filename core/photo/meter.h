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
#include "core/photo/raw.h"

enum { METER_EXPOSURES_MAX = 9, METER_BINS = 320, METER_PER_STOP = 8 };

/* The sensor and what is wanted. Zero fields get defaults from meter_defaults. */
struct meter_config {
    double electrons;  // at saturation
    double read_noise; // e-, rms, conversion included
    double snr;        // least signal to noise, ratio; 10 is 20 dB
    double clip;       // share of pixels that may be clipped in all exposures
    double dark;       // share that may be below snr in all
    double headroom;   // top of the usable range, of saturation
    double overlap;    // stops, of an extension with what it extends (meter_check)
    double time_min_s, time_max_s, time_step_s; // step 0: any
    double blur_s;                              // no exposure longer than this; 0: no limit
    double budget_s;                            // sum of times; 0: no limit
    int exposures_max;                          // 1..METER_EXPOSURES_MAX
    bool display; // 8-bit display values: code limits through the curve as well
};

/* For a camera of that kind. */
void meter_defaults(const struct raw *kind, double time_min_s, double time_max_s,
                    double time_step_s, struct meter_config *out);

struct meter {
    struct meter_config cfg;
    double top[METER_BINS], bottom[METER_BINS]; // shares of strongest and weakest channel
    int probes;
    double probe_s[METER_EXPOSURES_MAX];
    bool clipped, starved; // by the shortest probe; by the longest
    double bin_lo;         // log2 radiance of the lower edge of bin 0
    /* fields below are meter.c's own */
    double lo, hi, floor; // log2 of relative exposure: usable from, to; seen at all from
    float share[METER_EXPOSURES_MAX][2][METER_BINS]; // of each probe: strongest, weakest channel
};

/* err: ERR_ARG names field and bound. */
MUST_USE err_t meter_begin(const struct meter_config *cfg, struct meter *m);

/* The time of the next probe at gain 1, s, or 0 when enough is known (after one to three). */
double meter_probe(const struct meter *m);

/* A probe's pixels; exposure is time x gain. crf NULL: sRGB for display values; the same for all
 * probes. */
void meter_add(struct meter *m, const struct raw *px, const struct crf *crf, double exposure_s);

struct meter_result {
    int n;
    double time_s[METER_EXPOSURES_MAX]; // rising
    int probe[METER_EXPOSURES_MAX];     // the probe that serves as it, or -1
    double stops;                       // of the scene
    double snr;                         // expected, worst of the merged set within the scene
    double clipped, dark;               // shares expected
    bool too_bright, too_dark;          // the scene exceeds the device
};

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
