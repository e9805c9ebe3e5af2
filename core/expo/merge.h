/* merge.h - a bracket of one camera to linear radiance: maximum likelihood under photon noise,
 * sum of counts over sum of exposures of the pixels that are not clipped (Hanji, Zhong & Mantiuk,
 * ICCP 2020).
 * Radiance is relative: 1 saturates in 1 s at gain 1.
 * Pure; any thread. */
#ifndef EXPO_MERGE_H
#define EXPO_MERGE_H

#include "core/expo/crf.h"
#include "core/expo/develop.h"
#include "core/types.h"

/* n frames of one size and kind, 1..9, at exposures (time x gain, s). Rows begin..end-1 of `out`
 * (3 planes) are written; crf is for display values, NULL: sRGB. Pixels that are clipped in all
 * frames get the least radiance that explains it, those dark in all what the longest says. */
void merge_rows(const struct raw *frames, int n, const double *exposure_s, const struct crf *crf,
                const struct develop *how, int begin, int end, struct image *out);

#endif
