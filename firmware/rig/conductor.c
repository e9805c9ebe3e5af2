#include "firmware/rig/conductor.h"

#include "firmware/rig/conductor_inner.h"

#include <string.h>

#define SECOND INT64_C(1000000000)

/* ---- actions ---- */

static struct conductor_action *add_action(struct conductor *c, enum conductor_action_kind kind)
{
    if (c->n_actions == CONDUCTOR_ACTIONS)
        c->n_actions--; // see has_room
    struct conductor_action *a = &c->action[c->n_actions++];
    *a = (struct conductor_action){.kind = kind};
    return a;
}

/* Whether actions that come in numbers, and come again, may be added: the others find room then. */
static bool has_room(const struct conductor *c)
{
    return c->n_actions < CONDUCTOR_ACTIONS / 2;
}

static void act_on_take(struct conductor *c, enum conductor_action_kind kind,
                        const struct conductor_take *t)
{
    struct conductor_action *a = add_action(c, kind);
    a->order = t->order;
    memcpy(a->take, t->order.take, sizeof a->take);
}

static void order(struct conductor *c, const struct message_order *o, enum message_order_kind kind)
{
    struct conductor_action *a = add_action(c, CONDUCTOR_ORDER);
    a->order = *o;
    a->order.kind = kind;
    memcpy(a->order.epoch, c->cfg.epoch, sizeof a->order.epoch);
}

static void tell(struct conductor *c, const struct conductor_take *t, err_t err, const char *text)
{
    struct conductor_action *a = add_action(c, CONDUCTOR_TELL);
    a->asked = t->asked;
    a->err = err;
    memcpy(a->take, t->order.take, sizeof a->take);
    snprintf(a->text, sizeof a->text, "%s", text);
    c->last =
        (struct conductor_last){.serial = t->order.serial, .err = err, .within_ns = t->within_ns};
    memcpy(c->last.take, a->take, sizeof c->last.take);
    memcpy(c->last.text, a->text, sizeof c->last.text);
    for (int i = 0; i < BRACKET_EXPOSURES_MAX && t->has_start[i]; i++)
        c->last.apart_ns[c->last.n++] = t->last_ns[i] - t->first_ns[i];
}

err_t conductor_check(const struct conductor *c, int64_t now_ns)
{
    int used = 0;
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        used += c->take[i].phase != TAKE_FREE;
    if (c->state == CONDUCTOR_REFUSED)
        return err_fail(ERR_LOST, "%s leads this rig: a rig has one conductor", c->other);
    if (c->state != CONDUCTOR_LEADS)
        return err_fail(ERR_LOST, c->state == CONDUCTOR_OFF ? "the broker is not reached"
                                                            : "begins to lead the rig");
    if (c->current >= 0)
        return err_fail(ERR_BUSY, "a capture runs");
    if (used == CONDUCTOR_TAKES)
        return err_fail(ERR_LIMIT,
                        "%d captures wait for members: bring those back, or end them with hdrig "
                        "rig accept ID or hdrig rig forget ID",
                        used);
    return conductor_members_check_all(c, now_ns);
}

static struct conductor_take *free_take(struct conductor *c)
{
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        if (c->take[i].phase == TAKE_FREE)
            return &c->take[i];
    return NULL;
}

/* ---- takes ---- */

static struct conductor_take *find_take(struct conductor *c, const char *id)
{
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        if (c->take[i].phase != TAKE_FREE && strcmp(c->take[i].order.take, id) == 0)
            return &c->take[i];
    return NULL;
}

static bool is_current(const struct conductor *c, const struct conductor_take *t)
{
    return c->current >= 0 && t == &c->take[c->current];
}

/* The take cannot become whole. */
static void drop_take(struct conductor *c, struct conductor_take *t, const char *why)
{
    snprintf(t->reason, sizeof t->reason, "%s", why);
    if (is_current(c, t)) {
        order(c, &t->order, MESSAGE_CANCEL);
        c->current = -1;
    }
    tell(c, t, ERR_LOST, t->reason);
    t->asked = false;
    if (!t->order.take[0]) { // nothing was recorded
        t->phase = TAKE_FREE;
        return;
    }
    t->phase = TAKE_DROPPING;
    act_on_take(c, CONDUCTOR_DROP, t);
}

