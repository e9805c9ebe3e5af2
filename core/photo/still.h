/* still.h - whether a camera stood still between two photographs at different exposures, as on a
 * tripod. What one has for each value of the other makes them alike; in squares with texture their
 * shift then follows by least squares (Lucas and Kanade, 1981).
 * Pure functions; any thread. */
#ifndef PHOTO_STILL_H
#define PHOTO_STILL_H

#include "core/base/types.h"

#include <stdbool.h>

enum { STILL_EDGE = 448 }; // px, longest edge that is compared

/* Size of a photograph (3 channels) as it is compared: channels 1, px NULL. */
struct image8 still_size(int w, int h);

/* Green of a photograph, means of squares, into out->px (h, w) of still_size. */
void still_shrink(const struct image8 *photo, struct image8 *out);

/* Both of still_shrink, of one size. True: at least 6 squares of 32 px have texture that neither
 * photograph clips, and three fifths of them moved by less than a fifth of a pixel; the rest may
 * be people. */
bool still_same(const struct image8 *a, const struct image8 *b);

#endif
