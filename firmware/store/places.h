/* places.h - takes of a rig of one camera are places of a session, which becomes one scene. All of
 * it is told by the disk: a take's manifest names its session, by the id of the session's first
 * take, and STORE/session-ended holds that of the session that was ended last. So the open session
 * is that of the newest complete take, unless it has been ended; it survives a restart and a power
 * cut, and places whose folders somebody removed are not counted.
 * thread: any. */
#ifndef STORE_PLACES_H
#define STORE_PLACES_H

#include "firmware/store/store.h"

#include "core/sfm/viewgraph.h"

/* MIN: views that a scene needs. MAX: views whose cameras can be found. */
enum { PLACES_MIN = 2, PLACES_MAX = VIEWGRAPH_VIEWS_MAX };

struct places {
    char id[STORE_ID_CAP]; // of the session; "": there is none
    int n;
    char take[PLACES_MAX][STORE_ID_CAP]; // oldest first
    struct develop balance;              // of their display pictures; zeroed: there are none
};

/* The open session of a store's folder, id "" without one. Takes that cannot be read are passed
 * over. err: ERR_NOMEM */
MUST_USE err_t places_open(const char *store, struct places *out);

/* The places of a session, open or not; the newest PLACES_MAX. err: ERR_NOMEM */
MUST_USE err_t places_of(const char *store, const char *session, struct places *out);

/* The session is over, on the disk when this returns.
 * err:  ERR_IO, ERR_LIMIT, ERR_ARG (somebody else's file has that name) */
MUST_USE err_t places_end(const char *store, const char *session);

#endif
