/* transforms.h - cameras as nerfstudio's transforms.json (docs.nerf.studio, "Data conventions"),
 * which instant-ngp, OpenSplat and Brush read too:
 *   {"camera_model": "OPENCV", "fl_x": ..., "fl_y": ..., "cx": ..., "cy": ..., "w": ..., "h": ...,
 *    "k1": ..., "k2": ..., "p1": ..., "p2": ..., "ply_file_path": "points.ply",
 *    "frames": [{"file_path": "images/a.png", "transform_matrix": [[...] x 4], ...}, ...]}
 * Each frame may have any of these numbers itself. transform_matrix is camera to world, the camera
 * looks along -z with y up (OpenGL). Focal lengths may be told by camera_angle_x instead. A number
 * "exposure" of a frame, linear time x gain in any common unit, is hdrig's own.
 * thread: any. */
#ifndef FORMAT_TRANSFORMS_H
#define FORMAT_TRANSFORMS_H

#include "drivers/format/colmap.h"

/* Read a file. Images are stored ones: programs that write such files do not look at orientations
 * in EXIF. Names and folders are as in colmap_read. Unknown members are ignored.
 * Checked: what cameras_check does; the matrix is a rotation within 1e-3; camera_model is one of
 * core/base/lens.h or SIMPLE_PINHOLE (without one: perspective); k3 and k4 belong to a fisheye.
 * own:  cameras_free.
 * err:  ERR_IO, ERR_FORMAT, ERR_UNSUPPORTED (another camera_model, terms that it lacks), ERR_NOMEM.
 *       On error *out is zeroed. */
MUST_USE err_t transforms_read(const char *path, struct rig *out);

/* As transforms_read, from n bytes of text; `what` begins the sentence. */
MUST_USE err_t transforms_parse(const char *what, const void *text, size_t n, struct rig *out);

/* Whether a document has the list of frames that such a file has. */
struct cJSON;
bool transforms_is(const struct cJSON *doc);

/* Write a file whose images lie in the folder images/ beside it; ply: name of the points beside it,
 * or NULL.
 * err:  ERR_ARG (a fisheye and another lens: the file has one kind for all), ERR_IO, ERR_LIMIT (no
 *       space). The partial file is removed. */
MUST_USE err_t transforms_write(const char *path, const struct rig *rig, const char *ply);

/* Write points as binary PLY: x y z and red green blue.
 * err:  ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t transforms_write_points(const char *path, const struct colmap_points *points);

#endif
