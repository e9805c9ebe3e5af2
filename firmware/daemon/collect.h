/* collect.h - the daemon's session for a rig of one camera (places.h): takes become its places, and
 * the places become a scene when a command or a long press ends it.
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
    int cameras;          // in the rig: views of a place
    bool on;              // takes are places; else only an open session is served
    bool ending;          // collect_end is to be called again
    struct places places; // places of the open session
    char line[TAKE_TEXT]; // state in words
};

/* Read the session from the disk: before all other calls, and after each stored take.
 * err:  ERR_NOMEM */
MUST_USE err_t collect_look(struct collect *c);

/* Refuse one place too many. err: ERR_LIMIT */
MUST_USE err_t collect_room(const struct collect *c);

/* Make the take a place of the open session or of a new one, if takes are collected. */
void collect_take(const struct collect *c, struct take *t);

/* Reconstruct the places so far; the session goes on.
 * err:  ERR_ARG (no session, too few places, no jobs), those of jobs_add */
MUST_USE err_t collect_scene(struct collect *c);

/* End the session and reconstruct it, if it has the places for that; *line has the
 * outcome. later: captures that were requested before still run; *ending then asks for another
 * call. err:  ERR_ARG (no session), those of jobs_add and places_end: it stays open */
MUST_USE err_t collect_end(struct collect *c, bool later);

/* {"collect": true, "id": "", "places": 3, "line": "3 places so far"} */
void collect_write(const struct collect *c, FILE *out);

#endif
