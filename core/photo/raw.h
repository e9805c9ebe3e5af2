/* raw.h - the numbers of one camera frame, unpacked. */
#ifndef PHOTO_RAW_H
#define PHOTO_RAW_H

#include <stdbool.h>
#include <stdint.h>

enum raw_cfa { RAW_MONO, RAW_RGB, RAW_RGGB, RAW_BGGR, RAW_GRBG, RAW_GBRG }; // first 2x2 by rows

struct raw {
    int w, h; // px; even for a mosaic
    enum raw_cfa cfa;
    int bits, black; // codes are 0 .. 2^bits - 1; the code of no light
    bool linear;     // code - black is proportional to exposure; else codes are display values
    uint16_t *px;    // (h, w), or (h, w, 3) for RAW_RGB; row 0 on top
};

/* First code that counts as clipped (core/photo/README.md 3): for linear numbers at 0.9 of
 * the range, above which sensors are not linear. */
static inline int raw_clip(const struct raw *r)
{
    return r->linear ? r->black + ((1 << r->bits) - 1 - r->black) * 9 / 10 : 246;
}

/* Colour of a site of a mosaic: 0 red, 1 green, 2 blue. */
static inline int raw_colour(enum raw_cfa cfa, int y, int x)
{
    int c = (y & 1) + ((x & 1) ^ (cfa == RAW_GRBG || cfa == RAW_GBRG)); // as if red were first
    return cfa == RAW_BGGR || cfa == RAW_GBRG ? 2 - c : c;
}

#endif