static void record_take(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    t->phase = TAKE_RECORDING;
    t->order.kind = MESSAGE_SHOOT;
    t->order.take[0] = 0;
    t->order.serial = ++c->serial;
    c->starts = (struct conductor_starts){.serial = c->serial};
    memcpy(t->order.epoch, c->cfg.epoch, sizeof t->order.epoch);
    t->order.red = c->red;
    t->order.blue = c->blue;
    t->order.start_ns = now_ns + c->cfg.common_ns + CONDUCTOR_LEAD_NS; // about: see on_recorded
    t->within_ns = 0;
    for (int i = 0; i < t->order.n; i++) {
        t->part[i] = PART_WAITS;
        t->boot[i][0] = t->why[i][0] = 0;
        t->retry_ns[i] = 0;
    }
    memset(t->has_start, 0, sizeof t->has_start);
    act_on_take(c, CONDUCTOR_RECORD, t);
}

static void plan_take(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    struct rigplan plan;
    if (rigplan_make(c->cfg.set, c->meter, c->n_meters, &plan) != OK) {
        drop_take(c, t, err_text());
        return;
    }
    t->order.n_times = plan.n;
    memcpy(t->order.time_s, plan.time_s, sizeof plan.time_s);
    record_take(c, t, now_ns);
}

/* Those that do not meter have done so. */
static err_t begin_metering(struct conductor *c, struct conductor_take *t)
{
    struct message_order o = t->order;
    o.n = 0;
    for (int k = 0; k < t->order.n; k++) {
        if (conductor_members_meters(c, t->order.member[k]))
            memcpy(o.member[o.n++], t->order.member[k], TAKE_MEMBER_CAP);
        else
            t->part[k] = PART_STORED;
    }
    if (!o.n)
        return err_fail(ERR_LOST, "none of rig.meter = %s can photograph now",
                        c->cfg.set->rig_meter);
    t->phase = TAKE_METERING;
    t->order.serial = o.serial = ++c->serial;
    order(c, &o, MESSAGE_METER);
    return OK;
}

static err_t on_press(struct conductor *c, const struct conductor_event *ev)
{
    err_t e = conductor_check(c, ev->now_ns);
    if (e)
        return e;
    struct conductor_take *t = free_take(c);
    *t = (struct conductor_take){.asked = ev->asked, .ordered_ns = ev->now_ns, .tries = 1};
    t->order.stagger = c->cfg.set->bracket_stagger != 0;
    conductor_members_gather(c, t, ev->now_ns);
    c->n_meters = 0;
    e = rigplan_is_metered(c->cfg.set) ? begin_metering(c, t) : OK;
    if (e)
        return e;
    c->current = (int)(t - c->take);
    if (t->phase != TAKE_METERING)
        plan_take(c, t, ev->now_ns);
    return OK;
}

/* ---- shooting and gathering ---- */

static void begin_gathering(struct conductor *c, struct conductor_take *t)
{
    t->phase = TAKE_GATHERING;
    if (is_current(c, t))
        c->current = -1;
}

/* All boards are as they were when the order was given: none was started again or is away. */
static bool are_there(struct conductor *c, const struct conductor_take *t)
{
    bool all = true;
    for (int k = 0; k < t->order.n && all; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        all = m && m->said.online && strcmp(m->said.boot, t->boot[k]) == 0;
    }
    return all;
}

/* Shot, but not well: once more under another id if all members are still there, else given up. */
static void shoot_again(struct conductor *c, struct conductor_take *t, const char *why,
                        int64_t now_ns)
{
    struct conductor_take *next = free_take(c);
    if (!is_current(c, t) || t->tries >= CONDUCTOR_TRIES || !next || !are_there(c, t)) {
        drop_take(c, t, why);
        return;
    }
    *next = (struct conductor_take){.order = t->order, .asked = t->asked, .tries = t->tries + 1};
    next->ordered_ns = now_ns;
    c->current = (int)(next - c->take);
    t->asked = false;
    t->phase = TAKE_DROPPING;
    snprintf(t->reason, sizeof t->reason, "%s", why);
    act_on_take(c, CONDUCTOR_DROP, t);
    record_take(c, next, now_ns);
}

