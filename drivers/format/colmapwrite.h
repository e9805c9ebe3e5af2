/* colmapwrite.h - cameras and points as a COLMAP model folder: cameras, images and points3D, binary
 * (which COLMAP, 3DGS, gsplat, nerfstudio, OpenSplat and Brush read) or text.
 * Format: colmap.github.io/format.html. Images whose lens and size are the same share a camera.
 * Images have no points and points no tracks: programs start from their positions and colours.
 * thread: any. */
#ifndef FORMAT_COLMAPWRITE_H
#define FORMAT_COLMAPWRITE_H

#include "drivers/format/colmap.h"

/* Write the three files into folder `dir`, each synced.
 * points: NULL: none.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_NOMEM, ERR_ARG (path too long). The partial file is
 *       removed. */
MUST_USE err_t colmapwrite_run(const char *dir, bool binary, const struct rig *rig,
                               const struct colmap_points *points);

#endif
