/* subsample.h - a small picture made of blocks of a frame, spread evenly over it: what exposure
 * control looks at. Costs a hundredth of unpacking all of it, but for JPEG.
 * thread: any. */
#ifndef FORMAT_SUBSAMPLE_H
#define FORMAT_SUBSAMPLE_H

#include "drivers/device/unpack.h"

enum { SUBSAMPLE_BLOCK = 4, SUBSAMPLE_BLOCKS = 32 }; // px; blocks in a row and in a column at most

/* Numbers that out->px of subsample_run must have room for; 0 if unpack_count is. */
size_t subsample_count(const struct camera_info *info);

/* The picture, up to SUBSAMPLE_BLOCK * SUBSAMPLE_BLOCKS px a side; a smaller frame is taken as it
 * is. err:  as unpack_run. */
MUST_USE err_t subsample_run(const struct camera_info *info, const struct frame *f,
                             struct raw *out);

/* Kind of the pictures: all of struct raw but px. */
struct raw subsample_kind(const struct camera_info *info);

#endif
