#include "core/base/half.h"

#include <string.h>

enum {
    HALF_INF = 0x7c00,
    HALF_LARGEST = 0x7bff, // bits of HALF_MAX
    HALF_QUIET = 0x0200,
    SHIFT = 23 - 10, // mantissa bits that a half lacks
    REBIAS = 127 - 15
};

static uint32_t bits_of(float f)
{
    uint32_t u;
    memcpy(&u, &f, sizeof u);
    return u;
}

static float float_of(uint32_t u)
{
    float f;
    memcpy(&f, &u, sizeof f);
    return f;
}

float half_to_float(uint16_t h)
{
    uint32_t sign = (uint32_t)(h & 0x8000) << 16, exponent = h >> 10 & 31, mantissa = h & 0x3ff;
    if (exponent == 31)
        return float_of(sign | 0x7f800000 | mantissa << SHIFT |
                        (mantissa ? HALF_QUIET << SHIFT : 0));
    if (exponent == 0) {
        float f = (float)mantissa * 0x1p-24f;
        return sign ? -f : f;
    }
    return float_of(sign | (exponent + REBIAS) << 23 | mantissa << SHIFT);
}

/* value >> shift, rounded to nearest even; shift in 1..31. */
static uint32_t shift_round(uint32_t value, unsigned shift)
{
    uint32_t odd = value >> shift & 1;
    return (value + (1u << (shift - 1)) - 1 + odd) >> shift;
}

uint16_t half_from_float(float f)
{
    uint32_t u = bits_of(f), magnitude = u & 0x7fffffff, sign = u >> 16 & 0x8000;
    if (magnitude > 0x7f800000)
        return (uint16_t)(sign | HALF_INF | HALF_QUIET | (magnitude >> SHIFT & 0x3ff));
    if (magnitude >= bits_of(65520.0f))
        return (uint16_t)(sign | HALF_INF);
    if (magnitude >=
        bits_of(0x1p-14f)) // a carry out of the mantissa raises the exponent, as it must
        return (uint16_t)(sign | shift_round(magnitude - ((uint32_t)REBIAS << 23), SHIFT));
    if (magnitude < bits_of(0x1p-25f))
        return (uint16_t)sign;
    uint32_t exponent = magnitude >> 23, mantissa = (magnitude & 0x7fffff) | 0x800000;
    return (uint16_t)(sign | shift_round(mantissa, SHIFT + REBIAS + 1 - exponent));
}

uint16_t half_from_float_sat(float f)
{
    uint16_t h = half_from_float(f);
    return (h & 0x7fff) == HALF_INF ? (uint16_t)((h & 0x8000) | HALF_LARGEST) : h;
}

void half_to_floats(const uint16_t *in, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++)
        out[i] = half_to_float(in[i]);
}

size_t half_from_floats_sat(const float *in, size_t n, uint16_t *out)
{
    size_t saturated = 0;
    for (size_t i = 0; i < n; i++) {
        out[i] = half_from_float(in[i]);
        if ((out[i] & 0x7fff) == HALF_INF) {
            out[i] = (uint16_t)((out[i] & 0x8000) | HALF_LARGEST);
            saturated++;
        }
    }
    return saturated;
}
