/* What the machines want, done: published, begun, put on the disk, fetched. */
#include "firmware/rig/boards_inner.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>

// in the dark frames are long, and a press need not wait for many of them
#define LEAD_MOST_S 3.0

/* ---- publishing ---- */

static err_t publish_text(struct boards *b, enum message_topic t, const char *member,
                          const char *text, bool keep)
{
    char topic[MESSAGE_TOPIC_CAP];
    message_topic(b->set->rig_name, t, member, topic);
    return mqtt_publish(b->mqtt, topic, text, t == MESSAGE_ASK || t == MESSAGE_TIME ? 0 : 1, keep);
}

/* A payload that is not sent is said again: with the next announcement, report or question. */
static void publish(struct boards *b, enum message_topic t, const char *member,
                    void (*write)(const void *m, FILE *f), const void *m)
{
    char *text = NULL;
    size_t n;
    FILE *f = open_memstream(&text, &n);
    if (!f)
        return;
    write(m, f);
    if (fclose(f) == 0 &&
        publish_text(b, t, member, text, t == MESSAGE_CONDUCTOR || t == MESSAGE_MEMBER) != OK)
        log_debug("%s", err_text());
    free(text);
}

static void put_member(const void *m, FILE *f)
{
    message_write_member(m, f);
}

static void put_conductor(const void *m, FILE *f)
{
    message_write_conductor(m, f);
}

static void put_order(const void *m, FILE *f)
{
    message_write_order(m, f);
}

static void put_report(const void *m, FILE *f)
{
    message_write_report(m, f);
}

static void put_time(const void *m, FILE *f)
{
    message_write_time(m, f);
}

void boards_act_publish_time(struct boards *b, enum message_topic t, const char *member,
                             const struct message_time *m)
{
    publish(b, t, member, put_time, m);
}

/* ---- the member ---- */

static void describe(struct boards *b, struct message_member *m)
{
    struct rigclock_state c;
    struct statvfs v;
    const char *trouble = b->cfg.trouble(b->cfg.ctx);
    *m = (struct message_member){.online = true, .cameras = b->cfg.cameras, .ready = !trouble};
    memcpy(m->boot, b->boot, sizeof m->boot);
    memcpy(m->epoch, b->member.epoch, sizeof m->epoch);
    snprintf(m->version, sizeof m->version, "%s", b->cfg.version);
    memcpy(m->token, b->token, sizeof m->token);
    m->port = b->cfg.http_port;
    if (mqtt_address(b->mqtt, m->host, sizeof m->host) != OK)
        m->host[0] = 0;
    snprintf(m->sentence, sizeof m->sentence, "%s", trouble ? trouble : "ready to capture");
    m->lead_ns = (int64_t)(fmin(b->cfg.lead_s(b->cfg.ctx), LEAD_MOST_S) * 1e9);
    m->free_mb =
        statvfs(b->set->store_path, &v) == 0 ? (double)v.f_bavail * (double)v.f_frsize / 1e6 : -1;
    m->clock_known = rigclock_read(&b->clock, clocks_now(), &c);
    m->within_ns = c.within_ns;
    snprintf(m->clock, sizeof m->clock, "%s",
             !m->clock_known ? ""
             : c.by_kernel   ? "kernel"
                             : "exchange");
    m->serial = b->member.order.serial;
    m->n_holds = b->member.n_holds;
    memcpy(m->hold, b->member.hold, sizeof m->hold);
}

void boards_act_announce(struct boards *b)
{
    describe(b, &b->said);
    b->said_ns = clocks_now();
    publish(b, MESSAGE_MEMBER, b->member.name, put_member, &b->said);
}

void boards_act_add(struct tasks *t, const struct task *k)
{
    if (tasks_add(t, k) != OK)
        log_error("%s", err_text());
}

void boards_act_report(struct boards *b, enum member_event_kind kind,
                       const struct message_report *r)
{
    member_event(&b->member, &(struct member_event){.kind = kind, .report = r});
    boards_act_member(b);
}

void boards_act_failed(struct boards *b, const char *text)
{
    struct message_report r = {0};
    if (!b->member.order.serial)
        return;
    snprintf(r.reason, sizeof r.reason, "%s", text);
    boards_act_report(b, MEMBER_FAILED, &r);
}

/* The conductor's list of exposures for the cameras of this board. */
static void make_order(const struct boards *b, struct session_order *o)
{
    const struct message_order *m = &b->member.order;
    const int64_t now = clocks_now();
    struct rigclock_state c;
    schedule_order(b->set, now, o);
    o->mode = m->kind == MESSAGE_METER ? SESSION_METER : SESSION_LIST;
    o->stagger = m->stagger && m->kind == MESSAGE_SHOOT;
    o->turn = m->turn[message_find(m, b->member.name)];
    o->middle_s = m->kind == MESSAGE_METER ? 0 : 1;
    o->n = m->n_times;
    for (int i = 0; i < m->n_times; i++)
        o->ev[i] = log2(m->time_s[i]);
    if (m->kind == MESSAGE_SHOOT && rigclock_read(&b->clock, now, &c))
        o->start_ns = m->start_ns - c.offset_ns;
}

static void begin_order(struct boards *b)
{
    struct session_order o;
    make_order(b, &o);
    if (b->cfg.begin(b->cfg.ctx, &o) != OK)
        boards_act_failed(b, err_text());
}

