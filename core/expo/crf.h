/* crf.h - response curve of a camera with 8-bit display values: recovery from a bracket, use.
 * Scale of exposure cannot be known: 1 is what the code 255 means (capture notes 4.6). */
#ifndef EXPO_CRF_H
#define EXPO_CRF_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct crf {
    float log2x[3][256]; // R,G,B: log2 of relative exposure of a code; rises strictly, 0 at 255
    float error;         // rms of log2 exposure on pixels held out of the fit; 0 if assumed
    bool known;          // recovered, not assumed
};

/* The curve of IEC 61966-2-1. */
void crf_srgb(struct crf *out);

/* Which one: DEBEVEC wherever there are the pixels for it, FAMILY where they are few, ROBERTSON as a
 * check that does not smooth. Exposures in unequal ratios (0, 1.4, 3.2, 5.4, 8 stops) determine the
 * curve several times better than equal ones.
 * Worst rms error of displayed values in % of full scale, scale aligned (tests/unit/crf_test.c):
 *   TABLE */
enum crf_method {
    CRF_FAMILY,   // gamma and a spline for toe and shoulder, 10 parameters
    CRF_DEBEVEC,  // Debevec & Malik, SIGGRAPH 1997, eq. 3
    CRF_ROBERTSON // Robertson, Borman & Stevenson, J. Electronic Imaging 12(2) 2003
};

/* Pictures of one still scene: n times w x h x 3 codes. */
struct crf_stack {
    int n, w, h;              // 2..9
    const uint8_t *const *px; // [n]
    const double *exposure;   // [n] > 0, not all equal
};

/* Scratch bytes of crf_recover. */
size_t crf_plan(const struct crf_stack *s);

/* tmp: crf_plan bytes, 64-aligned.
 * err:  ERR_ARG (names field and bound), ERR_LIMIT (too few pixels that are neither dark nor
 *       clipped in two pictures; says how many there are and are needed). On error *out is sRGB. */
MUST_USE err_t crf_recover(enum crf_method method, const struct crf_stack *s, void *tmp,
                           struct crf *out);

#endif
