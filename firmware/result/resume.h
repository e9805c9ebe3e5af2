/* resume.h - the checkpoint of a job: the state of its refinement (core/refine/refine.h) in a file
 * .NAME.checkpoint beside its result NAME, until the result is complete. A job that was interrupted
 * goes on from there to the same bytes.
 * The file: "hdrig checkpoint", the SHA-256 of the program in 64 digits, the state, the SHA-256 of
 * all that in 64 digits. It appears only when complete. Another program, which may compute other
 * numbers, does not go on from it.
 * thread: the one that runs the job. */
#ifndef RESULT_RESUME_H
#define RESULT_RESUME_H

#include "firmware/result/outdir.h"

#include "core/base/sha256.h"
#include "core/refine/refine.h"

struct resume {
    struct refine_saver saver; // for the job; it points to this struct, which must not move
    struct outdir *out;
    char path[FILE_PATH_CAP], at[FILE_PATH_CAP]; // its name; where it is written
    char program[SHA256_HEX_CAP];
    struct file_map map; // what the job goes on from
    double every_s, next_s, began_s;
    FILE *f;
    struct sha256 sum;
    int step;
    bool ends, failed; // failed: was told
};

/* Checkpoints of the job that writes to `out`: one every `every_s` seconds, and one when it is
 * cancelled; no more than a hundredth of the time is spent on them. go_on: from the last one, if
 * there is one. What keeps a checkpoint from being written is told, and the job goes on.
 * own:  resume_close.
 * err:  ERR_FORMAT (damaged), ERR_ARG (of another program; path too long), ERR_IO. */
MUST_USE err_t resume_open(struct outdir *out, double every_s, bool go_on, struct resume *s);

/* Whether the result at `path` has a checkpoint. */
bool resume_has(const char *path);

/* Remove the checkpoint of the result at `path`, which is complete or no longer wanted. */
void resume_forget(const char *path);

/* Accepts a zeroed struct. */
void resume_close(struct resume *s);

#endif
