/* glb.h - Gaussians as a binary glTF 2.0 file with KHR_gaussian_splatting (release candidate of
 * July 2026): one primitive of points, everything in floats, axes left, up, forward; the first view
 * is a camera. Its colours are those of display.h at display_ev of the tone curve, unclamped sRGB
 * up to degree 3, and COLOR_0 is the fallback for viewers without splats. Radiance is in an
 * extension of that extension:
 *   "HDRIG_gaussian_splatting_radiance": {"version": 2, "degree": D, "ev": stops of display.h}
 * with attributes _HDRIG_gaussian_splatting_radiance:SH_DEGREE_l_COEF_n, VEC3 of float: harmonics
 * of the natural logarithm of radiance, red, green, blue. Version 1 lacks the "_", which glTF wants
 * before names that are not its own.
 * thread: any. */
#ifndef FORMAT_GLB_H
#define FORMAT_GLB_H

#include "drivers/format/splats.h"

/* Write the splats of s; log scales are brought into the range of gaussians.h.
 * err:  ERR_ARG (no splats, more than 4 GB; a value is not finite or a quaternion has no length:
 *       splat and plane named), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The partial file is
 *       removed. */
MUST_USE err_t glb_write(const char *path, const struct scene *s);

/* Reads files with one primitive of splats that no node moves. Components may have any type that
 * glTF knows.
 * err:  ERR_FORMAT (chunk, attribute or member named; views that overlap or leave the file),
 *       ERR_UNSUPPORTED (kernel, colour space, compression, transformed nodes), ERR_NOMEM. */
extern const struct splats_format glb_format;

#endif
