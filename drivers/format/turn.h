/* turn.h - pictures turned upright, as the EXIF orientation says (CIPA DC-008 4.6.4): 1, upright,
 * to 8; from 5 on width and height are exchanged. Pure; any thread. */
#ifndef FORMAT_TURN_H
#define FORMAT_TURN_H

#include <stddef.h>

/* in: (h, w) pixels of `bytes` each; out: the same, upright. */
void turn_upright(int orientation, const void *in, int w, int h, size_t bytes, void *out);

#endif
