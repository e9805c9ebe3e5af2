/* half.h - IEEE 754 binary16 as bits, converted in integer arithmetic.
 * The same bits on every machine; no F16C or FP16 unit needed. Source: IEEE 754-2008, 3.6 and
 * 4.3.1. */
#ifndef BASE_HALF_H
#define BASE_HALF_H

#include <stddef.h>
#include <stdint.h>

#define HALF_MAX 65504.0f // largest finite value

/* Exact. A NaN keeps its sign and payload; it is returned quiet. */
float half_to_float(uint16_t h);

/* Round to nearest, ties to even; from 65520 on the result is infinite. A NaN stays a (quiet)
 * NaN. */
uint16_t half_from_float(float f);

/* As half_from_float, but infinite results become +-HALF_MAX. */
uint16_t half_from_float_sat(float f);

/* n values each. The second one returns how many values it saturated. */
void half_to_floats(const uint16_t *in, size_t n, float *out);
size_t half_from_floats_sat(const float *in, size_t n, uint16_t *out);

#endif
