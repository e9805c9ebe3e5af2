/* tiff.h - photographs in TIFF files, by libtiff: 8 or 16 bits, grey or colour, strips or tiles,
 * any compression that the library has. Files are hostile until checked, as in img.h.
 * thread: any. */
#ifndef FORMAT_TIFF_H
#define FORMAT_TIFF_H

#include "core/base/types.h"
#include "drivers/format/img.h"

/* Whether the bytes are those of a TIFF file whose first image is a picture in colour or grey: raw
 * photographs are TIFF outside too, with a mosaic or a thumbnail there. */
bool tiff_is(const void *bytes, size_t n);

/* err:  ERR_FORMAT (not as above; above IMG_SIDE_MAX or IMG_PX_MAX, or more than so few bytes can
 *       hold), ERR_NOMEM. On error *out is zeroed. `name` begins the sentence. */
MUST_USE err_t tiff_look(const void *bytes, size_t n, const char *name, struct img_info *out);

/* Display values, upright; 8 bits become 16. Alpha is left out.
 * own:  free(out->px).
 * err:  as tiff_look; data that are cut off. On error *out is zeroed. */
MUST_USE err_t tiff_read(const void *bytes, size_t n, const char *name, struct image16 *out);

#endif