void boards_act_member(struct boards *b)
{
    struct member_action a;
    struct task k = {0};
    while (b->has_member && member_action(&b->member, &a)) {
        switch (a.kind) {
        case MEMBER_ANNOUNCE:
            boards_act_announce(b);
            break;
        case MEMBER_METER:
        case MEMBER_SHOOT:
            begin_order(b);
            break;
        case MEMBER_STOP:
            b->cfg.stop(b->cfg.ctx);
            break;
        case MEMBER_RELEASE:
            k.kind = TASK_RELEASE;
            memcpy(k.take, a.take, sizeof k.take);
            boards_act_add(b->disk, &k);
            break;
        case MEMBER_REPORT:
            publish(b, MESSAGE_REPORT, b->member.name, put_report, &b->member.report);
            break;
        }
    }
}

/* ---- the conductor ---- */

static void conduct(struct boards *b);

err_t boards_act_lead(struct boards *b, struct conductor_event ev)
{
    ev.now_ns = clocks_now();
    if (!b->has_conductor)
        return err_fail(ERR_ARG, "this board is not the rig's conductor");
    err_t e = conductor_event(&b->conductor, &ev);
    conduct(b);
    return e;
}

void boards_act_tell(struct boards *b, struct conductor_event ev)
{
    if (b->has_conductor && boards_act_lead(b, ev) != OK)
        log_debug("%s", err_text());
}

static void claim(struct boards *b, bool online)
{
    struct message_conductor m = {.online = online};
    memcpy(m.epoch, b->conductor.cfg.epoch, sizeof m.epoch);
    memcpy(m.board, b->member.name, sizeof m.board);
    snprintf(m.version, sizeof m.version, "%s", b->cfg.version);
    publish(b, MESSAGE_CONDUCTOR, NULL, put_conductor, &m);
}

static void fetch_part(struct boards *b, const struct conductor_action *a)
{
    struct task k = {.kind = TASK_FETCH, .part = a->part};
    memcpy(k.take, a->take, sizeof k.take);
    memcpy(k.member, a->name, sizeof k.member);
    if (b->has_member && strcmp(a->name, b->member.name) == 0)
        k.kind = TASK_OWN;
    int i = 0;
    while (i < b->conductor.n && strcmp(b->conductor.member[i].name, a->name) != 0)
        i++;
    if (i < b->conductor.n) {
        const struct message_member *m = &b->conductor.member[i].said;
        const bool v6 = strchr(m->host, ':') != NULL;
        snprintf(k.url, sizeof k.url, "http://%s%s%s:%d", v6 ? "[" : "", m->host, v6 ? "]" : "",
                 m->port);
        memcpy(k.token, m->token, sizeof k.token);
    }
    boards_act_add(b->fetch[i % BOARDS_FETCHERS], &k);
}

static void do_on_disk(struct boards *b, enum task_kind kind, const struct conductor_action *a)
{
    struct task *k = calloc(1, sizeof *k);
    if (!k)
        return;
    k->kind = kind;
    k->order = a->order;
    memcpy(k->take, a->take, sizeof k->take);
    k->n_missing = a->n_missing;
    memcpy(k->missing, a->missing, sizeof k->missing);
    if (kind == TASK_JOIN) {
        k->trigger = clocks_at(a->order.start_ns - b->conductor.cfg.common_ns);
        k->clock_synced = clocks_synced();
    }
    boards_act_add(b->disk, k);
    free(k);
}

static void tell_press(struct boards *b, const struct conductor_action *a)
{
    if (a->err)
        log_warn("rig: %s%s%s", a->take, a->take[0] ? ": " : "", a->text);
    b->cfg.told(b->cfg.ctx, a->err, a->take, a->text, a->asked);
}

static void conduct(struct boards *b)
{
    struct conductor_action *a = &b->action;
    while (conductor_action(&b->conductor, a)) {
        switch (a->kind) {
        case CONDUCTOR_CLAIM:
            claim(b, true);
            break;
        case CONDUCTOR_ORDER:
            publish(b, MESSAGE_ORDER, NULL, put_order, &a->order);
            break;
        case CONDUCTOR_RECORD:
            do_on_disk(b, TASK_RECORD, a);
            break;
        case CONDUCTOR_FETCH:
            fetch_part(b, a);
            break;
        case CONDUCTOR_JOIN:
            do_on_disk(b, TASK_JOIN, a);
            break;
        case CONDUCTOR_DROP:
            do_on_disk(b, TASK_DROP, a);
            break;
        case CONDUCTOR_CLEAR:
            do_on_disk(b, TASK_CLEAR, a);
            break;
        case CONDUCTOR_REMOVE:
            if (publish_text(b, MESSAGE_MEMBER, a->name, "", true) != OK)
                log_debug("%s", err_text());
            break;
        case CONDUCTOR_TELL:
            tell_press(b, a);
            break;
        }
    }
}

void boards_act_leave(struct boards *b)
{
    const struct message_member gone = {.online = false};
    struct message_member m = gone;
    memcpy(m.boot, b->boot, sizeof m.boot);
    if (b->has_member)
        publish(b, MESSAGE_MEMBER, b->member.name, put_member, &m);
    if (b->has_conductor && b->conductor.state == CONDUCTOR_LEADS)
        claim(b, false);
}
