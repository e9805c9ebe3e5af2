/* member.h - one board of a rig: what it does when the conductor orders, and what it answers. Pure:
 * no network, no camera, no clock; all of that comes inside events, and goes out as actions.
 *
 *   AWAY     -> IDLE      the broker is reached and a conductor leads
 *   IDLE     -> METERING  order METER:  MEMBER_METER;  then METERED or FAILED is reported
 *   IDLE     -> SHOOTING  order SHOOT:  MEMBER_SHOOT;  then STORED or FAILED is reported
 *   METERING, SHOOTING -> IDLE   the work has ended; CANCEL only makes it end sooner
 *   any      -> AWAY      broker or conductor gone; work goes on and is reported when they are back
 *
 * Orders have a serial that rises within an epoch of the conductor. One that was seen is not done
 * again: its report is repeated. One of another epoch, for others, or older than one that was seen
 * is not done. A take that is in the store already is reported as STORED. A SHOOT order that comes
 * later than MEMBER_LATE_NS after its start is refused: after a restart a board knows no serials.
 * Parts stay in the store until RELEASE, and every announcement lists them, so a report that is
 * lost loses nothing.
 * thread: one. */
#ifndef RIG_MEMBER_H
#define RIG_MEMBER_H

#include "firmware/rig/message.h"

#define MEMBER_LATE_NS INT64_C(1000000000)

enum member_event_kind {
    MEMBER_UP,        // broker reached
    MEMBER_DOWN,      // broker lost
    MEMBER_CONDUCTOR, // conductor: a presence was received
    MEMBER_ORDER,     // order was received
    MEMBER_METERED,   // report->meter: METER is done
    MEMBER_STORED,    // report->part, starts, balance: SHOOT is done
    MEMBER_FAILED,    // report->reason: METER or SHOOT ended without a result
    MEMBER_HOLDS      // hold, n_holds: parts in the store, as read at the start or after a change
};

struct member_event {
    enum member_event_kind kind;
    bool common_known; // of ORDER: whether the common clock is known,
    int64_t common_ns; // and its present time
    const struct message_conductor *conductor;
    const struct message_order *order;
    const struct message_report *report;
    const struct message_hold *hold;
    int n_holds;
};

enum member_action_kind {
    MEMBER_ANNOUNCE, // publish the state
    MEMBER_METER,    // begin; ends with METERED or FAILED
    MEMBER_SHOOT,    // begin; ends with STORED or FAILED
    MEMBER_STOP,     // end the work that runs; it fails then
    MEMBER_RELEASE,  // remove the parts of `take` from the store; HOLDS follows
    MEMBER_REPORT    // publish member.report
};

struct member_action {
    enum member_action_kind kind;
    char take[TAKE_ID_CAP];
};

enum { MEMBER_ACTIONS = 8 };

struct member {
    char name[TAKE_MEMBER_CAP];
    bool up, led;
    char epoch[MESSAGE_EPOCH_CAP]; // the last conductor's
    struct message_order order;    // serial 0: none runs
    int64_t newest;                // serial of the newest order of this epoch
    struct message_report report;  // the last; serial 0: none in this epoch
    int n_holds;
    struct message_hold hold[MESSAGE_HOLDS];
    int n_actions;
    struct member_action action[MEMBER_ACTIONS];
};

/* name: by manifest_is_member */
void member_init(struct member *m, const char *name);

/* Handle an event; then call member_action until it is false. */
void member_event(struct member *m, const struct member_event *ev);
bool member_action(struct member *m, struct member_action *out);

#endif