/* While members shoot. A member that is away does not keep the rig from the next press. Once one
 * was cut off it is not shot again, and the parts of the others are wanted. */
static void follow_shooting(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    char why[TAKE_TEXT];
    bool all = true;
    for (int k = 0; k < t->order.n; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        conductor_parts_look(t, k, m, now_ns);
        all = all && (t->part[k] != PART_WAITS || !m || !m->said.online);
    }
    conductor_parts_leave_out(c, t, now_ns);
    const bool failed = conductor_parts_failed(c, t, why), there = are_there(c, t);
    if (failed && there && !t->stopped) { // those that fail later were stopped for it
        memcpy(t->reason, why, sizeof t->reason);
        order(c, &t->order, MESSAGE_CANCEL);
        t->stopped = true;
    }
    if (!all || (c->cfg.set->rig_partial && conductor_parts_count(t, PART_WAITS) > 0))
        return; // until it is left out, or back
    if (t->stopped) {
        memcpy(why, t->reason, sizeof why);
        shoot_again(c, t, why, now_ns);
    } else if (conductor_starts_apart(c, t, why))
        shoot_again(c, t, why, now_ns);
    else
        begin_gathering(c, t);
}

static void fetch_parts(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    for (int k = 0; k < t->order.n; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        const struct message_hold *held = m ? conductor_members_hold(m, t->order.take) : NULL;
        if (t->part[k] != PART_STORED || !held || !m->said.online || now_ns < t->retry_ns[k] ||
            !has_room(c))
            continue;
        t->part[k] = PART_FETCHING;
        struct conductor_action *a = add_action(c, CONDUCTOR_FETCH);
        memcpy(a->take, t->order.take, sizeof a->take);
        memcpy(a->name, t->order.member[k], sizeof a->name);
        a->part = *held;
    }
}

static void join_parts(struct conductor *c, struct conductor_take *t)
{
    char why[TAKE_TEXT];
    t->phase = TAKE_JOINING;
    struct conductor_action *a = add_action(c, CONDUCTOR_JOIN);
    memcpy(a->take, t->order.take, sizeof a->take);
    a->order = t->order;
    a->order.n = 0; // those whose parts there are
    for (int k = 0; k < t->order.n; k++)
        if (t->part[k] == PART_FETCHED)
            memcpy(a->order.member[a->order.n++], t->order.member[k], TAKE_MEMBER_CAP);
        else
            memcpy(a->missing[a->n_missing++], t->order.member[k], TAKE_MEMBER_CAP);
    for (int i = 0; i < t->n_out && a->n_missing < MESSAGE_MEMBERS; i++)
        memcpy(a->missing[a->n_missing++], t->out[i], TAKE_MEMBER_CAP);
    if (conductor_parts_first(t, why))
        memcpy(t->reason, why, sizeof t->reason);
    snprintf(a->text, sizeof a->text, "%s", t->reason);
}

/* A part that was lost does not take those of the others with it: the press ends with a sentence,
 * and the owner decides. */
static void follow_gathering(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    char why[TAKE_TEXT];
    for (int k = 0; k < t->order.n; k++)
        conductor_parts_look(t, k, conductor_members_find(c, t->order.member[k]), now_ns);
    conductor_parts_leave_out(c, t, now_ns);
    const bool failed = conductor_parts_failed(c, t, why);
    if (failed && conductor_parts_count(t, PART_FAILED) == t->order.n) {
        drop_take(c, t, why);
        return;
    }
    fetch_parts(c, t, now_ns);
    if (failed && !t->told) {
        t->told = true;
        conductor_parts_choice(c, t, why);
        tell(c, t, ERR_LOST, why);
        t->asked = false;
    }
    const int open =
        t->order.n - conductor_parts_count(t, PART_FETCHED) - conductor_parts_count(t, PART_FAILED);
    if (failed || open > 0)
        return;
    if (conductor_starts_apart(c, t, why)) {
        drop_take(c, t, why);
        return;
    }
    join_parts(c, t);
}

