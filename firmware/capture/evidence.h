/* evidence.h - facts about a camera before a bracket, and the evidence for each of its frames
 * afterwards (firmware/capture/README.md 2). */
#ifndef CAPTURE_EVIDENCE_H
#define CAPTURE_EVIDENCE_H

#include "drivers/device/camera.h"

enum { BRACKET_CAMERAS_MAX = 16, BRACKET_EXPOSURES_MAX = 9 };

/* Stops by which an exposure may be wrong: with linear numbers or a recovered curve, and with
 * display values whose curve is unknown (firmware/capture/README.md 3). */
#define BRACKET_TOLERANCE_LINEAR 0.10
#define BRACKET_TOLERANCE_DISPLAY 0.30

/* Facts about a camera: camera_info, overruled by calibration. */
struct bracket_camera {
    double period_s, time_min_s, time_max_s, time_step_s;
    int delay_lo, delay_hi; // frames, 0..32; unknown: 0..8
    enum camera_stamp stamp;
    bool reports, chooses;
    double tolerance; // stops, BRACKET_TOLERANCE_*
};

enum bracket_proof {    // the strongest first
    BRACKET_REPORTED,   // device, requests and pixels agree
    BRACKET_PIXELS,     // requests and pixels agree; the device does not report
    BRACKET_UNVERIFIED, // all from here on
    BRACKET_UNVERIFIED_FLICKER =
        BRACKET_UNVERIFIED,  // as far as pixels can tell in light that flickers
    BRACKET_UNVERIFIED_DARK, // from rest, device and requests agree; too dark for the pixels
    BRACKET_UNVERIFIED_BRIGHT
};

/* The evidence for a kept frame. */
struct bracket_evidence {
    struct exposure exposure; // the recorded one: as reported, else `set` as rounded
    struct exposure requested, set, reported; // by the plan; read back; by the frame's report
    bool reported_known, ratio_known;
    float ratio, ratio_asked; // stops, to the frame compared with: by the pixels, by exposures
    int patches;              // patches that gave the ratio
    enum bracket_proof proof;
    uint32_t sequence;
    int64_t timestamp_ns, start_ns, request_ns; // frame; begin of its exposure; its request
    int frames_since;                           // frames since the request
    int attempts;                               // requests for this exposure
    bool rested;                                // taken from rest, not pipelined
};

#endif
