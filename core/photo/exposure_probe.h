/* exposure_probe.h - exposure evidence from pixels: a small grid of patches in a frame, and the
 * ratio of exposures of two frames of one scene at the same patches (core/photo/README.md 5.1).
 * Pure; any thread. */
#ifndef PHOTO_EXPOSURE_PROBE_H
#define PHOTO_EXPOSURE_PROBE_H

#include "core/photo/crf.h"
#include "core/photo/raw.h"

#include <stdint.h>

enum {
    EXPOSURE_PROBE_EDGE = 32,
    EXPOSURE_PROBE_PATCHES = EXPOSURE_PROBE_EDGE * EXPOSURE_PROBE_EDGE
};

enum exposure_probe_state {
    EXPOSURE_PROBE_GOOD,
    EXPOSURE_PROBE_DARK,   // below `floor`, whatever x is
    EXPOSURE_PROBE_CLIPPED // some pixel of the patch is saturated: exposure is at least x
};

/* Mean of a block of pixels, all colours alike, at each patch of an even grid. */
struct exposure_probe {
    float
        x[EXPOSURE_PROBE_PATCHES]; // relative exposure, 1 = saturation; of a dark patch any number
    float sd[EXPOSURE_PROBE_PATCHES];    // its standard error
    float floor[EXPOSURE_PROBE_PATCHES]; // > 0: below it noise and code steps make x unreliable
    uint8_t state[EXPOSURE_PROBE_PATCHES];
    int good, dark, clipped; // patches
    float step;              // exposure of one code at black
    bool linear;             // x of dark patches is right but for noise and an error of black
    float overlap;           // >= 1: patches that share a pixel, where a picture is small
};

/* crf: the curve of display values; NULL: sRGB is assumed. Under another curve ratios are wrong by
 * up to 0.1 stops per stop for gamma 2.2 and 0.6 for filmic curves; callers must allow for it. */
void exposure_probe_measure(const struct raw *px, const struct crf *crf,
                            struct exposure_probe *out);

struct exposure_probe_ratio {
    int patches;  // where the expected exposure is above the floor of both; 0: too few
    float log2;   // exposure of b over that of a: median over the patches; 0 if there are none
    float error;  // its standard error
    float spread; // half of the interquartile range: large if parts of the scene or their
                  // light changed
    float noise;  // rms of the ratio of a patch by noise alone, stops
    float band;   // stops, >= 0: significant deviation of adjacent rows from the ratio
    float moved;  // share of the patches with a ratio or a bound that show another one
    float lo, hi; // bounds by dark and clipped patches, lo <= hi; some may be wrong; -/+ INFINITY
};

/* Compare b with a. moving: share of the picture that is known to move, 0..1: bounds are wrong
 * there. */
void exposure_probe_compare(const struct exposure_probe *a, const struct exposure_probe *b,
                            float moving, struct exposure_probe_ratio *out);

/* Rows of the grid, bit 0 the uppermost. */
struct exposure_probe_rows {
    uint32_t refuted; // b surely has not the ratio `other` to a
    uint32_t alike;   // nobody could tell it from the ratio `log2`: no patch would differ by more
                      // than two codes (core/photo/README.md 5.1)
};

struct exposure_probe_rivals {
    double log2, other; // ratio of b to a, stops: the one that it has elsewhere; another one
    float moving;       // share of the picture that is known to move, 0..1
};

/* Whether rows of b may have the other ratio to a, and not the one that b has elsewhere. Says
 * nothing about rows where a itself may have another exposure. */
void exposure_probe_refuted(const struct exposure_probe *a, const struct exposure_probe *b,
                            const struct exposure_probe_rivals *rivals,
                            struct exposure_probe_rows *out);

#endif
