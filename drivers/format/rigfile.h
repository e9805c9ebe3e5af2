/* rigfile.h - known cameras from any file that has them: a COLMAP folder, or one that holds
 * sparse/0 (colmap.h) or transforms.json; cameras.json (cameras.h); transforms.json (transforms.h).
 * thread: any. */
#ifndef FORMAT_RIGFILE_H
#define FORMAT_RIGFILE_H

#include "drivers/format/cameras.h"

/* own:  cameras_free.
 * err:  those of the readers; ERR_UNSUPPORTED (another kind of file). On error *out is zeroed. */
MUST_USE err_t rigfile_read(const char *path, struct rig *out);

#endif
