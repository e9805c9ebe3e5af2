/* tasks.h - what a board of a rig does on its disk and over the network while its loop goes on: one
 * thread each, tasks one after the other in the order of tasks_add, each with an outcome.
 * thread: all functions from one thread; the store may be used by its writer meanwhile. */
#ifndef RIG_TASKS_H
#define RIG_TASKS_H

#include "firmware/rig/message.h"
#include "firmware/store/store.h"

#include <stdatomic.h>

enum task_kind {
    TASK_RECORD,  // give the order a take's id, and begin that take
    TASK_FETCH,   // fetch `hold` of `member` from url with `token`; report: starts of its frames
    TASK_OWN,     // the same from the store itself
    TASK_JOIN,    // commit the take of `order`'s members
    TASK_DROP,    // note that `take` is dropped, remove what was fetched of it
    TASK_CLEAR,   // remove what is left of it
    TASK_RELEASE, // remove the store's own part of `take`; then as HOLDS
    TASK_HOLDS    // list the store's own parts: hold[]
};

struct task {
    enum task_kind kind;
    struct message_order order; // RECORD, JOIN, DROP
    char take[TAKE_ID_CAP];     // RECORD: out
    char member[TAKE_MEMBER_CAP];
    struct message_hold part;
    char url[128]; // "http://HOST:PORT"
    char token[MESSAGE_TOKEN_CAP];
    struct clocks trigger; // JOIN
    bool clock_synced;
    int n_missing;
    char missing[MESSAGE_MEMBERS][TAKE_MEMBER_CAP];
    /* outcome */
    err_t err;
    char text[TAKE_TEXT];
    struct message_report report;
    uint64_t bytes; // FETCH: of the part
    double took_s;
    int n_holds;
    struct message_hold hold[MESSAGE_HOLDS];
};

struct tasks;

/* name: of the thread, at most 15 bytes.
 * own:  tasks_close. err: ERR_NOMEM, ERR_IO */
MUST_USE err_t tasks_open(const char *name, struct store *s, const char *store_path,
                          struct tasks **out);

/* Ends the task that runs (fetching at once, the disk when it is done) and drops those that wait.
 * Accepts NULL. */
void tasks_close(struct tasks *t);

/* A copy of *task. err: ERR_NOMEM */
MUST_USE err_t tasks_add(struct tasks *t, const struct task *task);

int tasks_fd(const struct tasks *t); // readable when an outcome waits

/* false: none waits. */
bool tasks_outcome(struct tasks *t, struct task *out);

#endif
