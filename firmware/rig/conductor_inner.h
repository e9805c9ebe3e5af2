/* conductor_inner.h - what the files of conductor.c share: no part of the interface. */
#ifndef RIG_CONDUCTOR_INNER_H
#define RIG_CONDUCTOR_INNER_H

#include "firmware/rig/conductor.h"

/* ---- conductor_members.c ---- */

/* NULL: never heard of; NULL: there are MESSAGE_MEMBERS already. */
struct conductor_member *conductor_members_find(struct conductor *c, const char *name);
struct conductor_member *conductor_members_add(struct conductor *c, const char *name);

/* The part of a take that a member has told of; NULL: none. */
const struct message_hold *conductor_members_hold(const struct conductor_member *m,
                                                  const char *take);

/* Only members that are listed take part, if some are. */
bool conductor_members_belongs(const struct conductor *c, const struct conductor_member *m);

/* Whether a member can take part now. err: ERR_LOST */
MUST_USE err_t conductor_members_check(const struct conductor *c, const struct conductor_member *m,
                                       int64_t now_ns);

/* Whether all that belong can, or some if `partial`. err: ERR_LOST, ERR_LIMIT (cameras) */
MUST_USE err_t conductor_members_check_all(const struct conductor *c, int64_t now_ns);

/* Whether a board meters for the rig. */
bool conductor_members_meters(const struct conductor *c, const char *name);

/* Enter the members of a press, in the order of their cameras, and those that cannot take part. */
void conductor_members_gather(const struct conductor *c, struct conductor_take *t, int64_t now_ns);

/* ---- conductor_parts.c ---- */

void conductor_parts_fail(struct conductor_take *t, int k, const char *why);
int conductor_parts_count(const struct conductor_take *t, enum conductor_part p);

/* What an announcement says about a part. m: NULL: its member is not known any more */
void conductor_parts_look(struct conductor_take *t, int k, const struct conductor_member *m,
                          int64_t now_ns);

/* The first part that failed, as a sentence; false: none. */
bool conductor_parts_first(const struct conductor_take *t, char why[TAKE_TEXT]);

/* The same, if it keeps the take from being joined. */
bool conductor_parts_failed(const struct conductor *c, const struct conductor_take *t,
                            char why[TAKE_TEXT]);

/* A partial take, or one that was accepted, does not wait for members that are away. */
void conductor_parts_leave_out(struct conductor *c, struct conductor_take *t, int64_t now_ns);

/* From now on it is partial, without those that are away. err: ERR_LOST (no part can be had) */
MUST_USE err_t conductor_parts_accept(const struct conductor *c, struct conductor_take *t);

/* ---- conductor_starts.c ---- */

/* Sum of an order's exposures, s. */
double conductor_starts_s(const struct message_order *o);

/* Enter the starts of part k. false: they are not of this take. */
bool conductor_starts_add(struct conductor_take *t, int k, const struct message_report *r);

/* List the starts of part k as well, for the status. */
void conductor_starts_list(struct conductor *c, const struct conductor_take *t, int k,
                           const struct message_report *r);

/* Largest difference between starts of one index so far, ns. */
int64_t conductor_starts_skew(const struct conductor_take *t);

/* Whether cameras began an exposure farther apart than bracket.skew_ms, and which. */
bool conductor_starts_apart(const struct conductor *c, const struct conductor_take *t,
                            char why[TAKE_TEXT]);

#endif