/* A dropped take stays in memory until every member was seen without a part of it. */
static void follow_dropped(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    if (now_ns - t->ordered_ns < CONDUCTOR_IDLE_NS) // the order may still be on its way
        return;
    for (int k = 0; k < t->order.n; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        if (m && m->said.online && !conductor_members_hold(m, t->order.take) &&
            (!m->said.serial || m->said.serial != t->order.serial))
            t->part[k] = PART_GONE;
    }
    if (conductor_parts_count(t, PART_GONE) < t->order.n)
        return;
    act_on_take(c, CONDUCTOR_CLEAR, t);
    t->phase = TAKE_FREE;
}

/* A member that goes away while it meters has lost the press. */
static void follow_metering(struct conductor *c, struct conductor_take *t, int64_t now_ns)
{
    char why[TAKE_TEXT];
    for (int k = 0; k < t->order.n; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        if (t->part[k] == PART_WAITS && m && !m->said.online)
            conductor_parts_fail(t, k, "went away while it metered");
        else if (t->part[k] == PART_WAITS && now_ns - t->ordered_ns > CONDUCTOR_METER_NS)
            conductor_parts_fail(t, k, "did not meter in time");
    }
    if (conductor_parts_failed(c, t, why))
        drop_take(c, t, why);
    else if (conductor_parts_count(t, PART_WAITS) == 0)
        plan_take(c, t, now_ns);
}

static void follow_takes(struct conductor *c, int64_t now_ns)
{
    for (int i = 0; i < CONDUCTOR_TAKES; i++) {
        struct conductor_take *t = &c->take[i];
        if (t->phase == TAKE_SHOOTING)
            follow_shooting(c, t, now_ns);
        if (t->phase == TAKE_GATHERING)
            follow_gathering(c, t, now_ns);
        if (t->phase == TAKE_DROPPED)
            follow_dropped(c, t, now_ns);
        if (t->phase == TAKE_METERING)
            follow_metering(c, t, now_ns);
    }
}

/* ---- members ---- */

/* Parts that need not be kept any more: their take is on the disk, or was dropped there. Parts of
 * takes that this conductor does not know are left alone. */
static void release_parts(struct conductor *c, const struct conductor_member *m)
{
    for (int i = 0; i < m->said.n_holds; i++) {
        const char *id = m->said.hold[i].take;
        const struct conductor_take *t = find_take(c, id);
        if (t ? t->phase != TAKE_DROPPED : !c->cfg.has(c->cfg.ctx, id, m->name))
            continue;
        if (!has_room(c))
            return; // with the next announcement
        struct message_order o = {.n = 1};
        memcpy(o.member[0], m->name, sizeof m->name);
        snprintf(o.take, sizeof o.take, "%s", id);
        order(c, &o, MESSAGE_RELEASE);
    }
}

static void on_member(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_member *m = conductor_members_find(c, ev->name);
    if (!m)
        m = conductor_members_add(c, ev->name);
    if (!m)
        return;
    if (m->said.online != ev->member->online || !m->since_ns ||
        strcmp(m->said.boot, ev->member->boot) != 0)
        m->since_ns = ev->now_ns;
    m->said = *ev->member;
    m->heard_ns = ev->now_ns;
    if (c->state == CONDUCTOR_LEADS && m->said.online)
        release_parts(c, m);
}

static void on_metered(struct conductor *c, struct conductor_take *t, int k,
                       const struct message_report *r)
{
    if (t->part[k] != PART_WAITS)
        return;
    if (r->kind == MESSAGE_FAILED) {
        conductor_parts_fail(t, k, r->reason);
        return;
    }
    t->part[k] = PART_STORED;
    for (int i = 0; i < r->n_cameras; i++)
        c->meter[c->n_meters++] = r->meter[i];
}

static void on_shot(struct conductor *c, struct conductor_take *t, int k,
                    const struct message_report *r)
{
    if (t->part[k] != PART_WAITS || strcmp(r->take, t->order.take) != 0)
        return;
    if (r->kind == MESSAGE_FAILED) {
        conductor_parts_fail(t, k, r->reason);
    } else if (r->kind == MESSAGE_STORED && !conductor_starts_add(t, k, r)) {
        conductor_parts_fail(t, k, "its frames are of another time");
    } else if (r->kind == MESSAGE_STORED) {
        conductor_starts_list(c, t, k, r);
        t->part[k] = PART_STORED;
        t->retry_ns[k] = 0;
    }
}

