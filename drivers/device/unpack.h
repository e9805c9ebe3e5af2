/* unpack.h - converts a driver's buffer to numbers. Sizes, strides and JPEG data are not trusted.
 * thread: any. */
#ifndef DEVICE_UNPACK_H
#define DEVICE_UNPACK_H

#include "drivers/device/camera.h"

#include "core/photo/raw.h"

enum { UNPACK_SIDE_MAX = 16384, UNPACK_PX_MAX = 1 << 28 };

/* Numbers that struct raw needs for frames of that camera; 0 if its format or size is not
 * acceptable: 1..UNPACK_SIDE_MAX px a side and UNPACK_PX_MAX in all, even where colours are packed
 * in pairs. */
size_t unpack_count(const struct camera_info *info);

/* Unpack; out->px has room for unpack_count numbers. Display formats (YUV, RGB, JPEG) become
 * RAW_RGB with 8 bits, GREY 8-bit RAW_MONO; GREY16 and mosaics are linear and keep their bits.
 * err:  ERR_FORMAT names what does not fit: size, stride or format not those of `info`, fewer
 *       bytes than the format needs, words above the `bits` of info, JPEG without its end or with
 *       warnings of the decoder; ERR_UNSUPPORTED (CMYK), ERR_NOMEM. On error only what out->px
 *       points to is changed. */
MUST_USE err_t unpack_run(const struct camera_info *info, const struct frame *f, struct raw *out);

/* The checks of unpack_run that need no decoding: bounds, and for JPEG its markers from start to
 * end. Bytes after the end are padding. Cheap enough for every frame.
 * err: ERR_FORMAT */
MUST_USE err_t unpack_check(const struct camera_info *info, const struct frame *f);

#endif
