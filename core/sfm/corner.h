/* corner.h - features of a photograph that hardly depend on its exposure: a pyramid of smoothed
 * grey values, corners spread over it, and a descriptor of the surroundings of each corner.
 * Pure computation; any thread. */
#ifndef SFM_CORNER_H
#define SFM_CORNER_H

#include "core/base/types.h"

enum {
    CORNER_LEVELS = 6, // of the pyramid, each smaller by sqrt(2)
    CORNER_FOUND = 4,  // levels that are searched for corners, from the finest on
    CORNER_DESCRIPTOR =
        256,              // numbers of a descriptor: two surroundings of 4 x 4 cells x 8 directions
    CORNER_MAX = 2560,    // corners of a view
    CORNER_SIZE_MIN = 64, // px, of a view
    CORNER_TURNS = 8,     // directions that a descriptor can be turned to
    CORNER_TILTS = 4,     // directions that a view is stretched in
    CORNER_WARPS = 2 + CORNER_TILTS, // stored descriptors of a corner
    CORNER_BINS = 8                  // of brightness, for the noise
};

/* One size of a view. Pixel (i, j) of the level lies at scale (i + 0.5, j + 0.5) px of the view. */
struct corner_level {
    int w, h;      // px
    float scale;   // px of the view in a pixel of the level
    float *light;  // (h, w) logarithm of the grey value, 0..1, smoothed
    float *weight; // (h, w) 0 black, saturated or masked .. 1
};

struct corner {
    float u, v;     // px of the view
    float strength; // smaller eigenvalue of the structure tensor over the part from noise
    int level;
};

/* Data of one view for matching. */
struct corner_view {
    struct corner_level level[CORNER_LEVELS];
    float noise[CORNER_BINS]; // deviation of light before smoothing, by light from 0 to 1
    int n;
    struct corner *at; // (corner_cap)
    /* Upright; view turned by an eighth; then, after corner_tilt, view stretched in one direction
     * each as if it were seen from another side. */
    int8_t *descriptor[CORNER_WARPS]; // (corner_cap, CORNER_DESCRIPTOR)
    int32_t *square[CORNER_WARPS];    // (corner_cap) sums of the squares of these
};

/* Most corners of a view whose longest edge is `size` px. */
int corner_cap(int size);

/* Memory of a view of w x h px.
 * err:  ERR_NOMEM. */
MUST_USE err_t corner_alloc(struct arena *keep, int w, int h, struct corner_view *out);

/* Scratch of corner_run for a view of so many pixels: floats. */
size_t corner_scratch(size_t pixels);

/* The descriptor of corner k as if the view were turned by `turn` eighths of a full turn, from x to
 * y. Returns the stored one, or `room`, CORNER_DESCRIPTOR numbers; *square is their sum of
 * squares. */
const int8_t *corner_turned(const struct corner_view *c, int k, int turn, int8_t *room,
                            int32_t *square);

/* Pyramid, corners and descriptors, but those of corner_tilt. rgb: (h, w, 3).
 * masked:  (h, w) 1: counts as black; NULL: nothing does.
 * scratch: (corner_scratch). */
void corner_run(const uint8_t *rgb, const uint8_t *masked, float *scratch, struct corner_view *out);

/* After corner_run: descriptors of the stretched views. */
void corner_tilt(struct corner_view *c);

#endif
