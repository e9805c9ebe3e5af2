/* apriltags.h - tags of the family tag36h11 in pictures, through AprilTag 3 (Krogius et al.,
 * "Flexible layouts for fiducial tags", IROS 2019), and how they look.
 * thread: any. */
#ifndef FORMAT_APRILTAGS_H
#define FORMAT_APRILTAGS_H

#include "core/base/types.h"

enum { APRILTAGS_EDGE = 8, APRILTAGS_FAMILY = 587, APRILTAGS_MAX = 1024 };

struct apriltags_tag {
    int id, wrong_bits;  // corrected, 0 or 1
    float margin;        // of its bits against black or white, 8-bit levels: contrast
    double corner[4][2]; // px, pixel centres at .5: upper left, upper right, lower right, lower
                         // left of the tag as it is printed
};

/* The cells of a tag, border included: 1 white, 0 black; row 0 on top.
 * err:  ERR_NOMEM. */
MUST_USE err_t apriltags_cells(int id, uint8_t out[APRILTAGS_EDGE][APRILTAGS_EDGE]);

/* What is needed to find tags. */
struct apriltags;
MUST_USE err_t apriltags_open(struct apriltags **out);
void apriltags_close(struct apriltags *a); // accepts NULL

/* Find tags; those of `grey`, (h, w), whose quads are whole. Corners are the intersections of lines
 * along the edges.
 * out:  (APRILTAGS_MAX), sorted by id, *n of them
 * err:  ERR_ARG (a picture below 16 px), ERR_NOMEM. */
MUST_USE err_t apriltags_find(struct apriltags *a, const uint8_t *grey, int w, int h,
                              struct apriltags_tag *out, int *n);

#endif
