/* collect.h - the session of the daemon of a rig of one camera (places.h): which takes are its
 * places, and when they become a scene. A command or a long press ends it.
 * thread: one. */
#ifndef DAEMON_COLLECT_H
#define DAEMON_COLLECT_H

#include "firmware/daemon/jobs.h"
#include "firmware/store/places.h"

#include <stdbool.h>
#include <stdio.h>

struct collect {
    const char *store;    // folder of the takes
    struct jobs *jobs;    // NULL: none are run
    int cameras;          // of the rig: views of a place
    bool on;              // takes are places; else only a session that is open is served
    bool ending;          // collect_end is to be called again
    struct places places; // of the open session
    char line[TAKE_TEXT]; // how things stand
};

/* Look at the disk: once before all others, and after each take that was stored.
 * err:  ERR_NOMEM */
MUST_USE err_t collect_look(struct collect *c);

/* Whether there may be one more place. err: ERR_LIMIT */
MUST_USE err_t collect_room(const struct collect *c);

/* The take becomes a place of the open session, or of a new one; not if they are not collected. */
void collect_take(const struct collect *c, struct take *t);

/* Reconstruct the places that are there; the session goes on.
 * err:  ERR_ARG (no session, too few places, no jobs), those of jobs_add */
MUST_USE err_t collect_scene(struct collect *c);

/* End the session and reconstruct it, if it has the places for that; *line says what came of it.
 * later: captures run that were asked for before; *ending asks for another call after them.
 * err:  ERR_ARG (no session), those of jobs_add and places_end: it stays open */
MUST_USE err_t collect_end(struct collect *c, bool later);

/* {"collect": true, "id": "", "places": 3, "line": "3 places so far"} */
void collect_write(const struct collect *c, FILE *out);

#endif
