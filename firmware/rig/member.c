#include "firmware/rig/member.h"

#include <stdarg.h>
#include <string.h>

void member_init(struct member *m, const char *name)
{
    memset(m, 0, sizeof *m);
    snprintf(m->name, sizeof m->name, "%s", name);
}

/* An action that waits already is not added again. */
static void act(struct member *m, enum member_action_kind kind, const char *take)
{
    struct member_action a = {.kind = kind};
    snprintf(a.take, sizeof a.take, "%s", take);
    for (int i = 0; i < m->n_actions; i++)
        if (m->action[i].kind == kind && strcmp(m->action[i].take, take) == 0)
            return;
    if (m->n_actions < MEMBER_ACTIONS)
        m->action[m->n_actions++] = a;
}

static void publish(struct member *m, enum member_action_kind kind)
{
    if (m->up && m->led)
        act(m, kind, "");
}

static void report(struct member *m, const struct message_order *o, enum message_report_kind kind,
                   const struct message_report *what)
{
    if (what)
        m->report = *what;
    else
        m->report = (struct message_report){0};
    m->report.kind = kind;
    m->report.serial = o->serial;
    memcpy(m->report.epoch, o->epoch, sizeof m->report.epoch);
    memcpy(m->report.take, o->take, sizeof m->report.take);
    publish(m, MEMBER_REPORT);
}

static void refuse(struct member *m, const struct message_order *o, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

static void refuse(struct member *m, const struct message_order *o, const char *format, ...)
{
    struct message_report r = {0};
    va_list list;
    va_start(list, format);
    vsnprintf(r.reason, sizeof r.reason, format, list);
    va_end(list);
    report(m, o, MESSAGE_FAILED, &r);
}

static const struct message_hold *find_hold(const struct member *m, const char *take)
{
    for (int i = 0; i < m->n_holds; i++)
        if (strcmp(m->hold[i].take, take) == 0)
            return &m->hold[i];
    return NULL;
}

/* An order to meter or to shoot that has not been seen. */
static void begin_order(struct member *m, const struct member_event *ev)
{
    const struct message_order *o = ev->order;
    const bool shoots = o->kind == MESSAGE_SHOOT;
    const struct message_hold *held = shoots ? find_hold(m, o->take) : NULL;
    m->newest = o->serial;
    if (held) {
        struct message_report r = {0};
        memcpy(r.part, held->part, sizeof r.part);
        report(m, o, MESSAGE_STORED, &r);
    } else if (m->order.serial) {
        refuse(m, o, "another order is being followed");
    } else if (shoots && !ev->common_known) {
        refuse(m, o, "the common clock is not known yet");
    } else if (shoots && ev->common_ns > o->start_ns + MEMBER_LATE_NS) {
        refuse(m, o, "the order came %.1f s after its start",
               (double)(ev->common_ns - o->start_ns) * 1e-9);
    } else {
        m->order = *o;
        act(m, shoots ? MEMBER_SHOOT : MEMBER_METER, "");
        publish(m, MEMBER_ANNOUNCE);
    }
}

static void on_order(struct member *m, const struct member_event *ev)
{
    const struct message_order *o = ev->order;
    if (!m->led || strcmp(o->epoch, m->epoch) != 0 || message_find(o, m->name) < 0)
        return;
    switch (o->kind) {
    case MESSAGE_RELEASE:
        if (find_hold(m, o->take))
            act(m, MEMBER_RELEASE, o->take);
        break;
    case MESSAGE_CANCEL:
        if (m->order.serial && m->order.serial == o->serial)
            act(m, MEMBER_STOP, "");
        break;
    case MESSAGE_METER:
    case MESSAGE_SHOOT:
        if (o->serial > m->newest)
            begin_order(m, ev);
        else if (o->serial == m->report.serial)
            publish(m, MEMBER_REPORT);
        break;
    }
}

static void on_conductor(struct member *m, const struct message_conductor *c)
{
    const bool is_new = strcmp(c->epoch, m->epoch) != 0;
    if (!c->online) {
        m->led = m->led && is_new; // only the one that leads can leave
        return;
    }
    if (is_new) {
        m->newest = 0;
        m->report.serial = 0;
        memcpy(m->epoch, c->epoch, sizeof m->epoch);
    }
    m->led = true;
    publish(m, MEMBER_ANNOUNCE);
    if (m->report.serial)
        publish(m, MEMBER_REPORT);
}

/* Work that was ordered in a former epoch ends without a report: what it stored is announced. */
static void end_order(struct member *m, enum message_report_kind kind,
                      const struct message_report *what)
{
    const struct message_order o = m->order;
    if (!o.serial)
        return;
    m->order.serial = 0;
    if (strcmp(o.epoch, m->epoch) == 0)
        report(m, &o, kind, what);
    publish(m, MEMBER_ANNOUNCE);
}

void member_event(struct member *m, const struct member_event *ev)
{
    switch (ev->kind) {
    case MEMBER_UP:
        m->up = true;
        publish(m, MEMBER_ANNOUNCE);
        if (m->report.serial)
            publish(m, MEMBER_REPORT);
        break;
    case MEMBER_DOWN:
        m->up = false;
        break;
    case MEMBER_CONDUCTOR:
        on_conductor(m, ev->conductor);
        break;
    case MEMBER_ORDER:
        on_order(m, ev);
        break;
    case MEMBER_METERED:
        end_order(m, MESSAGE_METERED, ev->report);
        break;
    case MEMBER_STORED:
        end_order(m, MESSAGE_STORED, ev->report);
        break;
    case MEMBER_FAILED:
        end_order(m, MESSAGE_FAILED, ev->report);
        break;
    case MEMBER_HOLDS:
        m->n_holds = ev->n_holds < MESSAGE_HOLDS ? ev->n_holds : MESSAGE_HOLDS;
        memcpy(m->hold, ev->hold, (size_t)m->n_holds * sizeof m->hold[0]);
        publish(m, MEMBER_ANNOUNCE);
        break;
    }
}

bool member_action(struct member *m, struct member_action *out)
{
    if (!m->n_actions)
        return false;
    *out = m->action[0];
    m->n_actions--;
    memmove(m->action, m->action + 1, (size_t)m->n_actions * sizeof m->action[0]);
    return true;
}
