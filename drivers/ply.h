/* ply.h - Gaussians as a PLY file that ordinary 3DGS viewers open.
 * Standard fields in the usual order (Inria's): x y z nx ny nz f_dc_0..2 f_rest_* opacity
 * scale_0..2 rot_0..3, all float; f_rest has all of red first, opacity is a logit, scales are
 * natural logarithms, rot is w,x,y,z of unit length. f_dc and f_rest are the display colours of
 * display.h at display_ev of the tone curve: unclamped sRGB, up to degree 3.
 * Radiance is in the extra properties "ushort ihdr_log_0..3K-1": half floats of the natural-log
 * radiance harmonics, K per colour, all of red first: radiance of 1e-7 to 1e7 to within 0.5 % at
 * degree 0. scene.hdrig keeps all bits. Programs that turn splats turn f_rest, but know nothing of
 * ihdr_log_*: take these out of a turned file of degree > 0.
 * Comments "ihdr ev X", "ihdr mid_exposure_log2 X", "ihdr background R G B" say what a program
 * needs that has only this file; the tone curve and the cameras are in sidecar.h.
 * thread: any. */
#ifndef DRIVERS_PLY_H
#define DRIVERS_PLY_H

#include "core/splat/gaussians.h"

/* Write the splats of s; log scales are raised to GAUSSIANS_LOG_SCALE_MIN.
 * err:  ERR_ARG (a value is not finite or a quaternion has no length: the splat and plane are
 *       named), ERR_IO, ERR_LIMIT (no space). The partial file is removed. */
MUST_USE err_t ply_write(const char *path, const struct scene *s);

struct ply_info {
    int n, degree; // what gaussians_need asks for
    bool has_hdr;  // radiance from ihdr_log_*; else from f_dc and f_rest
    float ev;      // of the comment, stops; 0 without
};

/* What ply_read would read, from the header.
 * err:  as ply_read. */
MUST_USE err_t ply_peek(const char *path, struct ply_info *out);

/* Read a binary little-endian 3DGS file: properties of the vertex element in any order, unknown
 * ones skipped, later elements ignored; SH of degree 0 to 4. Without ihdr_log_* the colours go
 * through display_to_radiance at `ev`: that of the tone curve if it is known, else of ply_info.
 * Then gaussians_sanitize.
 * out:  *g in a (gaussians_need of ply_peek), *report.
 * err:  ERR_IO, ERR_FORMAT (the property is named), ERR_UNSUPPORTED (ascii, big-endian, lists, SH
 *       degree), ERR_NOMEM. On error *g is zeroed. */
MUST_USE err_t ply_read(const char *path, float ev, struct arena *a, struct gaussians *g,
                        struct gaussians_report *report);

struct ply_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

/* The same from memory. */
MUST_USE err_t ply_peek_bytes(const struct ply_bytes *file, struct ply_info *out);
MUST_USE err_t ply_parse(const struct ply_bytes *file, float ev, struct arena *a,
                         struct gaussians *g, struct gaussians_report *report);

#endif
