/* ctl.h - the control socket: lines of text in, one line of JSON out for each.
 *   status            state of the daemon
 *   capture [wait]    take a capture; with wait the answer comes when it is stored or aborted
 *   session           places of the open session (places.h)
 *   session end       end it, and reconstruct it
 *   session scene     reconstruct its places now; it goes on
 *   calibrate [WHAT SECONDS]  calibrate all cameras; lines {"line": TEXT} come before the answer
 *   accept ID         of a rig: join what there is of a capture that waits
 *   forget ID|BOARD   of a rig: give up a capture that waits, or a board that was taken away
 *   cancel            end the running take, calibration or reconstruction
 * Lines end with a newline, CTL_LINE_MAX bytes at most. The permissions of its folder say who
 * may send commands.
 * thread: one. Nothing blocks but ctl_ask. */
#ifndef DAEMON_CTL_H
#define DAEMON_CTL_H

#include "core/base/err.h"

#include <poll.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CTL_CLIENTS_MAX = 8, CTL_LINE_MAX = 256, CTL_ANSWER_MAX = 1 << 20 };

/* One line of a client; `id` is for ctl_answer, now or later. */
typedef void ctl_line_fn(void *ctx, uint64_t id, const char *line);

struct ctl;

/* Replaces a socket that no process serves any more.
 * own:  ctl_close, which removes the socket.
 * err:  ERR_ARG (path too long), ERR_BUSY (another daemon serves it), ERR_IO, ERR_NOMEM */
MUST_USE err_t ctl_open(const char *path, ctl_line_fn *fn, void *ctx, struct ctl **out);
void ctl_close(struct ctl *c); // accepts NULL

/* Descriptors to wait for; returns their number, at most 1 + CTL_CLIENTS_MAX. */
int ctl_poll(const struct ctl *c, struct pollfd *fds, int cap);

/* Serve everything that waits. A client that breaks a rule gets an error and is dropped. */
void ctl_step(struct ctl *c);

/* Answer with a line (without its newline, below CTL_ANSWER_MAX); a client that has gone, or does
 * not read, is dropped. */
void ctl_answer(struct ctl *c, uint64_t id, const char *json);

/* Send a line to a daemon and wait for the answer, at most timeout_s; 0: for ever.
 * out:  CTL_ANSWER_MAX bytes.
 * err:  ERR_LOST (no daemon there; says how to start it), ERR_IO (no permission: names the group;
 *       connection broke), ERR_TIMEOUT, ERR_ARG (path too long) */
MUST_USE err_t ctl_ask(const char *path, const char *line, double timeout_s, char *out);

/* As ctl_ask without a limit; more() gets every line and returns false for the answer.
 * err:  also ERR_CANCELLED, by a signal. */
typedef bool ctl_more_fn(void *ctx, const char *json);
MUST_USE err_t ctl_follow(const char *path, const char *line, ctl_more_fn *more, void *ctx,
                          char *out);

#endif
