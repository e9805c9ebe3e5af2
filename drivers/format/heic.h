/* heic.h - photographs of telephones in HEIC files (ISO 23008-12 with HEVC), by libheif: the
 * primary picture, 8 to 12 bits, upright as its transformations say; depth maps, gain maps and
 * films beside it are left out. Files are hostile until checked, as in img.h.
 * thread: any. */
#ifndef FORMAT_HEIC_H
#define FORMAT_HEIC_H

#include "core/base/types.h"
#include "drivers/format/img.h"

/* Whether the first bytes are those of such a file (brands heic, heix, heim, heis, mif1). */
bool heic_is(const void *bytes, size_t n);

/* err:  ERR_FORMAT (not as above; damaged; above IMG_SIDE_MAX or IMG_PX_MAX, or more than so few
 *       bytes can hold), ERR_NOMEM. On error *out is zeroed. `name` begins the sentence. */
MUST_USE err_t heic_look(const void *bytes, size_t n, const char *name, struct img_info *out);

/* Display values; 8 to 12 bits become 16. Alpha is left out, colour profiles are ignored.
 * own:  free(out->px).
 * err:  as heic_look; ERR_UNSUPPORTED where libheif came without a decoder. On error *out is
 *       zeroed. */
MUST_USE err_t heic_read(const void *bytes, size_t n, const char *name, struct image16 *out);

#endif
