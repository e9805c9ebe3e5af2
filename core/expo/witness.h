/* witness.h - what the pixels of a frame say about its exposure: a small grid of places, and the
 * ratio of exposures of two frames of one scene seen at the same places (capture notes 4.5, W4).
 * Pure; any thread. */
#ifndef EXPO_WITNESS_H
#define EXPO_WITNESS_H

#include "core/expo/crf.h"
#include "core/expo/raw.h"

enum { WITNESS_EDGE = 32, WITNESS_PLACES = WITNESS_EDGE * WITNESS_EDGE };

enum witness_state {
    WITNESS_GOOD,
    WITNESS_DARK,   // below what noise and code steps allow to trust: exposure is at most x
    WITNESS_CLIPPED // some pixel of the place is saturated: exposure is at least x
};

/* Mean of a block of pixels of the strongest channel at each place of an even grid. */
struct witness {
    float x[WITNESS_PLACES];  // relative exposure, 1 = saturation; > 0
    float sd[WITNESS_PLACES]; // of log2 x
    uint8_t state[WITNESS_PLACES];
    int good, dark, clipped; // places
};

/* `crf` is for display values; NULL: sRGB is assumed, which callers must allow for: under another
 * curve ratios are wrong, by up to 0.1 stops per stop for gamma 2.2, 0.6 for filmic ones. */
void witness_take(const struct raw *px, const struct crf *crf, struct witness *out);

struct witness_ratio {
    int places;   // good in both
    float log2;   // exposure of b over that of a: median over the places; 0 if there are none
    float spread; // half of the range between the quartiles: large if the scene or the light of
                  // parts of it changed
    float lo, hi; // what dark and clipped places allow, with 2 % of all places wrong; -/+ INFINITY
};

/* Compare b with a. */
void witness_compare(const struct witness *a, const struct witness *b, struct witness_ratio *out);

#endif
