/* message.h - what the boards of a rig say to each other over MQTT: topics and payloads, version 1
 * (firmware/rig/README.md 2). Payloads are JSON objects of at most MESSAGE_MAX bytes; unknown keys
 * are ignored, so that a later version may add some. Everything that is read is hostile.
 * Pure; any thread. */
#ifndef RIG_MESSAGE_H
#define RIG_MESSAGE_H

#include "firmware/capture/take.h"
#include "firmware/store/manifest.h"

#include "core/base/rig.h"
#include "core/base/sha256.h"

#include <stdio.h>

enum {
    MESSAGE_MAX = 65536,
    MESSAGE_TOPIC_CAP = 128,
    MESSAGE_MEMBERS = RIG_CAMERAS_MAX, // boards of a rig
    MESSAGE_HOLDS = 64,                // parts that a member tells of
    MESSAGE_EPOCH_CAP = 17,
    MESSAGE_WORD_CAP = 32,
    MESSAGE_TOKEN_CAP = 33,
    MESSAGE_HOST_CAP = 64
};

/* Exposure times in messages, s at gain 1. */
#define MESSAGE_TIME_MIN_S 1e-9
#define MESSAGE_TIME_MAX_S 1e4

/* Topics below hdrig/1/RIG/; all but the conductor's own end in /MEMBER. */
enum message_topic {
    MESSAGE_CONDUCTOR, // conductor's presence: retained, with a last will
    MESSAGE_ORDER,     // conductor to all members
    MESSAGE_TIME,      // conductor to one member: answer to MESSAGE_ASK
    MESSAGE_MEMBER,    // member's state: retained, with a last will
    MESSAGE_REPORT,    // member's answer to an order
    MESSAGE_ASK,       // member asks for the common time
    MESSAGE_PRESS,     // a trigger of a member was pressed
    MESSAGE_TOPICS
};

/* member: NULL for topics without one; "+" for a filter. */
void message_topic(const char *rig, enum message_topic t, const char *member,
                   char out[MESSAGE_TOPIC_CAP]);

/* The kind of a topic of that rig, and the name at its end ("" for those without).
 * returns: MESSAGE_TOPICS if it is none of them. */
enum message_topic message_kind(const char *rig, const char *topic, char member[TAKE_MEMBER_CAP]);

/* MESSAGE_CONDUCTOR */
struct message_conductor {
    bool online;
    char epoch[MESSAGE_EPOCH_CAP]; // one run of a conductor; hex digits
    char board[TAKE_MEMBER_CAP];
    char version[MESSAGE_WORD_CAP];
};

/* A part of a rig's take. Its manifest proves all its other files, and is proved by this. */
struct message_hold {
    char take[TAKE_ID_CAP], part[TAKE_ID_CAP];
    int64_t bytes; // of the manifest
    char sha256[SHA256_HEX_CAP];
};

/* MESSAGE_MEMBER */
struct message_member {
    bool online;
    char boot[MESSAGE_EPOCH_CAP];  // one run of a member; hex digits
    char epoch[MESSAGE_EPOCH_CAP]; // conductor that it follows
    char version[MESSAGE_WORD_CAP];
    char host[MESSAGE_HOST_CAP]; // where its parts are: an address, a port, and the token for them
    int port;
    char token[MESSAGE_TOKEN_CAP];
    int cameras;
    bool ready;               // would take an order now
    int64_t lead_ns;          // how long before its start an order must come (session_lead_s)
    char sentence[TAKE_TEXT]; // what it does or waits for
    double free_mb;
    bool clock_known;
    int64_t within_ns; // common clock, as it knows it
    char clock[16];    // "exchange" or "kernel"
    int64_t serial;    // order that it works on; 0: none
    int n_holds;       // newest first
    struct message_hold hold[MESSAGE_HOLDS];
};

enum message_order_kind { MESSAGE_METER, MESSAGE_SHOOT, MESSAGE_CANCEL, MESSAGE_RELEASE };

/* MESSAGE_ORDER */
struct message_order {
    enum message_order_kind kind;
    char epoch[MESSAGE_EPOCH_CAP]; // of the conductor that sent it
    int64_t serial;                // rises within an epoch; CANCEL: of the order that it ends
    char take[TAKE_ID_CAP];        // of SHOOT and RELEASE
    int n;                         // who is meant, each with
    char member[MESSAGE_MEMBERS][TAKE_MEMBER_CAP];
    int turn[MESSAGE_MEMBERS]; // the turn of its first camera, if staggered
    int64_t start_ns;          // SHOOT: on the common clock, when the first frame begins
    int n_times;
    double time_s[BRACKET_EXPOSURES_MAX]; // at gain 1
    bool stagger;
    float red, blue; // balance of display pictures; 0: measured
};

enum message_report_kind { MESSAGE_METERED, MESSAGE_STORED, MESSAGE_FAILED };

struct message_start { // of a frame
    int camera, index;
    int64_t common_ns, within_ns;
};

/* MESSAGE_REPORT */
struct message_report {
    enum message_report_kind kind;
    char epoch[MESSAGE_EPOCH_CAP];
    int64_t serial;
    char take[TAKE_ID_CAP], part[TAKE_ID_CAP]; // STORED
    char reason[TAKE_TEXT];                    // FAILED
    int n_cameras;                             // METERED: the exposures that each wants
    struct message_meter {
        int n;
        double time_s[BRACKET_EXPOSURES_MAX];
    } meter[BRACKET_CAMERAS_MAX];
    int n_starts; // STORED
    struct message_start start[TAKE_FRAMES_MAX];
    float red, blue; // STORED: balance of its pictures; 0: there is none
};

/* MESSAGE_ASK and MESSAGE_TIME: four stamps, ns. The member's are on its CLOCK_MONOTONIC, the
 * conductor's on the common clock. */
struct message_time {
    char epoch[MESSAGE_EPOCH_CAP];
    int64_t sent_ns;            // by the member
    int64_t got_ns, replied_ns; // by the conductor
    bool disciplined;           // the conductor's CLOCK_REALTIME is kept right:
    int64_t real_ns, within_ns; // what it says at replied_ns, and its largest error
};

/* Write a payload. Errors are those of the stream. */
void message_write_conductor(const struct message_conductor *m, FILE *f);
void message_write_member(const struct message_member *m, FILE *f);
void message_write_order(const struct message_order *m, FILE *f);
void message_write_report(const struct message_report *m, FILE *f);
void message_write_time(const struct message_time *m, FILE *f);

/* Read n bytes of one; an empty payload and a known key that is there twice are refused. What was
 * read can be written. Sentences are cut to their place; in them, controls and bytes that are not
 * UTF-8 become blanks.
 * err:  ERR_FORMAT naming the key, ERR_NOMEM. On error *out is zeroed. */
MUST_USE err_t message_read_conductor(const char *text, size_t n, struct message_conductor *out);
MUST_USE err_t message_read_member(const char *text, size_t n, struct message_member *out);
MUST_USE err_t message_read_order(const char *text, size_t n, struct message_order *out);
MUST_USE err_t message_read_report(const char *text, size_t n, struct message_report *out);
MUST_USE err_t message_read_time(const char *text, size_t n, struct message_time *out);

/* Position of a member among those that are meant; -1: it is not. */
int message_find(const struct message_order *m, const char *member);

#endif
