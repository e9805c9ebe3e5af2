/* imgsize.h - width and height of a PNG, JPEG or OpenEXR file, upright, from its header, without
 * decoding. With it a whole set is planned before the first pixel is decoded. The kind follows from
 * the bytes. Sources: PNG (ISO 15948) 11.2.2; JPEG (ITU-T T.81) B.1.1.3, B.2.2.
 * thread: any. */
#ifndef FORMAT_IMGSIZE_H
#define FORMAT_IMGSIZE_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>

/* out:  *w, *h >= 1.
 * err:  ERR_IO, ERR_FORMAT (also: above IMG_FILE_MAX bytes or IMG_SIDE_MAX px). */
MUST_USE err_t imgsize_read(const char *path, int *w, int *h);

/* Whether the bytes begin as those of an OpenEXR file. */
bool imgsize_is_exr(const void *p, size_t n);

/* Orientation of a file by img_orientation.
 * err:  ERR_IO, ERR_FORMAT (above IMG_FILE_MAX bytes). */
MUST_USE err_t imgsize_orientation(const char *path, int *orientation);

/* As imgsize_read, from n bytes; `what` begins the sentence. */
MUST_USE err_t imgsize_parse(const char *what, const void *p, size_t n, int *w, int *h);

#endif
