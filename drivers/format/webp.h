/* webp.h - WebP pictures (RFC 9649) through libwebp: four bytes a pixel, as splats in SOG keep
 * their numbers. Files are hostile until checked.
 * thread: any. */
#ifndef FORMAT_WEBP_H
#define FORMAT_WEBP_H

#include "core/base/err.h"

#include <stddef.h>
#include <stdint.h>

struct webp_picture {
    int w, h;    // px
    uint8_t *px; // (h, w, 4) R,G,B,A; alpha 255 where the file has none
};

/* Width and height by the header; `name` begins the sentence.
 * err:  ERR_FORMAT. On error both are 0. */
MUST_USE err_t webp_size(const char *name, const void *bytes, size_t n, int *w, int *h);

/* Decode a picture of at most px_max pixels. libwebp takes as much memory again meanwhile.
 * own:  free(out->px).
 * err:  ERR_FORMAT (larger; damaged; cut off; moving pictures), ERR_NOMEM. On error *out is zeroed.
 */
MUST_USE err_t webp_read(const char *name, const void *bytes, size_t n, size_t px_max,
                         struct webp_picture *out);

#endif
