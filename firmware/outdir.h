/* outdir.h - a folder of results that appears under its name only when complete.
 * Files are written into .tmp-NAME-PID beside it, synced and renamed. A former result of that name
 * is exchanged in one step and then removed. A crash leaves the old or the new folder whole, and at
 * worst a .tmp folder, which the next outdir_open of the same name removes: its owner is told alive
 * or dead by a lock on the folder. Every result holds report.json: that file tells a folder that
 * may be replaced from one that may not.
 * thread: any. */
#ifndef FIRMWARE_OUTDIR_H
#define FIRMWARE_OUTDIR_H

#include "drivers/file.h"

#include <stdint.h>

#define OUTDIR_REPORT "report.json"

struct outdir {
    char path[FILE_PATH_CAP]; // final name
    char tmp[FILE_PATH_CAP];  // where files are written now; "" if there is none
    uint64_t need;            // bytes, of the last outdir_reserve
    int fd;                   // of tmp, locked
};

/* Begin a result; its parents are created.
 * own:  outdir_close.
 * err:  ERR_ARG (path too long or names no folder of its own, or something there is not a former
 *       result and not empty), ERR_IO, ERR_BUSY. On error *o is zeroed. */
MUST_USE err_t outdir_open(const char *path, struct outdir *o);

/* Refuse to start writing `bytes` if the file system has less room.
 * err:  ERR_LIMIT with both figures, ERR_IO. */
MUST_USE err_t outdir_reserve(struct outdir *o, uint64_t bytes);

/* Create folder `name` inside.
 * err:  ERR_IO, ERR_ARG (path too long). */
MUST_USE err_t outdir_mkdir(struct outdir *o, const char *name);

/* Path of file `name` (may begin with a folder) inside.
 * err:  ERR_ARG (too long). */
MUST_USE err_t outdir_path(const struct outdir *o, const char *name, char path[FILE_PATH_CAP]);

/* What a failed write means: ERR_IO becomes ERR_LIMIT, with the bytes added to its sentence, if
 * there is less room than outdir_reserve asked for; anything else is returned as it is. */
MUST_USE err_t outdir_reason(const struct outdir *o, err_t e);

/* Sync folders and make the result visible.
 * err:  ERR_IO; then the former result, if any, is untouched. */
MUST_USE err_t outdir_commit(struct outdir *o);

/* Remove what was not committed. Accepts a zeroed struct. */
void outdir_close(struct outdir *o);

#endif
