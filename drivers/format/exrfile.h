/* exrfile.h - linear radiance as OpenEXR files, through OpenEXRCore.
 * Files are hostile until checked: at most EXRFILE_SIDE_MAX px a side, EXRFILE_PX_MAX px,
 * EXRFILE_BYTES_MAX bytes, and never more samples than so few bytes can hold. Nothing is printed;
 * messages of the library become part of the error. */
#ifndef FORMAT_EXRFILE_H
#define FORMAT_EXRFILE_H

#include "core/base/types.h"

#include <stdio.h>

enum { EXRFILE_SIDE_MAX = 16384, EXRFILE_PX_MAX = 1 << 28, EXRFILE_BYTES_MAX = 1 << 30 };

/* Optional content beside R, G and B; a zeroed struct adds nothing. */
struct exrfile_extra {
    bool half;          // store R, G, B, A as half instead of float
    const float *alpha; // (h, w) channel A, NULL = none
    const float *depth; // (h, w) channel Z, always float, scene units, NULL = none
    float exposure_s;   // expTime in s, 0 = not known
    const float *log2t; // hdrigExposureLog2 (log2 of the linear exposure, any unit), NULL = none
    const struct camera *cam; // see exrfile_write, NULL = none
};

/* Write a scanline file, ZIP in blocks of 16 rows, with Rec. 709 chromaticities, synced to the
 * disk; a file that could not be completed is removed. A camera becomes the standard attributes
 * worldToCamera and worldToNDC and hdrigFocal (fx, fy) and hdrigCentre (cx, cy) in px. By the
 * standard, matrices act on row vectors, their camera has y up and NDC runs from (0, 0) top left to
 * (1, 1) bottom right.
 * rgb:        at least 3 channels, the first three are written.
 * saturated:  how many samples were beyond the range of their type (half: 65504) and were written
 *             as its largest value; may be NULL. A NaN is written as 0 and not counted.
 * err:        ERR_ARG (shape), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. */
MUST_USE err_t exrfile_write(const char *path, const struct image *rgb,
                             const struct exrfile_extra *extra, size_t *saturated);

/* An attribute: a text, or a number if `text` is NULL. */
struct exrfile_attr {
    const char *name, *text;
    float number;
};

/* One picture of several in a file. */
struct exrfile_part {
    const char *name; // no two alike
    const struct exrfile_attr *attr;
    int n_attr;
};

/* Parts of a file, all of one size, R, G and B as half. */
struct exrfile_parts {
    int n, w, h;
    const struct exrfile_part *part; // [n]
    /* Pixels of part i, at least 3 channels; valid until the next call. */
    err_t (*fill)(void *ctx, int i, const struct image **out);
    void *ctx;
};

/* Write a scanline file of several parts in their order to a stream that can seek, in PIZ, with
 * Rec. 709 chromaticities; values as in exrfile_write. `name` is for sentences.
 * err:  ERR_ARG (shape), ERR_NOMEM, ERR_IO (ferror(f) holds then), those of fill. */
MUST_USE err_t exrfile_put_parts(FILE *f, const char *name, const struct exrfile_parts *p);

/* Read R, G and B (half, float or uint) of the first part; a file with only Y becomes grey.
 * Scanline or tiled (the full resolution), uncompressed, RLE, ZIP, ZIPS, PIZ or PXR24.
 * out:  3 channels, values as stored (they may be infinite or NaN).
 * own:  exrfile_free.
 * err:  ERR_IO, ERR_FORMAT, ERR_NOMEM, ERR_UNSUPPORTED (deep data, lossy B44 and DWA,
 *       subsampled channels, a data window that is not the display window). On error *out is
 *       zeroed. */
MUST_USE err_t exrfile_read(const char *path, struct image *out);

/* As exrfile_read, from `n` bytes in memory; `name` is for sentences. */
MUST_USE err_t exrfile_read_mem(const void *bytes, size_t n, const char *name, struct image *out);

/* Accepts a zeroed image. */
void exrfile_free(struct image *im);

#endif
