/* conductor.h - the board that leads a rig: who is there, one press for all, and each take until it
 * is whole in one place. Pure: no network, no disk, no clock; time comes inside events.
 *
 * Itself:
 *   OFF     -> LISTEN   the broker is reached
 *   LISTEN  -> LEADS    no other conductor was heard for CONDUCTOR_LISTEN_NS
 *   any     -> REFUSED  another one leads: of two that do, the one that started first goes on
 *   REFUSED -> LISTEN   it has left
 *   any     -> OFF      the broker is lost; what runs on the members goes on
 *
 * A take, by parts, one for each member that takes part (enum conductor_part):
 *   METERING  -> RECORDING  every member that meters has reported, or none needs to
 *   RECORDING -> SHOOTING   the order is on the disk, with the take's id: only then it is published
 *   SHOOTING  -> GATHERING  every part is stored, and its frames were taken together
 *   SHOOTING  -> RECORDING  they were not, or a member failed: the press is shot again, under
 *                           another id, CONDUCTOR_TRIES times in all
 *   GATHERING -> JOINING    every part is fetched; of a partial take, or one that was ACCEPTed,
 *                           every part that can be had
 *   JOINING   -> done       the joint take is on the disk; members are told to RELEASE their parts,
 *                           again whenever one announces a part of a take that is on the disk
 *   any       -> DROPPING   no part of it is left, its frames were not taken together, it was
 *                           cancelled or given up (FORGET): the reason is told
 *   DROPPING  -> DROPPED    that is on the disk
 *   DROPPED   -> done       no member has a part of it any more
 * A member that goes away while it shoots leaves the take in GATHERING: it is asked again when it
 * is back. One that is back, does not work on the take and holds no part of it never will, unless
 * its disk comes late. Neither that nor a part that was lost makes the conductor drop the parts of
 * others: the press ends with a sentence, and the take waits until its owner says ACCEPT (join what
 * is there) or FORGET. With `partial` it goes on without. An ACCEPT is forgotten when the conductor
 * is started again: the take waits as before.
 *
 * Invariants: parts are released only when the joint take is on the conductor's disk, or the take
 * was dropped on it; a take is joined only of parts that members stored under its id; every press
 * ends with a joint take, or with a sentence that names what is missing and why, or waits for a
 * member that the status names.
 * thread: one. */
#ifndef RIG_CONDUCTOR_H
#define RIG_CONDUCTOR_H

#include "firmware/rig/message.h"
#include "firmware/rig/rigplan.h"

enum { CONDUCTOR_TAKES = 32, CONDUCTOR_ACTIONS = 256, CONDUCTOR_TRIES = 3 };

#define CONDUCTOR_LISTEN_NS INT64_C(1500000000)
#define CONDUCTOR_LEAD_NS INT64_C(150000000)    // from the order to its start, beyond members' own
#define CONDUCTOR_IDLE_NS INT64_C(5000000000)   // a member that does not follow by then never will
#define CONDUCTOR_HANG_NS INT64_C(300000000000) // beyond the exposures: shooting and storing
#define CONDUCTOR_AWAY_NS INT64_C(15000000000)  // a partial take does not wait longer
#define CONDUCTOR_RETRY_NS INT64_C(2000000000)  // between tries to fetch a part
#define CONDUCTOR_METER_NS INT64_C(30000000000)
#define CONDUCTOR_SILENT_NS INT64_C(20000000000) // announces nothing: hangs, or was locked out
#define CONDUCTOR_EARLY_NS INT64_C(1000000000)   // frames that begin outside of start - EARLY to
#define CONDUCTOR_LATE_NS INT64_C(60000000000)   // start + exposures + LATE are not of the take

enum conductor_state { CONDUCTOR_OFF, CONDUCTOR_LISTEN, CONDUCTOR_LEADS, CONDUCTOR_REFUSED };

enum conductor_part {
    PART_WAITS,  // ordered, or its member is away
    PART_STORED, // on the member
    PART_FETCHING,
    PART_FETCHED, // on the conductor
    PART_FAILED,  // there is none and will be none: `why`
    PART_GONE     // of a dropped take: the member has none
};

