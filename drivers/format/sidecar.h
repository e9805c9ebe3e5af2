/* sidecar.h - NAME.json beside NAME.ply, NAME.spz or NAME.glb: the part of a scene that a file of
 * splats cannot hold.
 *   {"format": "hdrig-sidecar", "version": 1, "ev": stops of display.h, "mid_exposure_log2": ...,
 *    "background": [r, g, b], "tone": [{"w1": [64], "b1": [64], "w2": [64], "b2": x}, ...],
 *    "size": px, "unit": as in cameras.json, "cameras": likewise, with exposures}
 * Numbers have nine digits: written and read back they are the same floats. "ev" is for other
 * programs, it follows from the tone curve. A NAME.json without that "format" belongs to another
 * program: it is neither read nor overwritten.
 * thread: any. */
#ifndef FORMAT_SIDECAR_H
#define FORMAT_SIDECAR_H

#include "core/base/types.h"

enum { SIDECAR_SIZE = 448 }; // px, of pictures of a scene without sidecar

/* "NAME.json" of a path "NAME.xyz".
 * err:  ERR_ARG (too long). */
MUST_USE err_t sidecar_path(const char *splats, char out[], size_t cap);

/* Whether sidecar_write may put a file there.
 * err:  ERR_ARG (NAME.json belongs to another program), ERR_NOMEM. */
MUST_USE err_t sidecar_check_place(const char *splats);

/* Write everything of s but its splats.
 * err:  ERR_ARG (everything that sidecar_read refuses: a number that is not finite, a background
 * below 0,
 *       a size below 1, cameras of another size or more than CAMERAS_MAX; as sidecar_check_place),
 *       ERR_FORMAT (a camera that cameras_check refuses), ERR_IO, ERR_LIMIT (no space), ERR_NOMEM.
 *       The partial file is removed. */
MUST_USE err_t sidecar_write(const char *splats, const struct scene *s);

struct sidecar_info {
    bool found; // and ours
    int n_views;
    size_t need; // bytes that sidecar_read takes from its arena
};

/* err:  as sidecar_read. */
MUST_USE err_t sidecar_peek(const char *splats, struct sidecar_info *out);

/* Fill all of *s but its splats. Without a sidecar: sRGB at ev (display_tonemap), a black
 * background, no views, SIDECAR_SIZE.
 * err:  ERR_IO, ERR_FORMAT (member named; numbers not finite, cameras that cameras_check refuses,
 *       more than CAMERAS_MAX), ERR_UNSUPPORTED (version), ERR_NOMEM. On error *s is as it was. */
MUST_USE err_t sidecar_read(const char *splats, float ev, struct arena *a, struct scene *s);

struct sidecar_bytes {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

/* The same from memory. */
MUST_USE err_t sidecar_peek_bytes(const struct sidecar_bytes *file, struct sidecar_info *out);
MUST_USE err_t sidecar_parse(const struct sidecar_bytes *file, float ev, struct arena *a,
                             struct scene *s);

#endif
