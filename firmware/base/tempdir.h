/* tempdir.h - a folder for files that nobody needs when the program has ended: in that of the
 * environment's TMPDIR, else in /tmp.
 * thread: any. */
#ifndef BASE_TEMPDIR_H
#define BASE_TEMPDIR_H

#include "drivers/format/file.h"

/* Make one that only this user may enter; `name` begins its name.
 * own:  tempdir_remove.
 * err:  ERR_ARG (path too long), ERR_LIMIT (no space), ERR_IO. On error *path is "". */
MUST_USE err_t tempdir_make(const char *name, char path[FILE_PATH_CAP]);

/* With everything in it. Accepts "". */
void tempdir_remove(const char *path);

#endif
