/* places.h - takes of a rig of one camera are places of a session, which becomes one scene. The
 * whole state is on the disk: a take's manifest names its session by the id of the session's first
 * take, and STORE/session-ended holds the id of the session that was ended last. The open session
 * is that of the newest complete take, unless it has been ended; it survives a restart and a power
 * cut, and places whose folders were removed do not count.
 * thread: any. */
#ifndef STORE_PLACES_H
#define STORE_PLACES_H

#include "firmware/store/store.h"

/* MIN: views that a scene needs. MAX: folders that a command takes. */
enum { PLACES_MIN = 2, PLACES_MAX = 64 };

struct places {
    char id[STORE_ID_CAP]; // id of the session; "": there is none
    int n;
    char take[PLACES_MAX][STORE_ID_CAP]; // oldest first
    struct develop balance; // how their display pictures are developed; zeroed: there are none
};

/* The open session of a store's folder, id "" without one. Takes that cannot be read are
 * skipped. err: ERR_NOMEM */
MUST_USE err_t places_open(const char *store, struct places *out);

/* The places of a session, open or not; the newest PLACES_MAX. err: ERR_NOMEM */
MUST_USE err_t places_of(const char *store, const char *session, struct places *out);

/* End the session; durable when this returns.
 * err:  ERR_IO, ERR_LIMIT, ERR_ARG (another program's file has that name) */
MUST_USE err_t places_end(const char *store, const char *session);

#endif
