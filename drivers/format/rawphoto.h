/* rawphoto.h - raw photographs of cameras, unpacked by LibRaw and developed as frames of our own
 * cameras: DNG, CR2, NEF, ARW and others that are TIFF outside, with a Bayer mosaic. Files are
 * hostile until checked, as in img.h.
 * thread: any. */
#ifndef FORMAT_RAWPHOTO_H
#define FORMAT_RAWPHOTO_H

#include "core/base/types.h"
#include "drivers/format/img.h"

/* Whether the first bytes may be those of such a file. */
bool rawphoto_is(const void *bytes, size_t n);

/* err:  ERR_FORMAT (LibRaw does not know it; no Bayer mosaic; above IMG_SIDE_MAX or IMG_PX_MAX, or
 *       more than so few bytes can hold), ERR_NOMEM. On error *out is zeroed. `name` begins the
 *       sentence. */
MUST_USE err_t rawphoto_look(const void *bytes, size_t n, const char *name, struct img_info *out);

/* Black level off, white balance as the camera set it, colours of the sensor, demosaiced, upright,
 * through the curve of sRGB in 16 bits: 65535 is where the sensor is full, the white level of the
 * file. An odd last row or column is left out.
 * own:  free(out->px).
 * err:  as rawphoto_look; data that are cut off; levels that cannot be (as rawframe_develop). On
 *       error *out is zeroed. */
MUST_USE err_t rawphoto_read(const void *bytes, size_t n, const char *name, struct image16 *out);

#endif
