/* develop.h - camera numbers to a displayable picture, in one fixed recorded way for all frames of
 * a set: black level, white balance, demosaicing, the curve of sRGB.
 * Pure; any thread. */
#ifndef EXPO_DEVELOP_H
#define EXPO_DEVELOP_H

#include "core/expo/raw.h"

struct develop {
    float red, blue; // white balance, gains over green; 1 where the device has done it
};

/* White balance by the mean of unclipped pixels of all frames (grey world), limited to 1/4..4. */
void develop_balance(const struct raw *frames, int n, struct develop *out);

/* px: (h, w, 3). Display values pass as they are; a mosaic is demosaiced (Malvar, He & Cutler,
 * ICASSP 2004), grey is repeated. */
void develop_run(const struct raw *in, const struct develop *how, uint8_t *px);

#endif
