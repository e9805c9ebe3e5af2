/* ghost_shrink.h - frames of many pixels are compared smaller (ghost.h): what moves is large, and
 * the time goes with the pixels.
 * Pure; any thread. */
#ifndef PHOTO_GHOST_SHRINK_H
#define PHOTO_GHOST_SHRINK_H

#include "core/photo/ghost_mask.h"
#include "core/photo/raw.h"

/* A k-th of the size, k 1 or more: the means of k x k pixels, of a mosaic of pixels of one colour,
 * in the memory that r has; where one of them is clipped the mean is, too. Rests at the right and
 * below are dropped. */
void ghost_shrink_frame(struct raw *r, int k);

/* The mask of frames that were shrunk, for those before. */
void ghost_shrink_undo(struct ghost_mask *m, int k);

#endif
