/* thumbnail.h - small JPEGs of pictures, for pages that show many.
 * thread: any. */
#ifndef FORMAT_THUMBNAIL_H
#define FORMAT_THUMBNAIL_H

#include "core/base/types.h"

enum { THUMBNAIL_EDGE = 256 }; // px of the longer side at most

/* Bytes of one of a picture of w x h px at most. */
uint64_t thumbnail_need(int w, int h);

/* A JPEG of the picture, each pixel the mean of some that it covers; a picture that is small enough
 * keeps its size. `name` is for sentences.
 * own:  free(*bytes).
 * err:  as img_encode_jpeg. On error *bytes is NULL. */
MUST_USE err_t thumbnail_make(const struct image8 *im, const char *name, void **bytes, size_t *n);

/* The same of a JPEG, upright; it is decoded at a fraction of its size.
 * err:  as img_read_mem. */
MUST_USE err_t thumbnail_of_jpeg(const void *jpeg, size_t size, const char *name, void **bytes,
                                 size_t *n);

#endif
