/* ghosts.h - what moved between the exposures of a take's brackets, before it is stored.
 * thread: any. */
#ifndef STORE_GHOSTS_H
#define STORE_GHOSTS_H

#include "firmware/capture/take.h"
#include "firmware/store/store_fs.h"

/* Compare the frames of each camera that has several: `compared` and `ghost` of frames are set,
 * once. If more than `share` (> 0; 0: never) of a picture moved, the take's reason says so.
 * Frames that cannot be compared, which the log says, have no mask.
 * own:  the masks are the take's. Returns whether there are any. */
bool ghosts_note(struct take *t, double share);

/* Write a frame's mask as a picture of its size: 0 where it differs, 255 elsewhere.
 * err:  ERR_NOMEM, those of writing. */
MUST_USE err_t ghosts_write(const struct store_fs *fs, const struct take *t,
                            const struct take_frame *f, const char *path);

#endif
