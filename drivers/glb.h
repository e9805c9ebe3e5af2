/* glb.h - Gaussians as a binary glTF 2.0 file with KHR_gaussian_splatting (release candidate of
 * July 2026): one primitive of points, everything in floats, axes left, up, forward. Its colours
 * are those of display.h at display_ev of the tone curve, unclamped sRGB up to degree 3, and
 * COLOR_0 is what they are without splats. Radiance is in an extension of that extension:
 *   "HDRIG_gaussian_splatting_radiance": {"version": 1, "degree": D, "ev": stops of display.h}
 * with attributes HDRIG_gaussian_splatting_radiance:SH_DEGREE_l_COEF_n, VEC3 of float: harmonics of
 * the natural logarithm of radiance, red, green, blue.
 * thread: any. */
#ifndef DRIVERS_GLB_H
#define DRIVERS_GLB_H

#include "core/splat/gaussians.h"

/* Write the splats of s; log scales are brought into the range of gaussians.h.
 * err:  ERR_ARG (no splats, more than 4 GB; a value is not finite or a quaternion has no length:
 *       splat and plane named), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The partial file is
 *       removed. */
MUST_USE err_t glb_write(const char *path, const struct scene *s);

struct glb_info {
    int n, degree; // what gaussians_need asks for
    bool has_hdr;  // radiance; else display colours
    float ev;      // stops; 0 without radiance
};

/* What glb_read would read. err: as glb_read. */
MUST_USE err_t glb_peek(const char *path, struct glb_info *out);

/* Read a file with one primitive of splats that no node moves. Components may have any type that
 * glTF knows. Without radiance, colours go through display_to_radiance at `ev`. Then
 * gaussians_sanitize.
 * out:  *g in a (gaussians_need of glb_peek), *report.
 * err:  ERR_IO, ERR_FORMAT (chunk, attribute or member named; views that overlap or leave the
 *       file), ERR_UNSUPPORTED (kernel, colour space, compression, transformed nodes), ERR_NOMEM.
 *       On error *g is zeroed. */
MUST_USE err_t glb_read(const char *path, float ev, struct arena *a, struct gaussians *g,
                        struct gaussians_report *report);

struct glb_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

/* The same from memory. */
MUST_USE err_t glb_peek_bytes(const struct glb_bytes *file, struct glb_info *out);
MUST_USE err_t glb_parse(const struct glb_bytes *file, float ev, struct arena *a,
                         struct gaussians *g, struct gaussians_report *report);

#endif
