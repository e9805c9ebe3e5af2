/* curve.h - families of camera response curves: relative exposure (1 = full scale of a linear
 * sensor) to display value 0..1. Monotone, continuous, finite for every input.
 * Pure functions; any thread. */
#ifndef SENSOR_CURVE_H
#define SENSOR_CURVE_H

#include "core/photo/response_family.h"

#include <stdint.h>

enum curve_family { // those of response_family.h, and one more
    CURVE_LINEAR = RESPONSE_FAMILY_LINEAR,
    CURVE_SRGB = RESPONSE_FAMILY_SRGB,
    CURVE_GAMMA = RESPONSE_FAMILY_GAMMA,   // param 1.6..3
    CURVE_FILMIC = RESPONSE_FAMILY_FILMIC, // param 0..1
    CURVE_AGX = RESPONSE_FAMILY_AGX,       // param 8..16
    CURVE_LOG = RESPONSE_FAMILY_LOG,       // param 3..12
    CURVE_RANDOM, // random monotone spline in log exposure around sRGB, by seed; param: strength
    CURVE_FAMILIES
};

#define CURVE_WORDS "linear|srgb|gamma|filmic|agx|log|random" // names of the families

enum { CURVE_STEPS = 1024 };

/* A curve, tabulated over log2 of exposure so that evaluation is one lookup. */
struct curve {
    enum curve_family family;
    float param;
    float lo, hi;                 // log2 exposure of the first and last entry
    float table[CURVE_STEPS + 1]; // display values, not falling
};

/* param outside of the family's range is clamped; NAN: its usual one. */
void curve_make(enum curve_family family, float param, uint64_t seed, struct curve *out);

/* Family and parameter drawn by the seed, as training uses them (never LINEAR). */
void curve_draw(uint64_t seed, struct curve *out);

/* Display value, 0..1, of relative exposure x; negative and NaN count as 0. */
float curve_display(const struct curve *c, float x);

/* Smallest relative exposure with that display value, within one entry of the table. */
float curve_exposure(const struct curve *c, float display);

#endif
