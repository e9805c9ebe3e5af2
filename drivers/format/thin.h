/* thin.h - a small picture made of blocks of a frame, spread evenly over it: what exposure control
 * looks at. Costs a hundredth of unpacking all of it, but for JPEG.
 * thread: any. */
#ifndef FORMAT_THIN_H
#define FORMAT_THIN_H

#include "drivers/device/unpack.h"

enum { THIN_BLOCK = 4, THIN_BLOCKS = 32 }; // px; blocks in a row and in a column at most

/* Numbers that out->px of thin_run must have room for; 0 if unpack_count is. */
size_t thin_count(const struct camera_info *info);

/* The picture, up to THIN_BLOCK * THIN_BLOCKS px a side; a smaller frame is taken as it is.
 * err:  as unpack_run. */
MUST_USE err_t thin_run(const struct camera_info *info, const struct frame *f, struct raw *out);

/* Kind of the pictures: all of struct raw but px. */
struct raw thin_kind(const struct camera_info *info);

#endif