static void on_report(struct conductor *c, const struct conductor_event *ev)
{
    const struct message_report *r = ev->report;
    const bool is_ours = strcmp(r->epoch, c->cfg.epoch) == 0;
    for (int i = 0; i < CONDUCTOR_TAKES && is_ours; i++) {
        struct conductor_take *t = &c->take[i];
        const int k = message_find(&t->order, ev->name);
        if (t->phase == TAKE_FREE || t->order.serial != r->serial || k < 0)
            continue;
        if (t->phase == TAKE_METERING && r->kind != MESSAGE_STORED)
            on_metered(c, t, k, r);
        else if (t->phase == TAKE_SHOOTING || t->phase == TAKE_GATHERING)
            on_shot(c, t, k, r);
    }
}

/* ---- answers ---- */

static void on_recorded(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = c->current >= 0 ? &c->take[c->current] : NULL;
    if (!t || t->phase != TAKE_RECORDING || t->order.serial != ev->order->serial) {
        if (!ev->err) // cancelled meanwhile
            memcpy(add_action(c, CONDUCTOR_CLEAR)->take, ev->take, strlen(ev->take) + 1);
        return;
    }
    if (ev->err) {
        drop_take(c, t, ev->text);
        return;
    }
    snprintf(t->order.take, sizeof t->order.take, "%s", ev->take);
    t->ordered_ns = ev->now_ns;
    int64_t lead_ns = 0;
    for (int k = 0; k < t->order.n; k++) {
        const struct conductor_member *m = conductor_members_find(c, t->order.member[k]);
        memcpy(t->boot[k], m->said.boot, sizeof t->boot[k]);
        lead_ns = m->said.lead_ns > lead_ns ? m->said.lead_ns : lead_ns;
    }
    t->order.start_ns = ev->now_ns + c->cfg.common_ns + CONDUCTOR_LEAD_NS + lead_ns;
    t->phase = TAKE_SHOOTING;
    order(c, &t->order, MESSAGE_SHOOT);
}

static void on_fetched(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = find_take(c, ev->take);
    const int k = t ? message_find(&t->order, ev->name) : -1;
    if (k < 0 || t->part[k] != PART_FETCHING || t->phase != TAKE_GATHERING)
        return;
    if (ev->err == ERR_FORMAT) {
        conductor_parts_fail(t, k, ev->text);
        t->retry_ns[k] = INT64_MAX; // what is there is not one
    } else if (ev->err) {
        t->part[k] = PART_STORED;
        t->retry_ns[k] = ev->now_ns + CONDUCTOR_RETRY_NS;
        snprintf(t->why[k], sizeof t->why[k], "%s", ev->text);
    } else if (!conductor_starts_add(t, k, ev->report)) {
        conductor_parts_fail(t, k, "its frames are of another time");
        t->retry_ns[k] = INT64_MAX;
    } else {
        t->part[k] = PART_FETCHED;
        t->why[k][0] = 0;
        if (ev->report->red > 0) { // the next take is developed like this one
            c->red = ev->report->red;
            c->blue = ev->report->blue;
        }
    }
}

static void on_joined(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = find_take(c, ev->take);
    if (!t || t->phase != TAKE_JOINING)
        return;
    if (ev->err) { // a full disk: again when there is room
        t->phase = TAKE_GATHERING;
        for (int k = 0; k < t->order.n; k++) {
            if (t->part[k] != PART_FETCHED)
                continue;
            t->part[k] = PART_STORED;
            t->retry_ns[k] = ev->now_ns + 5 * CONDUCTOR_RETRY_NS;
            snprintf(t->why[k], sizeof t->why[k], "%s", ev->text);
        }
        return;
    }
    struct message_order safe = t->order; // for those whose parts are in it
    safe.n = 0;
    for (int k = 0; k < t->order.n; k++)
        if (t->part[k] == PART_FETCHED)
            memcpy(safe.member[safe.n++], t->order.member[k], TAKE_MEMBER_CAP);
    order(c, &safe, MESSAGE_RELEASE);
    tell(c, t, OK, t->reason);
    t->phase = TAKE_FREE;
}

