/* splats.h - the common interface of files of Gaussian splats.
 * thread: any. */
#ifndef FORMAT_SPLATS_H
#define FORMAT_SPLATS_H

#include "core/base/gaussians.h"

/* A file in memory. */
struct splats_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

struct splats_info {
    int n, degree;  // what gaussians_need asks for
    bool has_hdr;   // radiance of its own; else from the display colours
    bool hdr_stale; // it has radiance, but not that of its display colours
    bool band_lost; // display colours have a higher degree than is read
    float ev;       // that goes with its colours, stops; 0 if it tells none
};

/* A kind of file; the headers of the kinds list what their readers refuse. */
struct splats_format {
    uint64_t bytes_max;
    float headroom; // stops above white where its display colours end

    /* Counts and kinds, from the header. */
    err_t (*peek)(const struct splats_bytes *file, struct splats_info *out);

    /* Without radiance, colours go through display_to_radiance at `ev`: that of the tone curve if
     * it is known, else of the info. Then gaussians_sanitize.
     * out:  *g in a (gaussians_need of the info), *report. On error *g is zeroed. */
    err_t (*parse)(const struct splats_bytes *file, float ev, struct arena *a, struct gaussians *g,
                   struct gaussians_report *report);
};

/* The same from the disk.
 * err:  of the format, ERR_IO. */
MUST_USE err_t splats_peek(const struct splats_format *f, const char *path,
                           struct splats_info *out);
MUST_USE err_t splats_read(const struct splats_format *f, const char *path, float ev,
                           struct arena *a, struct gaussians *g, struct gaussians_report *report);

/* Refuse numbers that are not finite; `path` begins the sentence.
 * err:  ERR_ARG: splat and plane named. */
MUST_USE err_t splats_check_finite(const char *path, const struct gaussians *g);

/* Refuse what no file can hold; `path` begins the sentence.
 * err:  ERR_ARG (a value is not finite or a quaternion has no length: splat and plane named). */
MUST_USE err_t splats_check(const char *path, const struct gaussians *g);

/* Axes that point the other way than those of struct camera (right, down, forward). */
enum { SPLATS_RUB = 2 | 4, SPLATS_LUF = 1 | 2 }; // bits x, y, z: right, up, back; left, up, forward

/* -1 or 1: what a plane of struct gaussians is multiplied with to change these axes, either way. */
int splats_sign(int plane, unsigned axes);

/* Numbers of files as struct gaussians has them: a linear length, which may be 0; the byte of an
 * opacity, whose ends are moved inwards since the logits of 0 and 1 are infinite; the byte of a
 * display colour, as harmonic of degree 0. */
float splats_log_scale(float length);
float splats_logit(int byte);
float splats_colour(int byte);

/* Display harmonics in the planes of SH, degree 0 to 3, become those of radiance, at `ev`. */
void splats_to_radiance(struct gaussians *g, float ev);

#endif
