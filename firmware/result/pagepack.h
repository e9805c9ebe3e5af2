/* pagepack.h - the splats of view.html in 13 bytes each, and 8 to 9 for harmonics of degree 3:
 * coarser steps, neighbours in space one after the other, bytes of like meaning together,
 * and gzip around all of it. firmware/web/unpack.js makes of them what pagesplats.h describes.
 *
 * A gzip stream of the `first` splats, which are the most important ones of a large scene, and one
 * of the rest, if there are more: a page shows the first ones while it still reads. A stream is
 * fields, each of n numbers; a number is a whole one, and a field has the lowest byte of all its
 * numbers first, then the next one of all. Z: stored as 2 v, or -2 v - 1 if v < 0.
 *   x, y, z           3 bytes, Z: difference to the splat before, of steps s;
 *                     position = at + reach sinh(step (low + s)): far splats, such as the sky's,
 *                     have long steps
 *   log_scale[3], logit    2 bytes: the numbers of pagesplats.h
 *   q[3]              2 bytes, Z: (bits 0-14 - 16383) / PAGEPACK_QUAT, rounded
 *   bits 15 of q      1 byte: those of q[0], q[1], q[2] in bits 0, 1, 2
 *   light             2 bytes: green; then Z of red - green; Z of blue - green
 *   harmonics         2 bytes, Z: each over `sh`, coefficient by coefficient, red, green, blue
 * thread: any. */
#ifndef RESULT_PAGEPACK_H
#define RESULT_PAGEPACK_H

#include "firmware/result/pagesplats.h"

enum {
    PAGEPACK_QUAT = 64,       // steps of pagesplats.h in one of these
    PAGEPACK_FIRST = 1 << 17, // splats shown first, in scenes of more than twice as many
};

/* Least steps of scales, logits and log radiance: tests/measured.md has what others cost. */
#define PAGEPACK_STEP (1.0 / 48)

struct pagepack {
    double at[3], reach, step; // of positions
    int low[3];
    double sh;         // step of harmonics
    int first;         // n: all
    char *bytes;       // the streams, one after the other
    size_t n_bytes[2]; // 0: there is none
};

/* own:  pagepack_free.
 * err:  ERR_NOMEM. */
MUST_USE err_t pagepack_run(const struct pagesplats *p, struct pagepack *out);

/* Bytes that pagepack_run takes for n splats of a degree, the result's among them, at most. */
size_t pagepack_plan(int n, int degree);

/* Accepts a zeroed one. */
void pagepack_free(struct pagepack *p);

#endif
