/* llff.h - poses_bounds_exps.npy of HDR-NeRF and poses_bounds.npy of LLFF, from which it comes: an
 * array of float64 or float32 with a row for each picture, in the order of their names:
 *   0..14  3 x 5 by rows: the axes down, right and back of the camera in the world, its centre, and
 *          height, width, focal length (px)
 *   15, 16 nearest and farthest depth, which are not read
 *   17     exposure time, in HDR-NeRF's
 * The pictures are those of input_images/ or images/ beside the file. Poses are those of COLMAP, of
 * the pictures as stored.
 * thread: any. */
#ifndef FORMAT_LLFF_H
#define FORMAT_LLFF_H

#include "drivers/format/cameras.h"

#define LLFF_NAME "poses_bounds_exps.npy"
#define LLFF_PICTURES "input_images"

/* Checked: NumPy format 1 to 3, little-endian floats, C or Fortran order, 17 or 18 columns, as many
 * rows as pictures, at most CAMERAS_MAX; poses are rotations within 1e-3; what cameras_check does;
 * exposures finite and > 0.
 * own:  cameras_free.
 * err:  ERR_IO, ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t llff_read(const char *path, struct rig *out);

/* As llff_read, from n bytes. out: of the caller: n views with names, the rest is filled. `what`
 * begins the sentence.
 * err:  ERR_FORMAT. */
MUST_USE err_t llff_parse(const char *what, const void *p, size_t n, struct rig *io);

#endif