static void on_dropped(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = find_take(c, ev->take);
    if (!t || t->phase != TAKE_DROPPING)
        return;
    if (ev->err) { // on a full disk too the members' parts stay until it is noted
        act_on_take(c, CONDUCTOR_DROP, t);
        return;
    }
    t->phase = TAKE_DROPPED;
    order(c, &t->order, MESSAGE_RELEASE);
}

static void on_memory(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = free_take(c);
    if (!t || find_take(c, ev->order->take))
        return;
    *t = (struct conductor_take){.order = *ev->order, .ordered_ns = ev->now_ns};
    t->order.serial = 0; // of another epoch
    t->phase = ev->order->kind == MESSAGE_RELEASE ? TAKE_DROPPED : TAKE_GATHERING;
    snprintf(t->reason, sizeof t->reason, "%s",
             t->phase == TAKE_DROPPED ? "dropped before the conductor was started again" : "");
}

/* A board that was taken away, a take that waits, or a part that no take wants. */
static err_t on_forget(struct conductor *c, const char *what)
{
    struct conductor_take *t = find_take(c, what);
    struct conductor_member *m = conductor_members_find(c, what);
    struct message_order o = {0};
    if (m && !m->listed && !m->said.online) {
        memcpy(add_action(c, CONDUCTOR_REMOVE)->name, m->name, sizeof m->name);
        c->n--;
        memmove(m, m + 1, (size_t)(&c->member[c->n] - m) * sizeof *m);
        return OK;
    }
    if (t && t->phase == TAKE_GATHERING) {
        drop_take(c, t, "given up");
        return OK;
    }
    if (t && t->phase == TAKE_DROPPED) { // parts that come back later are unknown then, and stay
        act_on_take(c, CONDUCTOR_CLEAR, t);
        t->phase = TAKE_FREE;
        return OK;
    }
    for (int i = 0; !t && i < c->n; i++)
        if (conductor_members_hold(&c->member[i], what))
            memcpy(o.member[o.n++], c->member[i].name, TAKE_MEMBER_CAP);
    if (!o.n)
        return err_fail(ERR_ARG,
                        "%.40s is neither a capture that waits for members, nor one that a member "
                        "holds, nor a board that is away and not listed",
                        what);
    snprintf(o.take, sizeof o.take, "%s", what);
    order(c, &o, MESSAGE_RELEASE);
    return OK;
}

static err_t on_accept(struct conductor *c, const struct conductor_event *ev)
{
    struct conductor_take *t = find_take(c, ev->take);
    if (!t || t->phase != TAKE_GATHERING)
        return err_fail(ERR_ARG, "%.40s is no capture that waits for members", ev->take);
    return conductor_parts_accept(c, t);
}

/* ---- itself ---- */

static void on_other(struct conductor *c, const struct message_conductor *o, int64_t now_ns)
{
    if (strcmp(o->epoch, c->cfg.epoch) == 0 || c->state == CONDUCTOR_OFF ||
        strcmp(o->board, c->cfg.board) == 0) // a former run of this board
        return;
    if (!o->online && c->state == CONDUCTOR_REFUSED && strcmp(o->board, c->other) == 0) {
        c->state = CONDUCTOR_LISTEN;
        c->listen_ns = now_ns + CONDUCTOR_LISTEN_NS;
    } else if (o->online && c->state == CONDUCTOR_LEADS && strcmp(o->epoch, c->cfg.epoch) > 0) {
        add_action(c, CONDUCTOR_CLAIM); // it shall hear this one
    } else if (o->online) {
        c->state = CONDUCTOR_REFUSED;
        memcpy(c->other, o->board, sizeof c->other);
    }
}

static void on_time(struct conductor *c, int64_t now_ns)
{
    if (c->state != CONDUCTOR_LISTEN || now_ns < c->listen_ns)
        return;
    c->state = CONDUCTOR_LEADS;
    add_action(c, CONDUCTOR_CLAIM);
    for (int i = 0; i < c->n; i++)
        release_parts(c, &c->member[i]);
}

/* The broker is back: members that were there are asked anew how far they are. */
static void on_up(struct conductor *c, int64_t now_ns)
{
    c->state = CONDUCTOR_LISTEN;
    c->listen_ns = now_ns + CONDUCTOR_LISTEN_NS;
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        c->take[i].ordered_ns = now_ns;
}

