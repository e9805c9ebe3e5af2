/* metering.h - configuration, state and result of metering, for meter.c and for coverage.c, which
 * chooses the exposures. */
#ifndef PHOTO_METERING_H
#define PHOTO_METERING_H

#include "core/photo/raw.h"

enum { METER_EXPOSURES_MAX = 9, METER_BINS = 320, METER_PER_STOP = 8 };

/* Sensor and goals. Zero fields get the values of meter_defaults. */
struct meter_config {
    double electrons;  // at saturation
    double read_noise; // e-, rms, conversion included
    double snr;        // least signal to noise, ratio; 10 is 20 dB
    double clip;       // share of pixels that may be clipped in all exposures
    double dark;       // share that may be below snr in all
    double headroom;   // top of the usable range, of saturation
    double overlap;    // stops that an extension shares with the exposures it extends (meter_check)
    double time_min_s, time_max_s, time_step_s; // step 0: any
    double blur_s;                              // no exposure longer than this; 0: no limit
    double budget_s;                            // sum of times; 0: no limit
    int exposures_max;                          // 1..METER_EXPOSURES_MAX
    bool display; // 8-bit display values: code limits through the curve as well
};

struct meter {
    struct meter_config cfg;
    double top[METER_BINS], bottom[METER_BINS]; // shares of strongest and weakest channel
    int probes;
    double probe_s[METER_EXPOSURES_MAX];
    bool clipped, starved; // too much for the shortest probe; for the longest
    double bin_lo;         // log2 radiance of the lower edge of bin 0
    /* fields below are meter.c's own */
    double lo, hi, floor; // log2 of relative exposure: usable from, to; visible from
    float share[METER_EXPOSURES_MAX][2][METER_BINS]; // per probe: strongest, weakest channel
};

struct meter_result {
    int n;
    double time_s[METER_EXPOSURES_MAX]; // rising
    int probe[METER_EXPOSURES_MAX];     // the probe with that time, or -1
    double stops;                       // range of the scene
    double snr;                         // expected, worst of the merged set within the scene
    double clipped, dark;               // shares expected
    bool too_bright, too_dark;          // the scene exceeds the device
};

#endif
