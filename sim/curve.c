/* A curve is tabulated over u = log2 exposure, -24..0, and looked up with linear interpolation;
 * below the table the display value falls in proportion to the exposure, above it is the last one.
 * Every family gives 1 at exposure 1, where a linear sensor is full.
 *   SRGB    IEC 61966-2-1
 *   FILMIC  rational fit of the ACES curve (Narkowicz 2015), coded as sRGB; the shoulder grows with
 *           the exposure that is mapped to white
 *   AGX     sigmoid in u through a pivot 3.5 stops under white: a line of given slope there, bent
 *           to reach 1 at u = 0 and 0 at the end of the range (form of Troy Sobotka's AgX)
 *   LOG     log2(1 + a x) / log2(1 + a)
 *   RANDOM  integral over u of the slope of sRGB times exp(strength * s(u)), s a cubic B-spline
 *           with normal coefficients every 2 stops: monotone whatever the numbers are */
#include "sim/curve.h"

#include "sim/sensor.h"

#include <math.h>
#include <string.h>

#define LOW (-24.0)  // log2 exposure: even a power of 1/3 shows code 1 there
#define PIVOT (-3.5) // log2 exposure of AgX's pivot: headroom of usual JPEG cameras
#define PIVOT_DISPLAY 0.42
#define KNOT 2.0 // stops between coefficients of RANDOM
enum { KNOTS = 16 };

static const struct {
    float lo, hi, usual;
} params[CURVE_FAMILIES] = {[CURVE_GAMMA] = {1.6f, 3.0f, 2.2f},
                            [CURVE_FILMIC] = {0.0f, 1.0f, 0.5f},
                            [CURVE_AGX] = {8.0f, 16.0f, 12.0f},
                            [CURVE_LOG] = {3.0f, 12.0f, 8.0f},
                            [CURVE_RANDOM] = {0.0f, 1.5f, 0.5f}};

static double srgb(double x)
{
    return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055;
}

static double aces(double x)
{
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14);
}

static double filmic(double x, double param)
{
    double white = 0.5 * exp2(2.0 * param);
    return srgb(aces(white * x) / aces(white));
}

/* Rises from 0 with slope 1 and is 1 at `end` > 1. */
static double bend(double v, double end)
{
    double k = 1.0 - 1.0 / (end * end); // v / sqrt(1 + k v^2) is 1 at v = end
    return v / sqrt(1.0 + k * v * v);
}

static double agx(double u, double stops)
{
    double slope = 1.25 * (1.0 - PIVOT_DISPLAY) / -PIVOT; // display per stop, as steep as needed
    double toe = stops + PIVOT;                           // stops from the pivot to black
    if (u >= PIVOT)
        return PIVOT_DISPLAY +
               (1.0 - PIVOT_DISPLAY) * bend((u - PIVOT) * slope / (1.0 - PIVOT_DISPLAY), 1.25);
    double steep = fmax(slope * toe / PIVOT_DISPLAY, 1.01);
    double v = fmin((PIVOT - u) / toe, 1.0) * steep;
    return PIVOT_DISPLAY * (1.0 - bend(v, steep));
}

/* Cubic B-spline with coefficients c at every KNOT from LOW - KNOT on. */
static double spline(const double c[KNOTS], double u)
{
    double v = (u - LOW) / KNOT;
    int i = (int)fmin(fmax(floor(v), 0.0), KNOTS - 4);
    double t = v - i, s = 1.0 - t;
    return (s * s * s * c[i] + (4.0 + t * t * (3.0 * t - 6.0)) * c[i + 1] +
            (4.0 + s * s * (3.0 * s - 6.0)) * c[i + 2] + t * t * t * c[i + 3]) /
           6.0;
}

static double at(const struct curve *c, int i)
{
    return c->lo + (c->hi - c->lo) * (double)i / CURVE_STEPS;
}

static void make_random(uint64_t seed, struct curve *c)
{
    double k[KNOTS], sum[CURVE_STEPS + 1];
    for (int i = 0; i < KNOTS; i++)
        k[i] = c->param * sensor_normal(seed, (uint64_t)i);
    sum[0] = srgb(exp2(c->lo));
    for (int i = 1; i <= CURVE_STEPS; i++) {
        double u0 = at(c, i - 1), u1 = at(c, i);
        sum[i] = sum[i - 1] + (srgb(exp2(u1)) - srgb(exp2(u0))) * exp(spline(k, 0.5 * (u0 + u1)));
    }
    for (int i = 0; i <= CURVE_STEPS; i++)
        c->table[i] = (float)(sum[i] / sum[CURVE_STEPS]);
}

static double display_of(const struct curve *c, double u)
{
    double x = exp2(u);
    switch (c->family) {
    case CURVE_SRGB:
        return srgb(x);
    case CURVE_GAMMA:
        return pow(x, 1.0 / c->param);
    case CURVE_FILMIC:
        return filmic(x, c->param);
    case CURVE_AGX:
        return agx(u, c->param);
    case CURVE_LOG:
        return log2(1.0 + exp2(c->param) * x) / log2(1.0 + exp2(c->param));
    default:
        return x;
    }
}

void curve_make(enum curve_family family, float param, uint64_t seed, struct curve *out)
{
    if (isnan(param))
        param = params[family].usual;
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
        last = fminf(fmaxf((float)display_of(out, at(out, i)), last), 1.0f);
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
    int k = (int)(sensor_uniform(seed, 0) * n);
    enum curve_family f = family[k];
    float t = (float)sensor_uniform(seed, 1);
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
