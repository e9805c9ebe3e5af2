/* calibrate.h - what a camera does with exposure requests, measured by its pixels before a scene
 * and a light that stay: delay, range in which exposure obeys, response curve.
 * thread: one. Calls take seconds, end early by engine_cancel, and tell their progress. */
#ifndef CAPTURE_CALIBRATE_H
#define CAPTURE_CALIBRATE_H

#include "firmware/capture/calib.h"
#include "firmware/capture/device_probe.h"

enum calibrate_part { CALIBRATE_LATENCY = 1, CALIBRATE_RANGE = 2, CALIBRATE_RESPONSE = 4 };

enum { CALIBRATE_STEPS_MAX = 48, CALIBRATE_TEXT = 200 };

enum calibrate_verdict {
    CALIBRATE_UNSEEN, // too dark or too bright for the pixels to tell
    CALIBRATE_OBEYS,
    CALIBRATE_WRONG // three times
};

/* One exposure of the sweep, against the one before. */
struct calibrate_step {
    double time_s;              // as the device should round it
    double requested, measured; // stops; measured is NAN if only bounds are known
    enum calibrate_verdict verdict;
    bool rises;
};

struct calibrate {
    double longest_s;   // exposure that is tried, given
    struct calib calib; // as it may be saved
    unsigned parts;     // that were measured: enum calibrate_part
    double base_s;      // an exposure at which the scene shows
    int trials, unsure; // steps that measured the delay; steps that lost frames spoiled
    int n;              // steps of the sweep
    struct calibrate_step step[CALIBRATE_STEPS_MAX]; // by rising exposure
    double seen_min_s, seen_max_s;                   // in which pixels prove that exposure obeys
    double drift;                                    // stops, of the base exposure during the sweep
    char curve_why[CALIBRATE_TEXT];                  // why there is no response curve, or ""
};

/* An exposure at which much of the scene is neither dark nor clipped.
 * err:  those of device_probe_rest and device_probe_ask, as everywhere here; ERR_LIMIT: too dark,
 * too bright. */
MUST_USE err_t calibrate_base(struct device_probe *w, struct calibrate *c);

/* Frames from the one that runs during a request to the first that shows it. From here on base_s
 * must be set.
 * err:  ERR_UNSUPPORTED: exposure has no effect, or too late, or cannot be varied. */
MUST_USE err_t calibrate_delay(struct device_probe *w, struct calibrate *c);

/* The response curve of a display format, also into w; without one curve_why tells. Nothing to do
 * for linear numbers. The delay must be known, here and below. */
MUST_USE err_t calibrate_curve(struct device_probe *w, struct calibrate *c);

/* A sweep of exposures, 0.9 stops apart: multiples of one step would fall in with
 * those of a camera that has coarser steps than it says.
 * err:  ERR_LIMIT: the light or the scene changed. */
MUST_USE err_t calibrate_range(struct device_probe *w, struct calibrate *c);

/* Stops that the ratio of neighbours in the sweep may be off. */
double calibrate_slack(const struct device_probe *w);

/* The parts that are wanted, and what they need; the others stay as in `known`, of calib_load. Of a
 * camera that has few exposures only the response can be measured. */
MUST_USE err_t calibrate_run(struct device_probe *w, unsigned parts, double longest_s,
                             const struct calib *known, struct calibrate *c);

#endif
