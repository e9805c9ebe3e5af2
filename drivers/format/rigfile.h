/* rigfile.h - known cameras from any file that has them: a COLMAP folder, or one that holds
 * sparse/0 (colmap.h) or transforms.json; cameras.json (cameras.h); transforms.json (transforms.h);
 * poses_bounds_exps.npy (llff.h).
 * thread: any. */
#ifndef FORMAT_RIGFILE_H
#define FORMAT_RIGFILE_H

#include "drivers/format/cameras.h"
#include "drivers/format/file.h"

/* own:  cameras_free.
 * err:  those of the readers; ERR_UNSUPPORTED (another kind of file). On error *out is zeroed. */
MUST_USE err_t rigfile_read(const char *path, struct rig *out);

/* The first of sparse/0, transforms.json and poses_bounds_exps.npy beside the pictures of `dir` or
 * one folder up.
 * err:  ERR_ARG (path too long). */
MUST_USE err_t rigfile_find(const char *dir, bool *found, char path[FILE_PATH_CAP]);

#endif