enum conductor_phase {
    TAKE_FREE,
    TAKE_METERING,
    TAKE_RECORDING,
    TAKE_SHOOTING,
    TAKE_GATHERING,
    TAKE_JOINING,
    TAKE_DROPPING,
    TAKE_DROPPED
};

struct conductor_member {
    char name[TAKE_MEMBER_CAP];
    bool listed; // in rig.member.N
    struct message_member said;
    int64_t since_ns; // it is there, or away, since then
    int64_t heard_ns; // last announcement
};

struct conductor_take {
    enum conductor_phase phase;
    struct message_order order; // members, exposures, id
    enum conductor_part part[MESSAGE_MEMBERS];
    char boot[MESSAGE_MEMBERS]
             [MESSAGE_EPOCH_CAP]; // of the member, when it was ordered; "": not known
    char why[MESSAGE_MEMBERS][96];
    int64_t retry_ns[MESSAGE_MEMBERS];
    int n_out; // boards that could not take part, if partial
    char out[MESSAGE_MEMBERS][TAKE_MEMBER_CAP];
    int64_t ordered_ns; // when members were asked last
    int tries;
    bool stopped;           // members were told to end it
    bool asked;             // someone waits for the outcome of the press
    bool told;              // that a part is missing, which ended the press
    bool accepted;          // joined of what is there
    char reason[TAKE_TEXT]; // why it was dropped; else a warning, or ""
    /* frames seen so far, by index: the earliest and the latest start, and whose they are */
    bool has_start[BRACKET_EXPOSURES_MAX];
    int64_t first_ns[BRACKET_EXPOSURES_MAX], last_ns[BRACKET_EXPOSURES_MAX];
    int first_of[BRACKET_EXPOSURES_MAX], last_of[BRACKET_EXPOSURES_MAX];
    int64_t within_ns; // the worst
};

enum conductor_event_kind {
    CONDUCTOR_UP,
    CONDUCTOR_DOWN,
    CONDUCTOR_OTHER,    // conductor: a presence was received, perhaps its own
    CONDUCTOR_MEMBER,   // name, member
    CONDUCTOR_REPORT,   // name, report
    CONDUCTOR_PRESS,    // a trigger; `asked`: someone waits for the outcome
    CONDUCTOR_CANCEL,   // end the press that runs
    CONDUCTOR_RECORDED, // answer to RECORD: its order, take (the new id), err, text
    CONDUCTOR_FETCHED,  // answer to FETCH: take, name, err, text; report: starts of its
                        // frames, balance of its pictures
    CONDUCTOR_JOINED,   // answer to JOIN: take, err, text
    CONDUCTOR_DROPPED,  // answer to DROP: take, err
    CONDUCTOR_MEMORY,   // order: of a take that was not finished when the last conductor ended;
                        // RELEASE: that was dropped
    CONDUCTOR_FORGET,   // take: the user gives it up; or a board that was taken away
    CONDUCTOR_ACCEPT,   // take: the user wants what there is of it
    CONDUCTOR_TICK      // when nothing that was announced is left unread
};

struct conductor_event {
    enum conductor_event_kind kind;
    int64_t now_ns; // CLOCK_MONOTONIC
    const struct message_conductor *conductor;
    const char *name, *take;
    const struct message_member *member;
    const struct message_report *report;
    const struct message_order *order;
    bool asked;
    err_t err;
    const char *text;
};

enum conductor_action_kind {
    CONDUCTOR_CLAIM,  // publish the conductor's presence
    CONDUCTOR_ORDER,  // publish conductor_action.order
    CONDUCTOR_RECORD, // give the take an id and put its order on the disk
    CONDUCTOR_FETCH,  // fetch `part` of `take` from `name`
    CONDUCTOR_JOIN,   // join the parts of `take` from the members of `order`
    CONDUCTOR_DROP,   // note on the disk that `take` is dropped, remove its parts there
    CONDUCTOR_CLEAR,  // nothing of `take` is left anywhere: forget it
    CONDUCTOR_REMOVE, // clear the retained state of the board `name`
    CONDUCTOR_TELL    // the press has ended: err, text (the id of the joint take, or a sentence)
};

