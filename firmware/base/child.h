/* child.h - runs another program as a child process and reads its lines meanwhile.
 * thread: one. Nothing blocks but child_stop. */
#ifndef BASE_CHILD_H
#define BASE_CHILD_H

#include "core/base/err.h"

#include <poll.h>
#include <stdbool.h>
#include <stddef.h>
#include <sys/types.h>

enum { CHILD_LINE = 512, CHILD_FDS = 2 };

/* Zeroed: none runs. */
struct child {
    pid_t pid; // 0: none runs
    int pidfd, pipe;
    char part[CHILD_LINE]; // the begun line
    size_t n_part;
};

typedef void child_line_fn(void *ctx, const char *line); // not empty, without its end

/* argv[0] is a path, or a name in PATH. Its stderr is read, and its stdout too if `all`; else
 * stdout is discarded.
 * own:  child_ended or child_stop.
 * err:  ERR_IO, ERR_NOMEM */
MUST_USE err_t child_start(struct child *c, char *const argv[], bool all);

int child_poll(const struct child *c, struct pollfd *fds, int cap); // at most CHILD_FDS

/* The lines that have come; those beyond CHILD_LINE are cut. */
void child_listen(struct child *c, child_line_fn *fn, void *ctx);

/* Whether it has ended, with its last lines.
 * out:  *status is that of waitpid. */
bool child_ended(struct child *c, child_line_fn *fn, void *ctx, int *status);

void child_cancel(const struct child *c); // asks it to end
void child_stop(struct child *c);         // asks, waits 5 s at most, then kills

#endif
