/* A curve is tabulated over u = log2 exposure, -24..0, and looked up with linear interpolation;
 * below the table the display value falls in proportion to the exposure, above it is the last one.
 * RANDOM is the integral over u of the slope of sRGB times exp(strength * s(u)), s a cubic B-spline
 * with normal coefficients every 2 stops: monotone whatever the numbers are. The other families are
 * those of core/photo/response_family.c. */
#include "sim/sensor/curve.h"

#include "core/base/splitmix.h"
#include "sim/sensor/variate.h"

#include <math.h>
#include <string.h>

#define LOW (-24.0) // log2 exposure: even a power of 1/3 shows code 1 there
#define RANDOM_USUAL 0.5f
#define KNOT 2.0 // stops between coefficients of RANDOM
enum { KNOTS = 16 };

static const struct {
    float lo, hi;
} params[CURVE_FAMILIES] = {[CURVE_GAMMA] = {1.6f, 3.0f},
                            [CURVE_FILMIC] = {0.0f, 1.0f},
                            [CURVE_AGX] = {8.0f, 16.0f},
                            [CURVE_LOG] = {3.0f, 12.0f},
                            [CURVE_RANDOM] = {0.0f, 1.5f}};

/* Cubic B-spline with coefficients c at every KNOT from LOW - KNOT on. */
static double eval_spline(const double c[KNOTS], double u)
{
    double v = (u - LOW) / KNOT;
    int i = (int)fmin(fmax(floor(v), 0.0), KNOTS - 4);
    double t = v - i, s = 1.0 - t;
    return (s * s * s * c[i] + (4.0 + t * t * (3.0 * t - 6.0)) * c[i + 1] +
            (4.0 + s * s * (3.0 * s - 6.0)) * c[i + 2] + t * t * t * c[i + 3]) /
           6.0;
}

static double step_position(const struct curve *c, int i)
{
    return c->lo + (c->hi - c->lo) * (double)i / CURVE_STEPS;
}

static double srgb_display(double u)
{
    return response_family_display(RESPONSE_FAMILY_SRGB, 0, u);
}

static void make_random(uint64_t seed, struct curve *c)
{
    double k[KNOTS], sum[CURVE_STEPS + 1];
    for (int i = 0; i < KNOTS; i++)
        k[i] = c->param * variate_normal(splitmix_mix(seed), (uint64_t)i);
    sum[0] = srgb_display(c->lo);
    for (int i = 1; i <= CURVE_STEPS; i++) {
        double u0 = step_position(c, i - 1), u1 = step_position(c, i);
        sum[i] = sum[i - 1] +
                 (srgb_display(u1) - srgb_display(u0)) * exp(eval_spline(k, 0.5 * (u0 + u1)));
    }
    for (int i = 0; i <= CURVE_STEPS; i++)
        c->table[i] = (float)(sum[i] / sum[CURVE_STEPS]);
}

void curve_make(enum curve_family family, float param, uint64_t seed, struct curve *out)
{
    if (isnan(param))
        param = family == CURVE_RANDOM ? RANDOM_USUAL
                                       : (float)response_family_usual((enum response_family)family);
    out->family = family;
    out->param = fminf(fmaxf(param, params[family].lo), params[family].hi);
    out->lo = LOW;
    out->hi = 0.0f;
    if (family == CURVE_RANDOM) {
        make_random(seed, out);
        return;
    }
    float last = 0.0f;
    for (int i = 0; i <= CURVE_STEPS; i++) {
        float y = (float)response_family_display((enum response_family)family, out->param,
                                                 step_position(out, i));
        last = fminf(fmaxf(y, last), 1.0f);
        out->table[i] = last;
    }
    out->table[CURVE_STEPS] = 1.0f;
}

void curve_draw(uint64_t seed, struct curve *out)
{
    static const enum curve_family family[] = {CURVE_SRGB,   CURVE_GAMMA, CURVE_FILMIC,
                                               CURVE_AGX,    CURVE_LOG,   CURVE_RANDOM,
                                               CURVE_RANDOM, CURVE_RANDOM};
    int n = (int)(sizeof family / sizeof family[0]);
    int k = (int)(variate_uniform(splitmix_mix(seed), 0) * n);
    enum curve_family f = family[k];
    float t = (float)variate_uniform(splitmix_mix(seed), 1);
    curve_make(f, params[f].lo + t * (params[f].hi - params[f].lo), seed + 1, out);
}

/* Exact to 1e-6, for x > 0 and normal: half of what libm takes. */
static float log2_fast(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits -= 0x3F3504F3u; // sqrt(1/2): the mantissa becomes sqrt(1/2)..sqrt(2)
    int e = (int)bits >> 23;
    bits = (bits & 0x7FFFFFu) + 0x3F3504F3u;
    float m;
    memcpy(&m, &bits, sizeof m);
    float s = (m - 1.0f) / (m + 1.0f), q = s * s; // 2 artanh(s) / ln 2
    return (float)e +
           s * (2.88539008f + q * (0.961796694f + q * (0.577078016f + q * 0.412198583f)));
}

float curve_display(const struct curve *c, float x)
{
    if (!(x > 0.0f))
        return 0.0f;
    if (x < 1e-30f)
        x = 1e-30f;
    float i = (log2_fast(x) - c->lo) * ((float)CURVE_STEPS / (c->hi - c->lo));
    if (i < 0.0f)
        return c->table[0] * x * exp2f(-c->lo);
    if (!(i < (float)CURVE_STEPS))
        return c->table[CURVE_STEPS];
    int k = (int)i;
    return c->table[k] + (i - (float)k) * (c->table[k + 1] - c->table[k]);
}

float curve_exposure(const struct curve *c, float display)
{
    if (!(display > 0.0f))
        return 0.0f;
    if (display <= c->table[0])
        return exp2f(c->lo) * display / c->table[0];
    int lo = 0, hi = CURVE_STEPS; // table[lo] < display <= table[hi], if it is reached at all
    while (hi - lo > 1) {
        int mid = (lo + hi) / 2;
        if (c->table[mid] < display)
            lo = mid;
        else
            hi = mid;
    }
    float t = fminf((display - c->table[lo]) / (c->table[hi] - c->table[lo]), 1.0f);
    return exp2f(c->lo + ((float)lo + t) * ((c->hi - c->lo) / CURVE_STEPS));
}
