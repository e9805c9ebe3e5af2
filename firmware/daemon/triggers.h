/* triggers.h - the triggers of a rig: reads those that are present and retries the others. Presses
 * that follow another one too soon are counted and dropped.
 * thread: one. Nothing blocks but the opening of a device. */
#ifndef DAEMON_TRIGGERS_H
#define DAEMON_TRIGGERS_H

#include "firmware/base/config.h"

#include "drivers/device/trigger.h"

#include <poll.h>

struct triggers_config {
    const char (*uri)[CONFIG_TEXT]; // CONFIG_TRIGGERS of them, "" for none
    int lockout_ms;
    int hold_ms; // a press of that length is a long one, and presses count when they end; 0: a
                 // press counts when it begins, and none is long
    err_t (*find)(const char *uri, const struct trigger_ops **out); // backends_trigger
    void (*press)(void *ctx, int64_t time_ns, bool is_long);
    void *ctx;
};

struct triggers_count {
    long locked_out, lost_edges;
};

struct triggers;

/* own:  triggers_close. err: ERR_ARG (URI), ERR_NOMEM */
MUST_USE err_t triggers_open(const struct triggers_config *cfg, struct triggers **out);
void triggers_close(struct triggers *t); // accepts NULL

/* Descriptors to wait for; returns their number, at most CONFIG_TRIGGERS. */
int triggers_poll(const struct triggers *t, struct pollfd *fds, int cap);

/* Open missing devices, read waiting events.
 * err:  ERR_ARG: a retry does not help. */
MUST_USE err_t triggers_step(struct triggers *t, int64_t now_ns);

void triggers_look(const struct triggers *t, struct triggers_count *out);

#endif
