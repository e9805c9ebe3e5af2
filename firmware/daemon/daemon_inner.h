/* daemon_inner.h - what the files of daemon.c share: no part of the interface. */
#ifndef DAEMON_DAEMON_INNER_H
#define DAEMON_DAEMON_INNER_H

#include "firmware/capture/session.h"
#include "firmware/capture/writer.h"
#include "firmware/daemon/calibrator.h"
#include "firmware/daemon/collect.h"
#include "firmware/daemon/ctl.h"
#include "firmware/daemon/daemon.h"
#include "firmware/daemon/http.h"
#include "firmware/daemon/summary.h"
#include "firmware/daemon/triggers.h"
#include "firmware/rig/boards.h"
#include "firmware/rig/message.h"

#include "drivers/device/lamp.h"

enum { DAEMON_RECENT = 12 }; // takes in the status

struct counters {
    long presses, takes, aborted, rejected, queued, coalesced, refused, clock_steps;
};

struct daemon {
    const struct daemon_config *cfg;
    const struct config *set;
    struct session *session; // NULL: not open yet
    struct store *store;
    struct writer *writer;
    struct jobs *jobs; // NULL: none are run
    struct ctl *ctl;
    struct http *http;     // NULL: no page
    struct boards *boards; // NULL: it is alone
    char parts_token[MESSAGE_TOKEN_CAP];
    struct lamp *lamp; // NULL: none
    struct triggers *triggers;
    struct collect collect;
    struct calibrator calibrator;
    int n_written; // takes that the writer has
    int signals, clock;
    bool stopping;
    int64_t start_ns, retry_ns, pet_ns, pet_every_ns, stop_ns;
    int n_waiting; // presses in the queue
    int64_t waiting[16];
    int n_asking; // clients that wait for a take
    uint64_t asking[CTL_CLIENTS_MAX];
    struct counters count;
    char trouble[TAKE_TEXT]; // what went wrong in the store or at the last press; "" for nothing
    int n_recent;
    struct summary recent[DAEMON_RECENT]; // newest first
};

/* ---- daemon_status.c ---- */

/* What it does or waits for. */
const char *daemon_status_sentence(struct daemon *d);

/* What camera sees while it waits, as JPEG; ctx: struct daemon.
 * own: free(*jpeg). err: ERR_ARG (no such camera), ERR_AGAIN (nothing was seen yet), ERR_NOMEM */
MUST_USE err_t daemon_status_live(void *ctx, int camera, void **jpeg, size_t *n);

/* status.json; ctx: struct daemon. */
void daemon_status_write(void *ctx, FILE *f);

#endif
