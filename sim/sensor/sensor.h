/* sensor.h - an image sensor and the processing behind it, in the terms of EMVA 1288 release 4:
 * radiance and exposure time to raw numbers, raw numbers to a displayable picture.
 * Random numbers depend on (seed, frame, row, pixel) alone: the same picture for any number of
 * threads. Pure computation; any thread. */
#ifndef SENSOR_SENSOR_H
#define SENSOR_SENSOR_H

#include "core/base/types.h"
#include "sim/sensor/curve.h"

enum sensor_cfa { SENSOR_RGB, SENSOR_RGGB, SENSOR_BGGR }; // three full planes, or a Bayer mosaic

struct sensor {
    enum sensor_cfa cfa;
    float electrons;  // mean electrons of radiance 1 in 1 s through a white filter (eta A)
    float prnu, dsnu; // relative rms of gain; e-, rms of offset: fixed patterns of the unit
    float dark_per_s; // e- / s
    float read_noise; // e-, rms
    float row_noise;  // e-, rms, one value per row and frame
    float full_well;  // e-
    float gain;       // digital numbers per e- at analogue gain 1 (K of EMVA 1288)
    int bits, black;  // of the converter, 8..16; digital numbers
    float balance[3]; // sensitivity of the colour channels, undone by the white balance
    float line_s;     // s, rolling shutter: row r starts r line_s later; 0 global
    float flicker, flicker_hz; // depth 0..1 and frequency of the light's ripple; 0 none
    uint64_t unit;             // seed of the fixed patterns
};

/* A small ordinary sensor: 10 000 e-, 12 bits, 2.5 e- read noise, global shutter. */
extern const struct sensor sensor_default;

struct sensor_shot {
    double exposure_s; // effective
    float gain;        // analogue gain, >= 1
    double start_s;    // of the first row, for flicker
    uint64_t seed, frame;
};

/* err: ERR_ARG names the field and its bound. */
MUST_USE err_t sensor_check(const struct sensor *s);

/* Raw numbers of one picture. */
struct sensor_raw {
    int w, h;     // px; even for a mosaic
    uint16_t *px; // (h, w) for a mosaic, (3, h, w) for SENSOR_RGB; 0 .. 2^bits - 1
};

/* Expose to radiance, which has 3 planes and the size of out.
 * err:  ERR_ARG, ERR_CANCELLED */
MUST_USE err_t sensor_expose(const struct run *r, const struct sensor *s,
                             const struct sensor_shot *shot, const struct image *radiance,
                             struct sensor_raw *out);

/* Raw numbers to an 8-bit picture: black level, white balance, demosaicing (bilinear), response
 * curve, rounding. White is full_well * gain * shot->gain or the converter's last code, whichever
 * comes first.
 * out:  px (h, w, 3) */
MUST_USE err_t sensor_develop(const struct run *r, const struct sensor *s,
                              const struct sensor_shot *shot, const struct curve *c,
                              const struct sensor_raw *raw, uint8_t *px);

/* The same but for curve and rounding: relative exposure, 1 = white, perhaps below 0 by noise.
 * out:  (3, h, w) */
MUST_USE err_t sensor_linear(const struct run *r, const struct sensor *s,
                             const struct sensor_shot *shot, const struct sensor_raw *raw,
                             float *out);

/* Uniform (0..1), standard normal and Poisson variates by a counter-based generator (variate.h).
 * Poisson: exact inversion for means below 30, above that normal with continuity correction. */
double sensor_uniform(uint64_t key, uint64_t counter);
double sensor_normal(uint64_t key, uint64_t counter);
double sensor_poisson(uint64_t key, uint64_t counter, double mean);

#endif
