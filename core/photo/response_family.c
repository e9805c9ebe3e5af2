/* Every family gives 1 at exposure 1, where a linear sensor is full.
 *   SRGB    IEC 61966-2-1
 *   FILMIC  rational fit of the ACES curve (Narkowicz 2015), coded as sRGB; the shoulder grows with
 *           the exposure that is mapped to white
 *   AGX     sigmoid in u through a pivot 3.5 stops under white: a line of given slope there, bent
 *           to reach 1 at u = 0 and 0 at the end of the range (form of Troy Sobotka's AgX)
 *   LOG     log2(1 + a x) / log2(1 + a) */
#include "core/photo/response_family.h"

#include <math.h>

#define PIVOT (-3.5) // log2 exposure of AgX's pivot: headroom of usual JPEG cameras
#define PIVOT_DISPLAY 0.42

static const struct {
    const char *name;
    double usual;
} families[RESPONSE_FAMILIES] = {
    [RESPONSE_FAMILY_LINEAR] = {"linear", 0}, [RESPONSE_FAMILY_SRGB] = {"sRGB", 0},
    [RESPONSE_FAMILY_GAMMA] = {"gamma", 2.2}, [RESPONSE_FAMILY_FILMIC] = {"filmic", 0.5},
    [RESPONSE_FAMILY_AGX] = {"AgX", 12},      [RESPONSE_FAMILY_LOG] = {"log", 8}};

const char *response_family_name(enum response_family f)
{
    return families[f].name;
}

double response_family_usual(enum response_family f)
{
    return families[f].usual;
}

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
static double saturating_curve(double v, double end)
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
               (1.0 - PIVOT_DISPLAY) *
                   saturating_curve((u - PIVOT) * slope / (1.0 - PIVOT_DISPLAY), 1.25);
    double steep = fmax(slope * toe / PIVOT_DISPLAY, 1.01);
    double v = fmin((PIVOT - u) / toe, 1.0) * steep;
    return PIVOT_DISPLAY * (1.0 - saturating_curve(v, steep));
}

double response_family_display(enum response_family f, double param, double u)
{
    double x = exp2(u);
    if (u >= 0)
        return 1;
    switch (f) {
    case RESPONSE_FAMILY_SRGB:
        return srgb(x);
    case RESPONSE_FAMILY_GAMMA:
        return pow(x, 1.0 / param);
    case RESPONSE_FAMILY_FILMIC:
        return filmic(x, param);
    case RESPONSE_FAMILY_AGX:
        return agx(u, param);
    case RESPONSE_FAMILY_LOG:
        return log2(1.0 + exp2(param) * x) / log2(1.0 + exp2(param));
    default:
        return x;
    }
}
