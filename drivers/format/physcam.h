/* physcam.h - which physical camera took a photograph, and what its metadata says about the lens.
 * thread: any. */
#ifndef FORMAT_PHYSCAM_H
#define FORMAT_PHYSCAM_H

#include "core/base/types.h"

/* Which photographs share a lens. */
enum physcam_rule {
    PHYSCAM_EXIF, // those with the same camera, lens and focal length in EXIF, and the same size;
                  // without EXIF those of one size
    PHYSCAM_SIZE, // those of one size
    PHYSCAM_EACH, // none: each has its own
};

/* Set camera_id, focal_px and turned of a shot whose name and taken size are set.
 * err:  ERR_IO, ERR_NOMEM. */
MUST_USE err_t physcam_read(const char *path, enum physcam_rule rule, struct shot *s);

#endif
