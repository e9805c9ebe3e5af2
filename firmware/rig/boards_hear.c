/* What comes from the broker, to the machines. */
#include "firmware/rig/boards_inner.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"

#include <string.h>

/* ---- the time ---- */

static void answer_time(struct boards *b, const char *member, struct message_time *m)
{
    const int64_t common = b->conductor.cfg.common_ns;
    if (strcmp(m->epoch, b->conductor.cfg.epoch) != 0)
        return;
    m->got_ns = b->heard_ns + common;
    const struct clocks c = clocks_at(clocks_now());
    m->replied_ns = c.monotonic_ns + common;
    m->disciplined = clocks_bound(&m->within_ns);
    m->real_ns = c.realtime_ns;
    boards_act_publish_time(b, MESSAGE_TIME, member, m);
}

static void hear_time(struct boards *b, const struct message_time *m)
{
    const struct clocks c = clocks_at(b->heard_ns);
    struct rigclock_state s;
    int64_t within;
    if (strcmp(m->epoch, b->member.epoch) != 0)
        return;
    rigclock_exchange(&b->clock, m->sent_ns, m->got_ns, m->replied_ns, b->heard_ns);
    if (m->disciplined &&
        clocks_bound(&within)) // common - real is the conductor's, real - mono ours
        rigclock_kernel(&b->clock, b->heard_ns,
                        m->replied_ns - m->real_ns + c.realtime_ns - c.monotonic_ns,
                        within + m->within_ns);
    if (rigclock_read(&b->clock, b->heard_ns, &s) && (s.contradiction_ns > 0) != b->contradicts) {
        b->contradicts = s.contradiction_ns > 0;
        if (b->contradicts)
            log_warn("rig: this clock or the conductor's is %.3g ms farther off than its kernel "
                     "says; the time that was exchanged is used",
                     (double)s.contradiction_ns * 1e-6);
    }
}

/* ---- messages ---- */

static void hear_conductor(struct boards *b, const struct mqtt_event *m)
{
    struct message_conductor c;
    if (message_read_conductor(m->payload, m->n, &c) != OK) {
        log_warn("rig: %s", err_text());
        return;
    }
    if (strcmp(c.epoch, b->member.epoch) != 0) {
        b->clock = (struct rigclock){0};
        b->ask_ns = 0;
    }
    boards_act_tell(b, (struct conductor_event){.kind = CONDUCTOR_OTHER, .conductor = &c});
    member_event(&b->member, &(struct member_event){.kind = MEMBER_CONDUCTOR, .conductor = &c});
    boards_act_member(b);
}

static void hear_order(struct boards *b, const struct mqtt_event *m)
{
    struct message_order o;
    struct rigclock_state c;
    struct member_event ev = {.kind = MEMBER_ORDER, .order = &o};
    if (message_read_order(m->payload, m->n, &o) != OK) {
        log_warn("rig: %s", err_text());
        return;
    }
    ev.common_known = rigclock_read(&b->clock, b->heard_ns, &c);
    ev.common_ns = b->heard_ns + c.offset_ns;
    member_event(&b->member, &ev);
    boards_act_member(b);
}

static void hear_member(struct boards *b, const char *name, const struct mqtt_event *m)
{
    struct conductor_event ev = {.kind = CONDUCTOR_MEMBER, .name = name, .member = &b->heard};
    if (!m->n) // forgotten
        return;
    if (message_read_member(m->payload, m->n, &b->heard) == OK)
        boards_act_tell(b, ev);
    else
        log_warn("rig: %s: %s", name, err_text());
}

static void hear_report(struct boards *b, const char *name, const struct mqtt_event *m)
{
    struct message_report r;
    struct conductor_event ev = {.kind = CONDUCTOR_REPORT, .name = name, .report = &r};
    if (message_read_report(m->payload, m->n, &r) == OK)
        boards_act_tell(b, ev);
    else
        log_warn("rig: %s: %s", name, err_text());
}

/* A press that comes twice is one. */
static void hear_press(struct boards *b, const char *name, const struct mqtt_event *m)
{
    struct message_time t;
    if (message_read_time(m->payload, m->n, &t) != OK || t.sent_ns == b->press_sent_ns)
        return;
    b->press_sent_ns = t.sent_ns;
    const struct conductor_event press = {.kind = CONDUCTOR_PRESS};
    if (b->has_conductor && boards_act_lead(b, press) != OK)
        log_info("rig: press at %s not answered: %s", name, err_text());
}

static void hear(struct boards *b, const struct mqtt_event *m)
{
    char name[TAKE_MEMBER_CAP];
    struct message_time t;
    const enum message_topic topic = message_kind(b->set->rig_name, m->topic, name);
    b->heard_ns = clocks_now();
    switch (topic) {
    case MESSAGE_CONDUCTOR:
        hear_conductor(b, m);
        break;
    case MESSAGE_ORDER:
        hear_order(b, m);
        break;
    case MESSAGE_MEMBER:
        hear_member(b, name, m);
        break;
    case MESSAGE_REPORT:
        hear_report(b, name, m);
        break;
    case MESSAGE_PRESS:
        hear_press(b, name, m);
        break;
    case MESSAGE_ASK:
        if (message_read_time(m->payload, m->n, &t) == OK)
            answer_time(b, name, &t);
        break;
    case MESSAGE_TIME:
        if (message_read_time(m->payload, m->n, &t) == OK)
            hear_time(b, &t);
        break;
    case MESSAGE_TOPICS:
        break;
    }
}

void boards_hear(struct boards *b, const struct mqtt_event *m)
{
    const bool up = m->kind == MQTT_UP;
    if (m->kind == MQTT_MESSAGE) {
        hear(b, m);
        return;
    }
    if (up)
        log_info("rig: the broker is reached");
    else
        log_warn("rig: %s", m->why);
    snprintf(b->broker, sizeof b->broker, "%.*s", TAKE_TEXT - 1, up ? "" : m->why);
    member_event(&b->member, &(struct member_event){.kind = up ? MEMBER_UP : MEMBER_DOWN});
    boards_act_member(b);
    boards_act_tell(b, (struct conductor_event){.kind = up ? CONDUCTOR_UP : CONDUCTOR_DOWN});
}
