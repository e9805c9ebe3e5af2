/* ply.h - Gaussians as a PLY file that ordinary 3DGS viewers open.
 * Standard fields in the usual order (Inria's): x y z nx ny nz f_dc_0..2 f_rest_* opacity
 * scale_0..2 rot_0..3, all float; f_rest has all of red first, opacity is a logit, scales are
 * natural logarithms, rot is w,x,y,z of unit length. f_dc and f_rest are the display colours of
 * display.h at display_ev of the tone curve: unclamped sRGB, up to degree 3.
 * Radiance is in the extra properties "ushort ihdr_log_0..3K-1": half floats of the natural-log
 * radiance harmonics, K per colour, all of red first: radiance of 1e-7 to 1e7 to within 0.5 % at
 * degree 0. scene.hdrig keeps all bits. Programs that turn or recolour splats change f_dc and
 * f_rest, but know nothing of ihdr_log_*: where these no longer tell the colours that are shown, by
 * 3 % in a tenth of the splats, the shown ones are taken.
 * Comments "ihdr ev X", "ihdr mid_exposure_log2 X", "ihdr background R G B" serve programs that
 * have only this file; the tone curve and the cameras are in sidecar.h.
 * thread: any. */
#ifndef FORMAT_PLY_H
#define FORMAT_PLY_H

#include "drivers/format/splats.h"

/* Write the splats of s; log scales are raised to GAUSSIANS_LOG_SCALE_MIN.
 * err:  ERR_ARG (a value is not finite or a quaternion has no length: the splat and plane are
 *       named), ERR_IO, ERR_LIMIT (no space). The partial file is removed. */
MUST_USE err_t ply_write(const char *path, const struct scene *s);

/* Reads 3DGS files, binary of either byte order or text: properties of the vertex element in any
 * order, unknown ones skipped, later elements ignored; SH of degree 0 to 4. Radiance is in
 * ihdr_log_*, display colours in f_dc and f_rest; ev is that of the comment or, where both are
 * there, what brings the one to the other.
 * err:  ERR_FORMAT (the property is named), ERR_UNSUPPORTED (lists, SH degree), ERR_NOMEM. */
extern const struct splats_format ply_format;

#endif
