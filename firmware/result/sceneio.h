/* sceneio.h - a scene in any kind of file: result folder or .hdrig, .ply, .spz, .glb, .splat,
 * .ksplat, .sog and its folder in; .hdrig, .ply, .spz, .glb, .html out. The kind follows from the
 * name's end.
 * thread: any. */
#ifndef RESULT_SCENEIO_H
#define RESULT_SCENEIO_H

#include "core/base/gaussians.h"
#include "core/base/types.h"

struct sceneio_info {
    int n, degree, n_views, size;
    bool has_hdr;     // radiance; else display colours, taken as sRGB
    bool band_lost;   // some harmonics of the file are not read
    bool has_sidecar; // it has the exposure of display colours
    float ev;         // exposure by the file itself, stops; 0: none
    float headroom;   // stops above white where display colours of its kind end
    size_t need;      // bytes that sceneio_read takes from its arena
};

/* err:  as sceneio_read. */
MUST_USE err_t sceneio_peek(const char *path, struct sceneio_info *out);

/* out:  *s in a; *report of gaussians_sanitize.
 * err:  ERR_ARG (no such kind), ERR_IO, ERR_FORMAT, ERR_UNSUPPORTED, ERR_NOMEM: the sentence names
 *       file and field. On error *s is zeroed. Data that are not read because they contradict the
 *       rest are named in the log. */
MUST_USE err_t sceneio_read(const char *path, struct arena *a, struct scene *s,
                            struct gaussians_report *report);

/* Log what a user should know of a file that was read: what it lacks, what was left out. */
void sceneio_warn(const char *path, const struct sceneio_info *info, const struct scene *s,
                  const struct gaussians_report *r);

/* Refuse a place where sceneio_write would not write, before the work.
 * out:  *readable: sceneio_read knows the kind too.
 * err:  ERR_ARG (no such kind; a folder; another program's file at the sidecar's name). */
MUST_USE err_t sceneio_check_place(const char *path, bool *readable);

struct sceneio_format {
    int spz;           // version of .spz, 3 or 4
    bool lossless;     // .html: pagesplats.h; else pagepack.h
    const char *title; // .html: UTF-8; NULL: that of this program
};

/* Write the file, and its sidecar where the kind needs one: they appear under their names when
 * complete.
 * err:  those of sceneio_check_place; ERR_ARG (also: another kind of file of this name has the same
 *       sidecar, which would change), ERR_IO, ERR_LIMIT, ERR_NOMEM. */
MUST_USE err_t sceneio_write(const char *path, const struct scene *s,
                             const struct sceneio_format *f);

/* Bytes that sceneio_write takes beside the scene, whatever the kind. */
size_t sceneio_write_plan(int n, int degree);

#endif
