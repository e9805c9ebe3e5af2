/* rawphoto.h - raw photographs of cameras, unpacked by LibRaw and developed as frames of our own
 * cameras: DNG, CR2, NEF, ARW and others that are TIFF outside, with a Bayer mosaic. Files are
 * hostile until checked, as in img.h.
 * thread: any. */
#ifndef FORMAT_RAWPHOTO_H
#define FORMAT_RAWPHOTO_H

#include "core/base/types.h"

struct rawphoto_info {
    int w, h;             // px, upright
    double seconds;       // exposure time; 0: not in the file, as the next three
    double iso, f_number; //
    double focal_35mm;
    char camera[NAME_CAP]; // make, model, focal length; printable
};

/* Whether the first bytes may be those of such a file. */
bool rawphoto_is(const void *bytes, size_t n);

/* err:  ERR_FORMAT (LibRaw does not know it; no Bayer mosaic; above IMG_SIDE_MAX or IMG_PX_MAX), ERR_NOMEM. On error
 *       *out is zeroed. `name` begins the sentence. */
MUST_USE err_t rawphoto_look(const void *bytes, size_t n, const char *name,
                             struct rawphoto_info *out);

/* Black level off, white balance as the camera set it, colours of the sensor, demosaiced, upright,
 * through the curve of sRGB in 16 bits: 65535 is where the sensor is full (white level of the file).
 * An odd last row or column is left out.
 * own:  free(out->px).
 * err:  as rawphoto_look, also data that are cut off, and levels that cannot be (see rawframe_develop). On error *out is zeroed. */
MUST_USE err_t rawphoto_read(const void *bytes, size_t n, const char *name, struct image16 *out);

#endif
