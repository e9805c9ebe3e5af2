/* pagesplats.h - the splats of view.html, as firmware/web/splats.js reads them: whole steps of a
 * few numbers. Little-endian, in base64.
 * Those that are never drawn (a number that is not finite,
 * opacity below 1/255) are left out.
 *
 * Lossless, first 32 bytes for each splat:
 *   float x, y, z
 *   uint16 log_scale[3], logit            lo + step * value, with lo and step in the page
 *   uint16 q[3]                           of the unit quaternion w,x,y,z all but the largest, which
 *                                         is positive: bits 0-14 are (value / sqrt(1/2) + 1) 16383;
 *                                         bit 15 of q[0] and q[1]: which one is the largest, of
 *                                         q[2]: the splat is a guess (core/refine/confidence.h)
 *   uint16 light[3]                       natural-log radiance of degree 0: lo + step * value
 * then for each splat the harmonics above degree 0 as half floats, coefficient by coefficient, red,
 * green, blue, filled up to 16 bytes. Radiance of 1e-4 to 1e5 is kept to 2e-4 of its value, scales
 * likewise. The other kind is that of pagepack.h.
 * thread: any. */
#ifndef RESULT_PAGESPLATS_H
#define RESULT_PAGESPLATS_H

#include "firmware/result/pagetext.h"

#include "core/base/types.h"

enum {
    PAGESPLATS_SCALE, // 3, from here on
    PAGESPLATS_LOGIT = 3,
    PAGESPLATS_QUAT, // 3
    PAGESPLATS_LIGHT = 7,
    PAGESPLATS_NUMBERS = 10,
    PAGESPLATS_TEXEL = 16, // bytes
    PAGESPLATS_BYTES = 32, // lossless, without harmonics
};

struct pagesplats_range {
    double lo, step;
};

struct pagesplats {
    const struct scene *scene;
    int n, degree; // splats and harmonics that the page holds
    struct pagesplats_range scale, logit, light;
    double unit; // the page divides radiance by this power of two, so that the brightest splat fits
                 // into the half floats of its picture; but 24 stops over the middle of the tone
                 // curve have to do, else one wrong splat would leave nothing for the rest
};

/* Bytes of the harmonics of a splat, lossless. */
int pagesplats_sh_bytes(int degree);

bool pagesplats_is_drawn(const struct gaussians *g, int i);
bool pagesplats_is_guess(const struct scene *s, int i);

/* step: the least step of scales, logits and light; it grows where 16 bits would not do. */
void pagesplats_plan(const struct scene *s, int degree, double step, struct pagesplats *out);

/* The numbers of splat i in the order of the list above, without its position. */
void pagesplats_numbers(const struct pagesplats *p, int i, uint16_t out[PAGESPLATS_NUMBERS]);

/* Write all of them, lossless. */
void pagesplats_put(const struct pagesplats *p, struct pagetext *out);

#endif
