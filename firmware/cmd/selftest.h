/* selftest.h - checks that a camera does what a capture needs, each with its figures, while it
 * looks at a scene and a light that stay. The ITS of Android is the model
 * (firmware/capture/README.md 5): pixels count, not the device's reports.
 * thread: one. Takes about a minute. */
#ifndef CMD_SELFTEST_H
#define CMD_SELFTEST_H

#include "firmware/capture/calibrate.h"

enum selftest_check {
    SELFTEST_STREAM,   // frames come to the end, and can be read
    SELFTEST_RATE,     // at the stated rate
    SELFTEST_SEQUENCE, // numbers rise
    SELFTEST_DROPS,    // no frame is lost
    SELFTEST_STAMPS,   // rise, of CLOCK_MONOTONIC
    SELFTEST_ERRORS,   // no frame is marked as bad, or cannot be read
    SELFTEST_GAINS,    // digital gain is 1, white balance does not move
    SELFTEST_REQUESTS, // are taken, read back rounded down
    SELFTEST_EFFECT,   // exposure changes the pixels
    SELFTEST_DELAY,    // constant, as calibrated or promised
    SELFTEST_LATCHING, // 14 requests back to back, each shows in its frame
    SELFTEST_REPORTED, // frames say what their pixels show
    SELFTEST_RATIOS,   // ratios of exposures are ratios of light
    SELFTEST_MONOTONE, // longer is brighter
    SELFTEST_STEADY,   // the same exposure gives the same picture
    SELFTEST_BRACKET3, // complete, proven, in as few frames as can be
    SELFTEST_BRACKET5,
    SELFTEST_CHECKS
};

enum selftest_result { SELFTEST_SKIPPED, SELFTEST_PASS, SELFTEST_FAIL };

enum { SELFTEST_FIGURES = 4 };

struct selftest_finding {
    enum selftest_result result;
    char text[CALIBRATE_TEXT]; // a sentence with the figures, or why it was skipped
    int n;
    struct {
        const char *name; // as in a report
        double value;
    } figure[SELFTEST_FIGURES];
};

struct selftest {
    struct camera_info info;
    bool calibrated; // by a file; else by itself, for this run
    struct calibrate measured;
    struct selftest_finding check[SELFTEST_CHECKS];
};

struct selftest_order {
    struct camera_cfg camera;
    const char *calibration;   // folder
    double longest_s;          // exposure that is tried
    struct progress *progress; // or NULL
};

/* Word of a check, as in a report. */
const char *selftest_name(enum selftest_check c);

/* err:  those of device_probe_open; ERR_CANCELLED, ERR_NOMEM, ERR_IO (a folder for the calibration
 *       of this run). Errors of a camera that could be opened are findings. */
MUST_USE err_t selftest_run(const struct selftest_order *o, struct selftest *out);

/* No check failed. */
bool selftest_passed(const struct selftest *t);

#endif
