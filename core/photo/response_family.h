/* response_family.h - known families of camera response curves: log2 exposure (0 where a linear
 * sensor is full) to display value 0..1. Pure functions; any thread. */
#ifndef PHOTO_RESPONSE_FAMILY_H
#define PHOTO_RESPONSE_FAMILY_H

enum response_family {
    RESPONSE_FAMILY_LINEAR,
    RESPONSE_FAMILY_SRGB,   // IEC 61966-2-1, clipped at 1
    RESPONSE_FAMILY_GAMMA,  // power 1 / param
    RESPONSE_FAMILY_FILMIC, // toe and shoulder, rational; param 0..1: strength of the shoulder
    RESPONSE_FAMILY_AGX,    // sigmoid in log2 exposure, as AgX-like view transforms; param: stops
    RESPONSE_FAMILY_LOG,    // camera logs: log2(1 + a x) / log2(1 + a); param: log2 a
    RESPONSE_FAMILIES
};

/* Name to print: "sRGB", "gamma", ... */
const char *response_family_name(enum response_family f);

/* Display value at u: rises, 1 from u = 0 on. param: where the family has one. */
double response_family_display(enum response_family f, double param, double u);

/* The usual parameter; 0 where there is none. */
double response_family_usual(enum response_family f);

#endif
