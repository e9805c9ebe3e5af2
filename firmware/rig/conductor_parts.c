/* What becomes of the parts of a take: those that fail, are left out, or wait for the owner. */
#include "firmware/rig/conductor_inner.h"

#include <stdio.h>
#include <string.h>

void conductor_parts_fail(struct conductor_take *t, int k, const char *why)
{
    t->part[k] = PART_FAILED;
    snprintf(t->why[k], sizeof t->why[k], "%.*s", (int)sizeof t->why[k] - 1, why);
}

/* A board that holds a part after all: its disk came late. */
static void take_back(struct conductor_take *t, int k)
{
    t->part[k] = PART_STORED;
    t->why[k][0] = 0;
}

void conductor_parts_look(struct conductor_take *t, int k, const struct conductor_member *m,
                          int64_t now_ns)
{
    const struct message_hold *held = m ? conductor_members_hold(m, t->order.take) : NULL;
    if (!m || !m->said.online)
        return;
    if (t->part[k] == PART_STORED && !held && !m->said.serial &&
        now_ns - t->ordered_ns > CONDUCTOR_IDLE_NS)
        conductor_parts_fail(t, k, "lost its part");
    if (t->part[k] == PART_FAILED && held && t->phase == TAKE_GATHERING && now_ns >= t->retry_ns[k])
        take_back(t, k);
    if (t->part[k] != PART_WAITS)
        return;
    const bool works = m->said.serial && (!t->order.serial || m->said.serial == t->order.serial);
    if (held && t->phase == TAKE_SHOOTING && !t->retry_ns[k]) {
        t->retry_ns[k] = now_ns + CONDUCTOR_RETRY_NS; // its report, with times, is on its way
    } else if (held && now_ns >= t->retry_ns[k]) {
        t->part[k] = PART_STORED;
    } else if (held) {
        return;
    } else if (t->boot[k][0] && strcmp(m->said.boot, t->boot[k]) != 0) {
        conductor_parts_fail(t, k, "was started again while it photographed");
    } else if (!works && now_ns - t->ordered_ns > CONDUCTOR_IDLE_NS &&
               now_ns - m->since_ns > CONDUCTOR_IDLE_NS) {
        conductor_parts_fail(t, k, t->order.serial ? "did not take the order" : "lost its part");
    } else if (now_ns - t->ordered_ns >
               CONDUCTOR_HANG_NS + (int64_t)(conductor_starts_s(&t->order) * 1e9)) {
        conductor_parts_fail(t, k, "does not come to an end");
    }
}

int conductor_parts_count(const struct conductor_take *t, enum conductor_part p)
{
    int n = 0;
    for (int k = 0; k < t->order.n; k++)
        n += t->part[k] == p;
    return n;
}

bool conductor_parts_first(const struct conductor_take *t, char why[TAKE_TEXT])
{
    for (int k = 0; k < t->order.n; k++)
        if (t->part[k] == PART_FAILED) {
            snprintf(why, TAKE_TEXT, "%s: %s", t->order.member[k], t->why[k]);
            return true;
        }
    return false;
}

static bool is_partial(const struct conductor *c, const struct conductor_take *t)
{
    return c->cfg.set->rig_partial || t->accepted;
}

bool conductor_parts_failed(const struct conductor *c, const struct conductor_take *t,
                            char why[TAKE_TEXT])
{
    return conductor_parts_first(t, why) &&
           (!is_partial(c, t) || conductor_parts_count(t, PART_FAILED) == t->order.n);
}

void conductor_parts_leave_out(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    for (int k = 0; k < t->order.n && is_partial(c, t); k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        const bool waits = t->part[k] == PART_WAITS || t->part[k] == PART_STORED;
        if (waits && (!m || !m->said.online) && now_ns - t->ordered_ns > CONDUCTOR_AWAY_NS &&
            (!m || now_ns - m->since_ns > CONDUCTOR_AWAY_NS))
            conductor_parts_fail(t, k, "is away");
    }
}

/* ---- the owner decides ---- */

static bool is_away(const struct conductor *c, const struct conductor_take *t, int k)
{
    for (int i = 0; i < c->n; i++)
        if (strcmp(c->member[i].name, t->order.member[k]) == 0)
            return !c->member[i].said.online;
    return true;
}

/* Whether it is here, or can be fetched now. */
static bool can_be_had(const struct conductor *c, const struct conductor_take *t, int k)
{
    return t->part[k] == PART_FETCHED || t->part[k] == PART_FETCHING ||
           (t->part[k] == PART_STORED && !is_away(c, t, k));
}

bool conductor_parts_choice(const struct conductor *c, const struct conductor_take *t,
                            char out[TAKE_TEXT])
{
    const char *id = t->order.take;
    char more[24] = "";
    int have = 0, missing = 0, first = -1;
    for (int k = 0; k < t->order.n; k++) {
        const bool open = t->part[k] == PART_WAITS || t->part[k] == PART_STORED;
        const bool misses = t->part[k] == PART_FAILED || (open && is_away(c, t, k));
        first = misses && first < 0 ? k : first;
        missing += misses;
        have += can_be_had(c, t, k);
    }
    if (t->phase != TAKE_GATHERING || is_partial(c, t) || first < 0)
        return false;
    if (missing > 1)
        snprintf(more, sizeof more, ", and %d more", missing - 1);
    snprintf(out, TAKE_TEXT,
             "%s: %.72s%s; %d of %d parts are there: hdrig rig accept %s joins these, hdrig rig "
             "forget %s gives them up",
             t->order.member[first], t->part[first] == PART_FAILED ? t->why[first] : "is away",
             more, have, t->order.n, id, id);
    return true;
}

err_t conductor_parts_accept(const struct conductor *c, struct conductor_take *t)
{
    int have = 0;
    for (int k = 0; k < t->order.n; k++)
        have += can_be_had(c, t, k);
    if (!have)
        return err_fail(ERR_LOST, "%s: no board that is there has a part of it", t->order.take);
    t->accepted = true;
    for (int k = 0; k < t->order.n; k++)
        if ((t->part[k] == PART_WAITS || t->part[k] == PART_STORED) && is_away(c, t, k))
            conductor_parts_fail(t, k, "is away");
    return OK;
}
