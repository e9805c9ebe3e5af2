/* pixels.h - photographs of any kind that is read, decoded: PNG, JPEG, and those with more than 8
 * bits, or may have: PNG of 16 bits, TIFF, HEIC, OpenEXR and raw photographs.
 * Linear values (OpenEXR; PNG of 16 bits whose gAMA chunk says 1) become display values by the
 * curve of sRGB, clipped at 1, which is where the sensor must be full. In 16 bits it keeps steps of
 * 2^-19.7 in the shadows. thread: any. */
#ifndef FORMAT_PIXELS_H
#define FORMAT_PIXELS_H

#include "core/base/types.h"
#include "drivers/format/img.h"

/* Sets s->deep and s->linear from the file's header.
 * err:  ERR_IO, ERR_FORMAT (too large). */
MUST_USE err_t pixels_look(const char *path, struct shot *s);

/* Decode a shot, undistorted if its lens distorts; a deep one is rounded to 8 bits.
 * own:  img_free.
 * err:  those of img_read and exrfile_read; ERR_FORMAT if the file has another size than s says, or
 *       linear values of which more than half are above 1. On error *out is zeroed. */
MUST_USE err_t pixels_decode(const char *path, const struct shot *s, struct image8 *out);

/* The mask (masks.h) of the shot in a file: 255 where its pixels count, 0 where that is black.
 * own, err:  as pixels_decode. */
MUST_USE err_t pixels_decode_mask(const char *photograph, const struct shot *s, struct image8 *out);

/* Decode a deep shot with all its bits.
 * own:  pixels_free16. */
MUST_USE err_t pixels_decode16(const char *path, const struct shot *s, struct image16 *out);

/* Accepts a zeroed image. */
void pixels_free16(struct image16 *im);

/* img_exif and img_camera, of files of photofile.h as well. */
MUST_USE err_t pixels_exif(const char *path, struct img_exif *out);
MUST_USE err_t pixels_camera(const char *path, struct img_camera *out);

/* Bytes for each pixel of a shot while it is decoded. */
size_t pixels_bytes(const struct shot *s);

#endif
