/* outdir.h - a folder of results that appears under its name only when complete.
 * Files are written into the folder of partial.h, listed (filelist.h), synced and renamed with
 * it. A former result of that name is exchanged in one step and then removed. A crash leaves the
 * old or the new folder whole, and at worst a .tmp folder, which the next outdir_open of the same
 * name removes. A folder is replaced only if it has the list of files that we wrote, nothing else
 * lies in it, these files are unchanged, and it is not an input: no file of the user is lost.
 * thread: any. */
#ifndef RESULT_OUTDIR_H
#define RESULT_OUTDIR_H

#include "firmware/result/report.h"

#include "drivers/format/partial.h"

#include <stdint.h>

#define OUTDIR_REPORT "report.json"

enum { OUTDIR_INPUTS = 72 };

/* Limits of what is replaced. */
struct outdir_rules {
    const char *inputs[OUTDIR_INPUTS]; // paths that this work reads, NULL: none
    bool force;                        // also a former result whose files were changed since
};

struct outdir {
    char path[FILE_PATH_CAP]; // final name
    struct partial partial;   // its folder is where files are written now
    uint64_t need;            // bytes, of the last outdir_reserve
    bool force;
};

/* Begin a result; its parents are created. rules: NULL: no inputs, no force.
 * own:  outdir_close.
 * err:  ERR_ARG (path too long or names no folder of its own; something there is not empty and
 *       not a former result as outdir.h has it, which the sentence names), ERR_IO, ERR_NOMEM,
 *       ERR_LIMIT (no space), ERR_BUSY. On error *o is zeroed. */
MUST_USE err_t outdir_open(const char *path, const struct outdir_rules *rules, struct outdir *o);

/* Refuse to start writing `bytes` if the file system has less room.
 * err:  ERR_LIMIT with both figures, ERR_IO. */
MUST_USE err_t outdir_reserve(struct outdir *o, uint64_t bytes);

/* Create folder `name` inside.
 * err:  ERR_IO, ERR_ARG (path too long). */
MUST_USE err_t outdir_mkdir(struct outdir *o, const char *name);

/* Path of file `name` (may begin with a folder) inside.
 * err:  ERR_ARG (too long). */
MUST_USE err_t outdir_path(const struct outdir *o, const char *name, char path[FILE_PATH_CAP]);

/* Begin report.json with an object that is left open, and end both.
 * err:  ERR_IO, ERR_LIMIT (no space). */
MUST_USE err_t outdir_report_open(const struct outdir *o, struct report *rep);
MUST_USE err_t outdir_report_close(const struct outdir *o, struct report *rep);

/* The reason of a failed write: ERR_IO becomes ERR_LIMIT, with the bytes added to its sentence, if
 * there is less room than outdir_reserve asked for; anything else is returned as it is. */
MUST_USE err_t outdir_reason(const struct outdir *o, err_t e);

/* List the files, sync folders and make the result visible.
 * err:  ERR_IO, ERR_LIMIT (no space), ERR_ARG (the former result has changed meanwhile), ERR_NOMEM;
 *       then the former result, if any, is untouched. */
MUST_USE err_t outdir_commit(struct outdir *o);

/* Remove everything that was not committed. Accepts a zeroed struct. */
void outdir_close(struct outdir *o);

#endif
