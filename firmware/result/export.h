/* export.h - what another program needs to make a scene of its own from the cameras of one of ours:
 * the photographs, their cameras, and points to start from.
 *
 * COLMAP:      images/NAME.png, sparse/0/{cameras,images,points3D}.bin
 * nerfstudio:  images/NAME.png, transforms.json, points.ply
 * and exposure.json in both if the exposures are known, as hdrig reads it. */
#ifndef RESULT_EXPORT_H
#define RESULT_EXPORT_H

#include "firmware/result/outdir.h"

#include "drivers/format/colmap.h"
#include "drivers/format/imageset.h"

enum { EXPORT_POINTS_MAX = 200000 };

struct export_request {
    const struct imageset *set; // every shot has a camera
    const struct scene *scene;  // of the points
    bool photographed;          // as taken, with their lenses; else undistorted
    const char *transforms;     // name of nerfstudio's file; NULL: COLMAP's folder
};

struct export_result {
    int n_images, n_points;
};

/* Bytes of pictures that are in memory at a time. */
size_t export_plan(const struct imageset *set, int threads);

/* Write the folder, up to outdir_commit, which is the caller's.
 * err:  ERR_ARG (two photographs that differ in their extension only; lenses that the format cannot
 *       hold together), ERR_IO, ERR_FORMAT, ERR_LIMIT (no space), ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t export_run(const struct run *r, const struct export_request *rq, struct outdir *o,
                          struct export_result *out);

/* Centres of the splats that are more opaque than not, evenly chosen if they are more than
 * EXPORT_POINTS_MAX, with the colour that they have from all sides, as sRGB at the middle exposure.
 * own:  colmap_free_points.
 * err:  ERR_NOMEM. */
MUST_USE err_t export_points(const struct scene *s, struct colmap_points *out);

#endif
