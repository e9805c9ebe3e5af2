/* ghost.h - what moved between the exposures of one bracket: frames are compared with a reference
 * frame, brought to its exposure. A small shift of a whole frame, as of a shaken stand, is found
 * first and is no movement.
 * Pure; any thread. */
#ifndef PHOTO_GHOST_H
#define PHOTO_GHOST_H

#include "core/base/arena.h"
#include "core/photo/merge.h"

enum { GHOST_SHIFT_MAX = 8 }; // px (of a mosaic: cells of 2 x 2) along each axis

/* The frame that says most: the fewest pixels are clipped or lost in noise. */
int ghost_reference(const struct merge_set *s);

/* Compare all frames with one of them.
 * a:    the masks lie in it; the rest is given back.
 * out:  (s->n); nothing moved in the reference itself.
 * err:  ERR_NOMEM (see ghost_plan). */
MUST_USE err_t ghost_run(struct arena *a, const struct merge_set *s, int reference,
                         struct ghost_mask *out);

/* Bytes that ghost_run takes for n frames like this one; SIZE_MAX on overflow. */
size_t ghost_plan(const struct raw *frame, int n);

#endif
