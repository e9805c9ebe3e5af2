/* unpack.h - a driver's buffer to numbers: the place where untrusted sizes, strides and JPEG end.
 * thread: any. */
#ifndef DRIVERS_UNPACK_H
#define DRIVERS_UNPACK_H

#include "drivers/camera.h"

#include "core/expo/raw.h"

/* Numbers that struct raw needs for frames of that camera; 0 if its size is not acceptable. */
size_t unpack_count(const struct camera_info *info);

/* Unpack; out->px has room for unpack_count numbers. Display formats (YUV, RGB, JPEG) become
 * RAW_RGB with 8 bits, grey and mosaics keep their bits.
 * err:  ERR_FORMAT names what does not fit: size or format not those of `info`, stride, fewer
 *       bytes than the format needs, JPEG without its end or with warnings of the decoder. */
MUST_USE err_t unpack_run(const struct camera_info *info, const struct frame *f, struct raw *out);

/* What unpack_run would refuse, as far as that can be said without decoding: bounds, and for JPEG
 * its markers from start to end. Cheap: for every frame. err: ERR_FORMAT */
MUST_USE err_t unpack_check(const struct camera_info *info, const struct frame *f);

#endif
