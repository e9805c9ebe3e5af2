/* boards_status.h - the rig in the daemon's status: the object "rig" of status.json.
 *   role, name, board, state, sentence, ready     of this board
 *   members[], takes[], last, views[]             of a conductor: boards and what they say of
 *                                                 themselves; unfinished takes, by parts; starts of
 *                                                 the last take; cameras seen from above, where
 *                                                 rig.file has them
 * thread: the daemon's. */
#ifndef RIG_BOARDS_STATUS_H
#define RIG_BOARDS_STATUS_H

#include "firmware/rig/boards.h"

void boards_status_write(const struct boards *b, FILE *f);

#endif
