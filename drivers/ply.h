/* ply.h - Gaussians as a PLY file that ordinary 3DGS viewers open.
 * Standard fields in the usual order (Inria's): x y z nx ny nz f_dc_0..2 opacity scale_0..2
 * rot_0..3, all float; opacity is a logit, scales are natural logarithms, rot is w,x,y,z of unit
 * length. f_dc is chosen so that such viewers show what the photographs showed at the middle
 * exposure: 0.5 + C0 f_dc = tone curve of the splat's mean radiance, C0 = 0.2820948 (SH band 0).
 * Radiance is in the extra properties "ushort ihdr_log_0..3K-1": half floats of the natural-log
 * radiance harmonics, K per colour, all of red first. Half floats keep 11 bits; scene.hdrig keeps
 * all.
 * thread: any. */
#ifndef DRIVERS_PLY_H
#define DRIVERS_PLY_H

#include "core/splat/gaussians.h"

/* Write g with the display colours of `tone`; log scales are raised to GAUSSIANS_LOG_SCALE_MIN.
 * err:  ERR_ARG (a value is not finite or a quaternion has no length: the splat and plane are
 *       named), ERR_IO. The partial file is removed. */
MUST_USE err_t ply_write(const char *path, const struct gaussians *g, const struct tonemap *tone);

struct ply_info {
    int n, degree; // what gaussians_need asks for
    bool has_hdr;  // radiance from ihdr_log_*; else from f_dc and f_rest
};

/* What ply_read would read, from the header.
 * err:  as ply_read. */
MUST_USE err_t ply_peek(const char *path, struct ply_info *out);

/* Read a binary little-endian 3DGS file: properties of the vertex element in any order, unknown
 * ones skipped, later elements ignored. Without ihdr_log_* the colours are display values: they are
 * taken as sRGB, log radiance = ln(max(linear, 1e-4)), and f_rest of degree 1 to 3 goes through the
 * slope of that curve at the DC colour; highlights above display white stay clipped and strong
 * view dependence is only right to first order. Then gaussians_sanitize.
 * out:  *g in a (gaussians_need of ply_peek), *report.
 * err:  ERR_IO, ERR_FORMAT, ERR_UNSUPPORTED (ascii, big-endian, lists, SH degree),
 *       ERR_NOMEM. On error *g is zeroed. */
MUST_USE err_t ply_read(const char *path, struct arena *a, struct gaussians *g,
                        struct gaussians_report *report);

struct ply_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

/* The same from memory. */
MUST_USE err_t ply_peek_bytes(const struct ply_bytes *file, struct ply_info *out);
MUST_USE err_t ply_parse(const struct ply_bytes *file, struct arena *a, struct gaussians *g,
                         struct gaussians_report *report);

#endif
