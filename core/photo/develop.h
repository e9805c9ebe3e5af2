/* develop.h - camera numbers to a displayable picture, in one fixed recorded way for all frames of
 * a set: black level, white balance, demosaicing, the curve of sRGB.
 * Pure; any thread. */
#ifndef PHOTO_DEVELOP_H
#define PHOTO_DEVELOP_H

#include "core/photo/raw.h"

struct develop {
    float red, blue; // white balance, gains over green; 1 where the device has applied them
};

/* White balance by the mean of unclipped pixels of all frames (grey world), limited to 1/4..4. */
void develop_balance(const struct raw *frames, int n, struct develop *out);

/* px: (h, w, 3). Display values pass as they are; a mosaic is demosaiced (Malvar, He & Cutler,
 * ICASSP 2004), grey is repeated. Pixels that the sensor clips in all colours become white. */
void develop_run(const struct raw *in, const struct develop *how, uint8_t *px);

/* The same in 16 bits, 65535 is 1, for linear frames. */
void develop_run16(const struct raw *in, const struct develop *how, uint16_t *px);

/* Display value of light 0..1 by the curve of sRGB (IEC 61966-2-1) in 16 bits; a NaN is 0. */
uint16_t develop_srgb16(float v);

/* A mosaic whose rows are read, and its pixels written, by callbacks. */
struct develop_mosaic {
    enum raw_cfa cfa;
    int w, h;
    const void *ctx;
    /* v: numbers of the n sites from x on in row y. */
    void (*read)(const void *ctx, int y, int x, int n, float *v);
    /* rgb: three times n, for the pixels from x on in row y. */
    void (*write)(const void *ctx, int y, int x, int n, float *const rgb[3]);
};

/* Demosaic rows begin..end-1; the pixels of a row are written in several pieces. */
void develop_rows(const struct develop_mosaic *m, int begin, int end);

#endif
