/* photofile.h - files of photographs that a library of their own decodes, into 16 bits: TIFF, HEIC
 * and raw. PNG, JPEG and OpenEXR are elsewhere (img.h, exrfile.h). thread: any. */
#ifndef FORMAT_PHOTOFILE_H
#define FORMAT_PHOTOFILE_H

#include "core/base/types.h"
#include "drivers/format/img.h"

struct photofile {
    bool (*is)(const void *bytes, size_t n);
    err_t (*look)(const void *bytes, size_t n, const char *name, struct img_info *out);
    err_t (*read)(const void *bytes, size_t n, const char *name, struct image16 *out);
    bool linear; // its values are the sensor's, which read puts through the curve of sRGB
};

/* By the first bytes; NULL: none of these. */
const struct photofile *photofile_of(const void *bytes, size_t n);

#endif
