/* partial.h - files that appear under their names only when complete. Until then they are in a
 * folder .tmp-NAME-PID beside NAME; a lock on that folder shows that its process is alive, the file
 * FILELIST_PARTIAL in it that it is ours. The next partial_open for the same NAME removes what a
 * dead process left. Only files of ours are replaced (origin.h).
 * thread: any. */
#ifndef FORMAT_PARTIAL_H
#define FORMAT_PARTIAL_H

#include "drivers/format/file.h"

struct partial {
    char dir[FILE_PATH_CAP]; // "" if there is none
    int fd;                  // dir, locked
};

/* Begin the file or folder for `path`, whose parent folder exists.
 * own:  partial_close.
 * err:  ERR_ARG (path too long, or its end is no name), ERR_BUSY (this process writes there, or
 *       another one just removes the same leftovers), ERR_IO, ERR_LIMIT (no space). On error *p is
 *       zeroed. */
MUST_USE err_t partial_open(const char *path, struct partial *p);

/* The temporary place of the file for `path`.
 * err:  ERR_ARG (path too long). */
MUST_USE err_t partial_path(const struct partial *p, const char *path, char out[FILE_PATH_CAP]);

/* Sync that file and make it visible; a file at `path`, on the same file system, is replaced in one
 * step.
 * err:  ERR_ARG (another program's file is at `path`), ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t partial_show(const struct partial *p, const char *path);

/* The folder itself is about to be made visible: it loses its mark.
 * err:  ERR_IO. */
MUST_USE err_t partial_unmark(const struct partial *p);

/* Remove everything that was not shown. Accepts a zeroed struct. */
void partial_close(struct partial *p);

#endif
