/* boards.h - the daemon's side of a rig of several boards: it connects the machines of member.h
 * and conductor.h with the broker, the store, the network and the daemon's cameras. A conductor
 * that has cameras is a member of its own rig, too.
 * thread: one, the daemon's. Nothing blocks but boards_open and boards_close. */
#ifndef RIG_BOARDS_H
#define RIG_BOARDS_H

#include "firmware/base/config.h"
#include "firmware/capture/schedule.h"
#include "firmware/store/store.h"

#include <poll.h>
#include <stdio.h>

struct boards_config {
    const struct config *set; // rig.role is not alone
    const char *version;
    struct store *store;
    int cameras;       // of this board
    int http_port;     // where its parts are served; 0: not
    const char *token; // that opens them to the conductor: boards_open_token
    void *ctx;
    /* Whether an order could be followed now, else why not, as a sentence. */
    const char *(*trouble)(void *ctx);
    double (*lead_s)(void *ctx); // session_lead_s
    /* Begin a take, end it. err: as session_begin and the store's */
    err_t (*begin)(void *ctx, const struct session_order *o);
    void (*stop)(void *ctx);
    /* A press has ended: OK and the id of the joint take, which is stored, or a sentence. */
    void (*told)(void *ctx, err_t err, const char *id, const char *text, bool asked);
};

enum { BOARDS_FETCHERS = 4, BOARDS_FDS = 2 + BOARDS_FETCHERS };

struct boards;

/* The name of this board: rig.board, else the host's, in the letters that names have.
 * err:  ERR_ARG */
MUST_USE err_t boards_open_name(const struct config *set, char out[TAKE_MEMBER_CAP]);

/* A new random token, MESSAGE_TOKEN_CAP bytes: for each run of the daemon. err: ERR_IO */
MUST_USE err_t boards_open_token(char *out);

/* err:  ERR_ARG (names, broker, settings that do not fit a role), ERR_IO (password, certificate),
 *       ERR_NOMEM */
MUST_USE err_t boards_open(const struct boards_config *cfg, struct boards **out);
void boards_close(struct boards *b); // accepts NULL

int boards_poll(const struct boards *b, struct pollfd *fds, int cap, int64_t *deadline_ns);
void boards_step(struct boards *b);

/* A press on this board: it is the rig's. asked: someone waits for told().
 * err:  why there is none: as conductor_event; ERR_LOST (member: no conductor), ERR_UNSUPPORTED
 *       (member: wait for the outcome at the conductor) */
MUST_USE err_t boards_press(struct boards *b, bool asked);

/* End the press that runs. err: ERR_ARG (none runs, or this is a member) */
MUST_USE err_t boards_cancel(struct boards *b);

/* Give up a take that waits, a part that nobody wants, a board that was taken away.
 * err:  ERR_ARG (also: this is no conductor) */
MUST_USE err_t boards_forget(struct boards *b, const char *what);

/* Join what there is of a take that waits. err: ERR_ARG (also: no conductor), ERR_LOST (no part) */
MUST_USE err_t boards_accept(struct boards *b, const char *take);

/* Whether a press runs that this board leads. */
bool boards_is_busy(const struct boards *b);

/* Whether a take that begin() began is under way: all takes of a board are the rig's. */
bool boards_works(const struct boards *b);

/* The take that begin() began has ended. true: it is to be stored, and is marked as a part with
 * times of the common clock; false: it was only for metering. */
bool boards_take(struct boards *b, struct take *t);

/* It is stored, or was not: e, text. */
void boards_stored(struct boards *b, const struct take *t, const char *id, err_t e,
                   const char *text);

/* Why a press would be refused, as a sentence; NULL: it would not. */
const char *boards_trouble(const struct boards *b);

#endif