static void on_down(struct conductor *c, int64_t now_ns)
{
    c->state = CONDUCTOR_OFF;
    for (int i = 0; i < c->n; i++) {
        c->member[i].since_ns = c->member[i].said.online ? now_ns : c->member[i].since_ns;
        c->member[i].said.online = false;
    }
}

/* A broker sends no last will of a board that hangs while its connection lives, and mosquitto none
 * of one that it throws out. */
static void lose_silent(struct conductor *c, int64_t now_ns)
{
    for (int i = 0; i < c->n; i++) {
        struct conductor_member *m = &c->member[i];
        if (!m->said.online || now_ns - m->heard_ns < CONDUCTOR_SILENT_NS)
            continue;
        m->said.online = false;
        m->since_ns = now_ns;
    }
}

err_t conductor_event(struct conductor *c, const struct conductor_event *ev)
{
    err_t e = OK;
    switch (ev->kind) {
    case CONDUCTOR_UP:
        on_up(c, ev->now_ns);
        break;
    case CONDUCTOR_DOWN:
        on_down(c, ev->now_ns);
        break;
    case CONDUCTOR_OTHER:
        on_other(c, ev->conductor, ev->now_ns);
        break;
    case CONDUCTOR_MEMBER:
        on_member(c, ev);
        break;
    case CONDUCTOR_REPORT:
        on_report(c, ev);
        break;
    case CONDUCTOR_PRESS:
        e = on_press(c, ev);
        break;
    case CONDUCTOR_CANCEL:
        if (c->current < 0)
            return err_fail(ERR_ARG, "no capture runs");
        drop_take(c, &c->take[c->current], "cancelled");
        break;
    case CONDUCTOR_RECORDED:
        on_recorded(c, ev);
        break;
    case CONDUCTOR_FETCHED:
        on_fetched(c, ev);
        break;
    case CONDUCTOR_JOINED:
        on_joined(c, ev);
        break;
    case CONDUCTOR_DROPPED:
        on_dropped(c, ev);
        break;
    case CONDUCTOR_MEMORY:
        on_memory(c, ev);
        break;
    case CONDUCTOR_FORGET:
        e = on_forget(c, ev->take);
        break;
    case CONDUCTOR_ACCEPT:
        e = on_accept(c, ev);
        break;
    case CONDUCTOR_TICK:
        lose_silent(c, ev->now_ns);
        break;
    }
    on_time(c, ev->now_ns);
    if (c->state == CONDUCTOR_LEADS)
        follow_takes(c, ev->now_ns);
    return e;
}

bool conductor_action(struct conductor *c, struct conductor_action *out)
{
    if (!c->n_actions)
        return false;
    *out = c->action[0];
    c->n_actions--;
    memmove(c->action, c->action + 1, (size_t)c->n_actions * sizeof c->action[0]);
    return true;
}

int64_t conductor_deadline(const struct conductor *c, int64_t now_ns)
{
    if (c->state == CONDUCTOR_LISTEN)
        return c->listen_ns;
    for (int i = 0; i < CONDUCTOR_TAKES; i++)
        if (c->take[i].phase != TAKE_FREE)
            return now_ns + SECOND;
    int64_t due = INT64_MAX;
    for (int i = 0; i < c->n; i++) {
        const struct conductor_member *m = &c->member[i];
        const int64_t silent_ns = m->heard_ns + CONDUCTOR_SILENT_NS;
        due = m->said.online && silent_ns < due ? silent_ns : due;
    }
    return due;
}

err_t conductor_init(struct conductor *c, const struct conductor_config *cfg)
{
    memset(c, 0, sizeof *c);
    c->cfg = *cfg;
    c->current = -1;
    for (int i = 0; i < CONFIG_MEMBERS; i++) {
        const char *name = cfg->set->rig_member[i];
        if (!name[0])
            continue;
        if (!manifest_is_member(name) || conductor_members_find(c, name))
            return err_fail(ERR_ARG, "rig.member.%d: \"%s\" %s", i + 1, name,
                            manifest_is_member(name)
                                ? "is there twice"
                                : "is not a name of small letters, digits and -");
        conductor_members_add(c, name)->listed = true;
    }
    return OK;
}
