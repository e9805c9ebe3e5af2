/* scenefile.h - scene.hdrig, a scene without loss, and tone.json, its response curve for people.
 *
 * scene.hdrig is a safetensors file (safetensors.h), all tensors F32; N splats, K coefficients of
 * SH, V views:
 *   mu [3,N]  log_scale [3,N]  quat [4,N]  logit [N]  sh [K,3,N]   the planes of struct gaussians
 *   tone [3,193]  mid_log2t [1]  background [3]
 *   log2t [V]  cameras [V,11]   per view fx fy cx cy, q (w,x,y,z), t
 *   confidence [N]   0..1 (core/refine/confidence.h); absent: not known
 * and in __metadata__: format "hdrig-scene", version "1", size (px, the longest edge of all views),
 * names (a JSON list of V names), shapes (a JSON list [w,h,w,h,...] of 2 V numbers; absent: all
 * views are size x size px), unit ("m": lengths are metres; absent: any).
 *
 * The reader refuses everything that safetensors.h lists and
 *  1. another format or version;
 *  2. a tensor that is unknown or missing, or of a type other than F32;
 *  3. shapes that contradict each other or exceed GAUSSIANS_MAX, SH_DEGREE_MAX, CAMERAS_MAX;
 *  4. numbers that are not finite, cameras that cameras_check refuses, a negative background, a
 *     confidence outside 0 to 1;
 *  5. names that name_copy refuses or that repeat.
 * thread: any. */
#ifndef FORMAT_SCENEFILE_H
#define FORMAT_SCENEFILE_H

#include "core/base/types.h"

/* Write scene.hdrig. s->cams may be NULL only if n_views is 0.
 * err:  ERR_ARG (a splat that is not finite, named), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM. The
 *       partial file is removed. */
MUST_USE err_t scenefile_write(const char *path, const struct scene *s);

struct scenefile_info {
    int n, degree, n_views, size; // splats, of SH, views, px
    size_t need;                  // bytes that scenefile_read takes from its arena
};

/* The header of a scene: steps 1 to 3 of the checks.
 * err:  as scenefile_read. */
MUST_USE err_t scenefile_peek(const char *path, struct scenefile_info *out);

/* Read a scene. Splats outside the ranges of gaussians_sanitize are brought back into them.
 * out:  *s in a. On error *s is zeroed.
 * err:  ERR_IO, ERR_FORMAT, ERR_UNSUPPORTED (version), ERR_NOMEM. */
MUST_USE err_t scenefile_read(const char *path, struct arena *a, struct scene *s);

/* Allocate zeroed names, exposures and cameras of n_views views.
 * err:  ERR_NOMEM. */
MUST_USE err_t scenefile_alloc_views(struct arena *a, int n_views, struct scene *s);
size_t scenefile_views_need(int n_views);

struct scenefile_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

/* The same from memory. */
MUST_USE err_t scenefile_peek_bytes(const struct scenefile_bytes *file, struct scenefile_info *out);
MUST_USE err_t scenefile_parse(const struct scenefile_bytes *file, struct arena *a,
                               struct scene *s);

/* Write tone.json: {"formula", "mid_log2t", "curves": [{"colour", "w1", "b1", "w2", "b2"}, ...],
 * "samples": [{"log2_exposure_relative": x, "rgb": [r, g, b]}, ...]}; x is log2(radiance x t /
 * t_mid).
 * err:  ERR_IO, ERR_LIMIT (no space). The partial file is removed. */
MUST_USE err_t scenefile_write_tone(const char *path, const struct tonemap *tone);

#endif
