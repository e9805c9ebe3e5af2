/* turn.h - pictures turned upright, as the EXIF orientation says (CIPA DC-008 4.6.4): 1, upright,
 * to 8; from 5 on width and height are exchanged. thread: any. */
#ifndef FORMAT_TURN_H
#define FORMAT_TURN_H

#include "core/base/types.h"

#include <stddef.h>

/* in: (h, w) pixels of `bytes` each; out: the same, upright. */
void turn_upright(int orientation, const void *in, int w, int h, size_t bytes, void *out);

/* Turn *io, whose px are replaced by others of malloc; `name` begins the sentence.
 * err:  ERR_NOMEM; *io is unchanged then. */
MUST_USE err_t turn_image16(int orientation, const char *name, struct image16 *io);

#endif
