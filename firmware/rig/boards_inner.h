/* boards_inner.h - what the files of boards.c share: no part of the interface. */
#ifndef RIG_BOARDS_INNER_H
#define RIG_BOARDS_INNER_H

#include "firmware/rig/boards.h"
#include "firmware/rig/conductor.h"
#include "firmware/rig/member.h"
#include "firmware/rig/rigclock.h"
#include "firmware/rig/tasks.h"

#include "drivers/net/mqtt.h"

/* A camera of a calibrated rig from above: where it stands and looks, in its units; y is down. */
struct boards_view {
    bool known;
    float x, z, dx, dz;
};

struct boards {
    struct boards_config cfg;
    const struct config *set;
    struct mqtt *mqtt;
    struct tasks *disk;
    struct tasks *fetch[BOARDS_FETCHERS]; // of a conductor: parts of several boards at a time
    char broker[TAKE_TEXT];               // why it is not reached; "" if it is
    char boot[MESSAGE_EPOCH_CAP], epoch[MESSAGE_EPOCH_CAP], token[MESSAGE_TOKEN_CAP];
    int64_t heard_ns;      // when the present message was read
    int64_t press_sent_ns; // the last press of a member
    bool has_member, has_conductor;
    /* the member */
    struct member member;
    struct rigclock clock;
    int64_t ask_ns, said_ns;
    bool contradicts, reports; // reports: `report` waits for the list of parts
    struct message_report report;
    struct message_member said;
    /* the conductor */
    struct conductor conductor;
    struct conductor_action action;
    struct boards_view view[MESSAGE_MEMBERS]; // of rig.file, by the camera's number in joint takes
    struct message_member heard;
    struct task task;
};

/* ---- boards_act.c ---- */

/* Carry out the actions of the member's machine. */
void boards_act_member(struct boards *b);

/* Its work has ended so. */
void boards_act_report(struct boards *b, enum member_event_kind kind,
                       const struct message_report *r);
void boards_act_failed(struct boards *b, const char *text);

/* Publish the state of the member; that this board leaves. */
void boards_act_announce(struct boards *b);
void boards_act_leave(struct boards *b);

/* Pass an event to the conductor and carry out its actions. err: as conductor_event; ERR_ARG (this
 * board is none). boards_act_tell: if it is one, errors to the log. */
MUST_USE err_t boards_act_lead(struct boards *b, struct conductor_event ev);
void boards_act_tell(struct boards *b, struct conductor_event ev);

/* QoS 0 for ASK and TIME. */
void boards_act_publish_time(struct boards *b, enum message_topic t, const char *member,
                             const struct message_time *m);

/* An error goes to the log. */
void boards_act_add(struct tasks *t, const struct task *k);

/* ---- boards_hear.c ---- */

/* An event of the broker. */
void boards_hear(struct boards *b, const struct mqtt_event *m);

#endif
