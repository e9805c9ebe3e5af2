/* progress.h - progress of a job, on stderr.
 * On a terminal one line that is written again and again; elsewhere a plain line at the start, at
 * each tenth and at the end of a stage. Implements progress_fn of core/base/types.h.
 * thread: the one that runs the job. */
#ifndef BASE_PROGRESS_H
#define BASE_PROGRESS_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

struct progress {
    FILE *f;             // not owned
    bool terminal, open; // open: the line on the terminal has no newline yet
    char stage[32];
    int tenth; // last tenth shown
    int first; // steps done at the first call of the stage, at start_ns
    int64_t start_ns, shown_ns;
};

/* f: where to write; a terminal is recognised. */
void progress_init(struct progress *p, FILE *f);

/* The progress_fn; ctx is a struct progress. note: appended, "" or NULL for none. */
void progress_step(void *ctx, const char *stage, int done, int total, const char *note);

/* End an open line, before something else is written to the terminal. */
void progress_end(struct progress *p);

/* One line: "refine 43 % step 430/1000, 12 s left, loss 0.031". seconds_left: shown if it
 * rounds to a second or more; < 0: not known. Returns buf. */
const char *progress_line(const char *stage, int done, int total, double seconds_left,
                          const char *note, char buf[160]);

#endif
