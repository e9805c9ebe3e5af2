/* colmap.h - cameras of a COLMAP model folder (sparse/0), binary or text.
 * Format: colmap.github.io/format.html; the binary files are preferred when both are there, as
 * COLMAP does. Camera models: SIMPLE_PINHOLE and those of core/base/lens.h.
 * thread: any. */
#ifndef FORMAT_COLMAP_H
#define FORMAT_COLMAP_H

#include "drivers/format/cameras.h"

/* Read cameras and images of folder `dir`. Names lose their folders ("cam0/a.png" is "a.png"); if
 * they are not distinct then, as those of a rig with a folder for each camera, they keep the last
 * one ("cam0_a.png"), as imageset.h calls pictures of several folders.
 * own:  cameras_free.
 * err:  ERR_IO (no such files), ERR_FORMAT (also: above CAMERAS_MAX), ERR_UNSUPPORTED (camera
 *       model), ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t colmap_read(const char *dir, struct rig *out);

struct colmap_text {
    const char *what; // begins the sentence
    const void *p;
    size_t n;
};

struct colmap_point {
    float xyz[3]; // scene units
    uint8_t rgb[3];
};

struct colmap_points {
    int n;
    struct colmap_point *p; // (n), malloc'd
};

/* Read points3D of folder `dir`; no such file is the same as no points. Points that are not finite
 * are left out.
 * own:  colmap_free_points.
 * err:  ERR_IO, ERR_FORMAT, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t colmap_read_points(const char *dir, struct colmap_points *out);

/* Accepts a zeroed struct. */
void colmap_free_points(struct colmap_points *points);

/* As colmap_read, from the contents of cameras.{bin,txt} and images.{bin,txt}. */
MUST_USE err_t colmap_parse(bool binary, const struct colmap_text *cameras,
                            const struct colmap_text *images, struct rig *out);

/* As colmap_read_points, from the contents of points3D.{bin,txt}. */
MUST_USE err_t colmap_parse_points(bool binary, const struct colmap_text *points,
                                   struct colmap_points *out);

#endif
