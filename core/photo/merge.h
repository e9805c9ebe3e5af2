/* merge.h - a bracket of one camera to linear radiance: maximum likelihood under photon noise,
 * sum of counts over sum of exposures of the pixels that are not clipped (Hanji, Zhong & Mantiuk,
 * ICCP 2020).
 * Radiance is relative: 1 saturates in 1 s at gain 1.
 * Pure; any thread. */
#ifndef PHOTO_MERGE_H
#define PHOTO_MERGE_H

#include "core/base/types.h"
#include "core/photo/crf.h"
#include "core/photo/develop.h"
#include "core/photo/ghost_mask.h"

/* Frames of one size and kind. */
struct merge_set {
    const struct raw *frames; // (n)
    int n;                    // 1..MERGE_FRAMES_MAX
    const double *exposure_s; // (n) time x gain, > 0
    const struct crf *crf;    // response of display values; NULL: sRGB
    const struct develop *how;
    const struct ghost_mask *moved; // (n) pixels of frames that do not count; one without `moved`
                                    // counts everywhere; NULL: all do
};

enum { MERGE_FRAMES_MAX = 9 };

/* Rows begin..end-1 of `out` (3 planes) are written: finite, >= 0. Pixels that are clipped in all
 * frames get the least radiance that explains it, those dark in all the value of the longest. */
void merge_rows(const struct merge_set *s, int begin, int end, struct image *out);

#endif
