/* img.h - PNG and JPEG through libspng and libjpeg-turbo, exposure from EXIF through libexif. The
 * kind of a file follows from its first bytes, never from its name. Files are hostile until
 * checked: at most IMG_SIDE_MAX px a side, IMG_PX_MAX px, IMG_FILE_MAX bytes, and never more pixels
 * than so few bytes can hold. A file whose decoder warns (cut off, corrupt) is refused as a
 * whole. */
#ifndef FORMAT_IMG_H
#define FORMAT_IMG_H

#include "core/base/types.h"

enum { IMG_SIDE_MAX = 16384, IMG_PX_MAX = 1 << 28, IMG_FILE_MAX = 1 << 29 };

/* Decode to 8-bit R,G,B. PNG: any colour type and depth, alpha and transparency dropped without
 * compositing, grey spread to RGB, of 16 bits the upper 8. JPEG: grey, YCbCr or RGB; it
 * is turned upright as its EXIF orientation says. Gamma and profiles are ignored
 * (core/photo/README.md 1.1).
 * own:  img_free.
 * err:  ERR_IO, ERR_FORMAT, ERR_NOMEM, ERR_UNSUPPORTED (CMYK). On error *out is
 *       zeroed. */
MUST_USE err_t img_read(const char *path, struct image8 *out);

/* Whether the file is a PNG of 16 bits per channel. linear: its gAMA chunk says 1. */
bool img_is_deep(const void *bytes, size_t n, bool *linear);

/* As img_read_mem, of a PNG with 16 bits: all of them.
 * own:  free(out->px). */
MUST_USE err_t img_read16_mem(const void *bytes, size_t n, const char *name, struct image16 *out);

/* Orientation of a JPEG by its EXIF data (CIPA DC-008 4.6.4): 1, upright, to 8; from 5 on width and
 * height are exchanged. 1 if it has none. */
int img_orientation(const void *bytes, size_t n);

/* As img_read, from `n` bytes in memory; `name` is for sentences. */
MUST_USE err_t img_read_mem(const void *bytes, size_t n, const char *name, struct image8 *out);

/* Decode a JPEG of out->w x out->h px into out->px. Huffman tables that the file lacks are those of
 * the standard, as motion JPEG wants it; orientation is ignored.
 * err:  as img_read_mem, ERR_FORMAT also for another size */
MUST_USE err_t img_decode_jpeg(const void *bytes, size_t n, const char *name,
                               const struct image8 *out);

/* As img_read_mem, of a JPEG, at the least of the decoder's sizes, from an eighth on, whose longer
 * side is at least `edge` px, or at its own if that is smaller. */
MUST_USE err_t img_read_jpeg_small(const void *bytes, size_t n, const char *name, int edge,
                                   struct image8 *out);

/* Accepts a zeroed image. */
void img_free(struct image8 *im);

/* Write an RGB picture as PNG, synced to the disk; a file that could not be completed is removed.
 * err:  ERR_ARG (channels or shape), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. */
MUST_USE err_t img_write_png(const char *path, const struct image8 *im);

/* Make and model of a camera, ASCII. */
struct img_maker {
    const char *make, *model;
};

/* The same with an eXIf chunk that names the camera; `by` NULL: none. */
MUST_USE err_t img_write_png_by(const char *path, const struct image8 *im,
                                const struct img_maker *by);

/* Encode as PNG into memory in a tenth of the time of img_write_png, for a fifth more bytes; `name`
 * is for sentences.
 * own:  free(*bytes).
 * err:  ERR_ARG (channels or shape), ERR_NOMEM. On error *bytes is NULL. */
MUST_USE err_t img_encode_png_fast(const struct image8 *im, const char *name, void **bytes,
                                   size_t *n);

/* Encode as JPEG into memory, every colour at full resolution. quality: 1..100; `name` is for
 * sentences.
 * own:  free(*bytes).
 * err:  ERR_ARG (channels or shape), ERR_NOMEM. On error *bytes is NULL. */
MUST_USE err_t img_encode_jpeg(const struct image8 *im, int quality, const char *name, void **bytes,
                               size_t *n);

/* As img_write_png, from the first three channels of a float image: round(255 clip(v, 0, 1)), NaN
 * as 0. */
MUST_USE err_t img_write_ldr(const char *path, const struct image *im);

/* Exposure of a file by its EXIF data (JPEG, or the eXIf chunk of PNG). */
struct img_exif {
    double seconds;       // ExposureTime, > 0
    double iso, f_number; // 0 = not in the file
};

/* EXIF data about the camera. */
struct img_camera {
    char name[NAME_CAP]; // make, model, serial numbers of body and lens, focal length; "" without
    double focal_35mm;   // FocalLengthIn35mmFilm; 0 = not in the file
    double focal_plane; // focal length over the longer edge, by FocalPlaneXResolution; 0 = the same
    int orientation;    // as img_orientation
};

/* What the header of a photograph says. */
struct img_info {
    int w, h;                 // px, upright
    struct img_exif exif;     // seconds 0: not in the file
    struct img_camera camera; // its orientation is 1 where readers turn the picture
};

/* EXIF data that lie on the way from the sensor to pixels (CIPA DC-008 4.6.5). */
struct img_plane {
    double focal_mm, resolution; // FocalLength, FocalPlaneXResolution in pixels per unit
    int unit;    // FocalPlaneResolutionUnit: 3 = cm, 4 = mm, 5 = micrometres, else inch
    double w, h; // PixelXDimension, PixelYDimension
};

/* Focal length over the longer edge of the photograph; 0 if something lacks or is not plausible. */
double img_focal_plane(const struct img_plane *p);

/* Exposure and camera from a block of EXIF data, with or without "Exif\0\0" before it.
 * out:  exif, camera.
 * err:  ERR_NOMEM. */
MUST_USE err_t img_exif_block(const void *block, size_t n, const char *name, struct img_info *out);

/* A file without such data is no error.
 * err:  ERR_IO, ERR_NOMEM. */
MUST_USE err_t img_camera(const char *path, struct img_camera *out);

/* err:  ERR_IO, ERR_NOMEM, ERR_FORMAT (no EXIF, or no ExposureTime that is finite and > 0). On
 *       error *out is zeroed. */
MUST_USE err_t img_exif(const char *path, struct img_exif *out);
MUST_USE err_t img_exif_mem(const void *bytes, size_t n, const char *name, struct img_exif *out);

/* Relative exposure seconds * (iso / 100) / f_number^2, > 0. A missing tag counts as ISO 100 or
 * f/1: values compare only between files with the same tags. */
double img_exif_exposure(const struct img_exif *x);

#endif
