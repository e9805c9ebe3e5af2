/* variate.h - random numbers from a key and a counter: uniform and normal.
 * A 64-bit mix of key + counter x odd constant (SplitMix64); a normal one is the inverse
 * distribution function of one uniform (Wichura, AS 241, PPND7). No libm: the same numbers
 * everywhere. */
#ifndef SENSOR_VARIATE_H
#define SENSOR_VARIATE_H

#include "core/base/splitmix.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

static inline double variate_uniform(uint64_t key, uint64_t counter)
{
    uint64_t h = splitmix_mix(key + (counter + 1) * SPLITMIX_STEP);
    return ((double)(h >> 12) + 0.5) * 0x1p-52; // inside 0..1
}

/* Natural logarithm of 0 < x < 1, to 3e-8. */
static inline double variate_ln(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits -= 0x3FE6A09E667F3BCDu; // sqrt(1/2)
    int64_t e = (int64_t)bits >> 52;
    bits = (bits & 0xFFFFFFFFFFFFFu) + 0x3FE6A09E667F3BCDu;
    double m;
    memcpy(&m, &bits, sizeof m);
    double s = (m - 1.0) / (m + 1.0), q = s * s;
    double p = 1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0)));
    return 0.6931471805599453 * (double)e + 2.0 * s * p;
}

static inline double variate_tail(double p)
{
    double r = sqrt(-variate_ln(p));
    if (r <= 5.0) {
        r -= 1.6;
        return (1.4234372777 + r * (2.7568153900 + r * (1.3067284816 + r * 0.17023821103))) /
               (1.0 + r * (0.73700164250 + r * 0.12021132975));
    }
    r -= 5.0;
    return (6.6579051150 + r * (3.0812263860 + r * (0.42868294337 + r * 0.017337203997))) /
           (1.0 + r * (0.24197894225 + r * 0.012258202635));
}

static inline double variate_normal(uint64_t key, uint64_t counter)
{
    double u = variate_uniform(key, counter), q = u - 0.5;
    if (q >= -0.425 && q <= 0.425) {
        double r = 0.180625 - q * q;
        return q * (3.3871327179 + r * (50.434271938 + r * (159.29113202 + r * 59.109374720))) /
               (1.0 + r * (17.895169469 + r * (78.757757664 + r * 67.187563600)));
    }
    return q < 0.0 ? -variate_tail(u) : variate_tail(1.0 - u);
}

#endif