struct conductor_action {
    enum conductor_action_kind kind;
    struct message_order order;
    char take[TAKE_ID_CAP], name[TAKE_MEMBER_CAP];
    struct message_hold part; // FETCH
    int n_missing;            // JOIN: boards that the take lacks
    char missing[MESSAGE_MEMBERS][TAKE_MEMBER_CAP];
    bool asked;
    err_t err;
    char text[TAKE_TEXT];
};

struct conductor_config {
    const struct config *set;      // bracket.*, rig.*
    char epoch[MESSAGE_EPOCH_CAP]; // later ones are greater by strcmp
    char board[TAKE_MEMBER_CAP];
    const char *version;
    int64_t common_ns; // common clock - CLOCK_MONOTONIC
    // the joint take is on the disk, with that member's part
    bool (*has)(void *ctx, const char *take, const char *member);
    void *ctx;
};

/* Starts of the frames of the order with that serial, as they are told. */
struct conductor_starts {
    int64_t serial;
    int n;
    struct conductor_start {
        char member[TAKE_MEMBER_CAP];
        int camera, index;
        int64_t common_ns;
    } v[MESSAGE_MEMBERS * BRACKET_EXPOSURES_MAX];
};

/* How the last press ended. */
struct conductor_last {
    int64_t serial;
    char take[TAKE_ID_CAP]; // "": none was, or it ended before it had an id
    err_t err;
    char text[TAKE_TEXT];
    int n;                                              // exposures
    int64_t apart_ns[BRACKET_EXPOSURES_MAX], within_ns; // largest difference between its starts
};

struct conductor {
    struct conductor_config cfg;
    enum conductor_state state;
    char other[TAKE_MEMBER_CAP]; // who leads instead
    int64_t listen_ns, serial;
    int n;
    struct conductor_member member[MESSAGE_MEMBERS]; // listed ones first
    struct conductor_take take[CONDUCTOR_TAKES];
    int current;  // take that is pressed, in METERING to SHOOTING; -1: none
    int n_meters; // what the cameras of the current take want
    struct message_meter meter[MESSAGE_MEMBERS * BRACKET_CAMERAS_MAX];
    float red, blue;                // balance of the last take; 0: none
    struct conductor_starts starts; // of the newest order
    struct conductor_last last;
    int n_actions;
    struct conductor_action action[CONDUCTOR_ACTIONS];
};

/* err: ERR_ARG (names of rig.member.N) */
MUST_USE err_t conductor_init(struct conductor *c, const struct conductor_config *cfg);

/* Handle an event; then call conductor_action until it is false.
 * err:  of PRESS, why there is none: ERR_BUSY (one runs), ERR_LOST (broker, members that are not
 *       there, not ready, of another version, or do not know the time well enough), ERR_LIMIT (too
 *       many takes wait); of FORGET and CANCEL: ERR_ARG; of ACCEPT: ERR_ARG, ERR_LOST (no
 *       part) */
MUST_USE err_t conductor_event(struct conductor *c, const struct conductor_event *ev);
bool conductor_action(struct conductor *c, struct conductor_action *out);

/* What a take in GATHERING lacks, and the commands that end it; false: nothing, or it does not wait
 * for that. */
bool conductor_parts_choice(const struct conductor *c, const struct conductor_take *t,
                            char out[TAKE_TEXT]);

/* When a TICK is due, CLOCK_MONOTONIC. */
int64_t conductor_deadline(const struct conductor *c, int64_t now_ns);

/* Why a press would be refused now; ERR_BUSY, ERR_LOST, ERR_LIMIT as above, or OK. */
MUST_USE err_t conductor_check(const struct conductor *c, int64_t now_ns);

#endif
