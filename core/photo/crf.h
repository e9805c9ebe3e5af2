/* crf.h - response curve of a camera with 8-bit display values, recovered from a bracket.
 * The scale of exposure cannot be known: 1 is the exposure of code 255 (core/photo/README.md 2.3),
 * extrapolated from the codes below it, mostly within 0.1 stop.
 * Pure; any thread. */
#ifndef PHOTO_CRF_H
#define PHOTO_CRF_H

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

/* FAMILY is the usual choice: it needs the fewest pixels and also works where exposures have equal
 * ratios. DEBEVEC suits thousands of pixels and unequal ratios (0, 1.4, 3.2, 5.4, 8 stops) of a
 * curve with bends that the family lacks; its `error` is smaller there. ROBERTSON likewise, without
 * smoothing.
 * Worst rms error of displayed values, % of full scale, scale aligned
 * (tests/unit/core/photo/crf_test.c: five noisy pictures):
 *                       linear  sRGB  gamma  filmic   AgX   log  random
 *   unequal FAMILY      0.12  0.04   0.06    0.05  0.04  0.14    0.70
 *           DEBEVEC     0.22  0.07   0.11    0.09  0.08  0.18    0.24
 *           ROBERTSON   0.25  0.09   0.14    0.12  0.10  0.19    0.28
 *   equal   FAMILY      0.16  0.06   0.07    0.08  0.29  0.11    0.85
 *           DEBEVEC     1.08  0.15   0.51    0.23  0.30  0.22    1.88
 *           ROBERTSON   0.70  0.10   0.25    0.14  0.28  0.22    1.11
 * Two pictures, sRGB: up to 4. */
enum crf_method {
    CRF_FAMILY,   // gamma and a spline for toe and shoulder, 10 parameters
    CRF_DEBEVEC,  // Debevec & Malik, SIGGRAPH 1997, eq. 3
    CRF_ROBERTSON // Robertson, Borman & Stevenson, J. Electronic Imaging 12(2) 2003
};

/* n pictures of one still scene, (h, w, 3) codes each. */
struct crf_stack {
    int n, w, h;              // 2..9
    const uint8_t *const *px; // [n]
    const double *exposure;   // [n] > 0, not all equal
};

/* Scratch bytes of crf_recover. */
size_t crf_plan(const struct crf_stack *s);

/* tmp: crf_plan bytes, 64-aligned.
 * err:  ERR_ARG (names field and bound), ERR_LIMIT (too few pixels that are neither dark nor
 *       clipped in two pictures, or too narrow a range of codes; the sentence has both numbers).
 *       On error *out is sRGB. */
MUST_USE err_t crf_recover(enum crf_method method, const struct crf_stack *s, void *tmp,
                           struct crf *out);

#endif
