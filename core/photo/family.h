/* family.h - known families of camera response curves: log2 exposure (0 where a linear sensor is
 * full) to display value 0..1. Pure functions; any thread. */
#ifndef PHOTO_FAMILY_H
#define PHOTO_FAMILY_H

enum family {
    FAMILY_LINEAR,
    FAMILY_SRGB,   // IEC 61966-2-1, clipped at 1
    FAMILY_GAMMA,  // power 1 / param
    FAMILY_FILMIC, // toe and shoulder, rational; param 0..1: strength of the shoulder
    FAMILY_AGX,    // sigmoid in log2 exposure, as AgX-like view transforms; param: stops of range
    FAMILY_LOG,    // camera logs: log2(1 + a x) / log2(1 + a); param: log2 a
    FAMILIES
};

/* For people: "sRGB", "gamma", ... */
const char *family_name(enum family f);

/* Display value at u: rises, 1 from u = 0 on. param: where the family has one. */
double family_display(enum family f, double param, double u);

/* The usual parameter; 0 where there is none. */
double family_usual(enum family f);

#endif
