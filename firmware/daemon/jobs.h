/* jobs.h - reconstructions in the background: `hdrig reconstruct` as a child process, one at a
 * time, the oldest take first. A child that crashes or runs out of memory does not affect the
 * daemon. The id of a session stands for all its places (places.h) at the time when the job begins.
 * The queue survives the daemon: RESULTS/ID.pending stays until its reconstruction has ended. One
 * that was interrupted goes on from its checkpoint (firmware/result/resume.h), or, if that fails,
 * begins again.
 * thread: one. Nothing blocks but jobs_close. */
#ifndef DAEMON_JOBS_H
#define DAEMON_JOBS_H

#include "firmware/store/store.h"

#include <poll.h>
#include <stdbool.h>
#include <stdio.h>

enum { JOBS_MAX = 64, JOBS_TEXT = 200, JOBS_FDS = 2 };

struct jobs_config {
    const char *program;  // hdrig
    const char *captures; // folder of the takes
    const char *results;  // folder of the scenes; created
    const char *config;   // settings file for the child; NULL: none
    const char *launcher; // words before the program, "mpirun --hostfile FILE"; "" or NULL: none
};

enum jobs_end { JOBS_NONE, JOBS_DONE, JOBS_FAILED, JOBS_CANCELLED };

struct jobs_state {
    bool running;
    char id[STORE_ID_CAP]; // of the running job
    char line[JOBS_TEXT];  // its last line
    int waiting;           // behind it
    enum jobs_end last;    // how the one before ended
    char last_id[STORE_ID_CAP], last_line[JOBS_TEXT];
    int last_warnings; // their number; they are in the log
    bool changed;      // since the last look
};

struct jobs;

/* Queues the pending jobs of a former daemon.
 * own:  jobs_close.
 * err:  ERR_IO (folder), ERR_ARG (path too long, launcher of too many words), ERR_NOMEM */
MUST_USE err_t jobs_open(const struct jobs_config *cfg, struct jobs **out);

/* Asks the child to stop, waits 5 s at most, then kills it; the queue stays pending. */
void jobs_close(struct jobs *j);

/* An id that is queued already is not added again.
 * err:  ERR_LIMIT (JOBS_MAX wait), ERR_IO (pending file) */
MUST_USE err_t jobs_add(struct jobs *j, const char *id);

/* End the running one. */
void jobs_cancel(struct jobs *j);

int jobs_poll(const struct jobs *j, struct pollfd *fds, int cap); // at most JOBS_FDS
void jobs_step(struct jobs *j);                                   // start, listen, reap
void jobs_look(struct jobs *j, struct jobs_state *out);

/* The same as "job": {...} of the status; NULL: none are run. */
void jobs_write(struct jobs *j, FILE *f);

#endif
