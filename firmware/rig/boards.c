#include "firmware/rig/boards.h"

#include "firmware/rig/boards_inner.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>

#define SECOND INT64_C(1000000000)
// in the dark frames are long, and a press need not wait for many of them
#define LEAD_MOST_S 3.0
#define HEARTBEAT_NS (5 * SECOND) // between announcements of an unchanged state
#define ASK_NS SECOND             // between questions for the time,
#define ASK_FAST_NS (SECOND / 10) // and the first of them
enum { ASK_FAST = 10 };

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

void boards_publish_time(struct boards *b, enum message_topic t, const char *member,
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

static void announce(struct boards *b)
{
    describe(b, &b->said);
    b->said_ns = clocks_now();
    publish(b, MESSAGE_MEMBER, b->member.name, put_member, &b->said);
}

static void add_task(struct tasks *t, const struct task *k)
{
    if (tasks_add(t, k) != OK)
        log_error("%s", err_text());
}

static void tell_member(struct boards *b, enum member_event_kind kind,
                        const struct message_report *r)
{
    member_event(&b->member, &(struct member_event){.kind = kind, .report = r});
    boards_follow(b);
}

void boards_failed(struct boards *b, const char *text)
{
    struct message_report r = {0};
    if (!b->member.order.serial)
        return;
    snprintf(r.reason, sizeof r.reason, "%s", text);
    tell_member(b, MEMBER_FAILED, &r);
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
        boards_failed(b, err_text());
}

void boards_follow(struct boards *b)
{
    struct member_action a;
    struct task k = {0};
    while (b->has_member && member_action(&b->member, &a)) {
        switch (a.kind) {
        case MEMBER_ANNOUNCE:
            announce(b);
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
            add_task(b->disk, &k);
            break;
        case MEMBER_REPORT:
            publish(b, MESSAGE_REPORT, b->member.name, put_report, &b->member.report);
            break;
        }
    }
}

bool boards_works(const struct boards *b)
{
    return b->member.order.serial != 0;
}

bool boards_is_busy(const struct boards *b)
{
    return b->has_conductor && b->conductor.current >= 0;
}

static void report_meters(struct boards *b, const struct take *t)
{
    struct message_report r = {.n_cameras = t->n_cameras};
    for (int i = 0; i < t->n_cameras; i++) {
        r.meter[i].n =
            t->meter[i].n < BRACKET_EXPOSURES_MAX ? t->meter[i].n : BRACKET_EXPOSURES_MAX;
        memcpy(r.meter[i].time_s, t->meter[i].time_s, (size_t)r.meter[i].n * sizeof(double));
    }
    tell_member(b, MEMBER_METERED, &r);
}

bool boards_take(struct boards *b, struct take *t)
{
    const struct message_order *m = &b->member.order;
    const int64_t now = clocks_now();
    struct rigclock_state c;
    if (m->kind == MESSAGE_METER) {
        if (t->status == TAKE_COMPLETE)
            report_meters(b, t);
        else
            boards_failed(b, t->reason);
        return false;
    }
    if (!rigclock_read(&b->clock, now, &c)) // it was known when the order came
        c = (struct rigclock_state){0};
    memcpy(t->rig.take, m->take, sizeof t->rig.take);
    memcpy(t->rig.member, b->member.name, sizeof t->rig.member);
    snprintf(t->rig.clock, sizeof t->rig.clock, "%s", c.by_kernel ? "kernel" : "exchange");
    t->balance.red = m->red;
    t->balance.blue = m->blue;
    for (int i = 0; i < t->n; i++) {
        struct take_frame *f = &t->frame[i];
        const double ago = (double)llabs(now - f->start.monotonic_ns);
        f->common_ns = f->start.monotonic_ns + c.offset_ns;
        f->within_ns = c.within_ns + (int64_t)(ago * RIGCLOCK_DRIFT);
    }
    return true;
}

void boards_stored(struct boards *b, const struct take *t, const char *id, err_t e,
                   const char *text)
{
    struct message_report r = {0};
    struct task k = {.kind = TASK_HOLDS};
    if (e || t->status != TAKE_COMPLETE) {
        boards_failed(b, e ? text : t->reason);
        return;
    }
    snprintf(r.part, sizeof r.part, "%s", id);
    for (int i = 0; i < t->n; i++)
        r.start[r.n_starts++] = (struct message_start){
            t->frame[i].camera, t->frame[i].index, t->frame[i].common_ns, t->frame[i].within_ns};
    b->report = r; // told when the parts have been listed again
    b->reports = true;
    add_task(b->disk, &k);
}

/* ---- the time ---- */

static void ask_time(struct boards *b, int64_t now)
{
    struct message_time m = {0};
    if (!b->has_member || !b->member.up || !b->member.led || now < b->ask_ns)
        return;
    b->ask_ns = now + (b->clock.n < ASK_FAST ? ASK_FAST_NS : ASK_NS);
    memcpy(m.epoch, b->member.epoch, sizeof m.epoch);
    m.sent_ns = clocks_now();
    boards_publish_time(b, MESSAGE_ASK, b->member.name, &m);
}

/* ---- the conductor ---- */

static void conduct(struct boards *b);

static err_t lead(struct boards *b, struct conductor_event ev)
{
    ev.now_ns = clocks_now();
    if (!b->has_conductor)
        return err_fail(ERR_ARG, "this board is not the rig's conductor");
    err_t e = conductor_event(&b->conductor, &ev);
    conduct(b);
    return e;
}

void boards_tell_conductor(struct boards *b, struct conductor_event ev)
{
    if (b->has_conductor && lead(b, ev) != OK)
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
    add_task(b->fetch[i % BOARDS_FETCHERS], &k);
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
    memcpy(k->reason, a->text, sizeof k->reason);
    if (kind == TASK_JOIN) {
        k->trigger = clocks_at(a->order.start_ns - b->conductor.cfg.common_ns);
        k->clock_synced = clocks_synced();
    }
    add_task(b->disk, k);
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

/* ---- outcomes ---- */

static void member_holds(struct boards *b, const struct task *k)
{
    member_event(&b->member, &(struct member_event){
                                 .kind = MEMBER_HOLDS, .hold = k->hold, .n_holds = k->n_holds});
    if (b->reports && k->kind == TASK_HOLDS) {
        b->reports = false;
        member_event(&b->member,
                     &(struct member_event){.kind = MEMBER_STORED, .report = &b->report});
    }
    boards_follow(b);
}

static void take_outcome(struct boards *b, const struct task *k)
{
    static const enum conductor_event_kind kinds[] = {
        [TASK_RECORD] = CONDUCTOR_RECORDED, [TASK_FETCH] = CONDUCTOR_FETCHED,
        [TASK_OWN] = CONDUCTOR_FETCHED,     [TASK_JOIN] = CONDUCTOR_JOINED,
        [TASK_DROP] = CONDUCTOR_DROPPED,
    };
    struct conductor_event ev = {.take = k->take,
                                 .name = k->member,
                                 .order = &k->order,
                                 .report = &k->report,
                                 .err = k->err,
                                 .text = k->text};
    if (k->err)
        log_warn("rig: %s%s%s", k->member, k->member[0] ? ": " : "", k->text);
    else if (k->kind == TASK_FETCH)
        log_info("rig: %s: %.3g MB from %s in %.3g s", k->take, (double)k->bytes * 1e-6, k->member,
                 k->took_s);
    else if (k->kind == TASK_JOIN)
        log_info("rig: %s: joined in %.3g s", k->take, k->took_s);
    if (k->kind == TASK_RELEASE || k->kind == TASK_HOLDS) {
        member_holds(b, k);
    } else if (k->kind != TASK_CLEAR) {
        ev.kind = kinds[k->kind];
        boards_tell_conductor(b, ev);
    }
}

/* ---- the loop ---- */

int boards_poll(const struct boards *b, struct pollfd *fds, int cap, int64_t *deadline_ns)
{
    int all[BOARDS_FDS] = {mqtt_fd(b->mqtt), tasks_fd(b->disk)}, n_all = 2, n = 0;
    for (int i = 0; i < BOARDS_FETCHERS && b->has_conductor; i++)
        all[n_all++] = tasks_fd(b->fetch[i]);
    *deadline_ns = b->has_member && b->member.led ? b->ask_ns : INT64_MAX;
    if (b->has_conductor) {
        const int64_t due = conductor_deadline(&b->conductor, clocks_now());
        *deadline_ns = due < *deadline_ns ? due : *deadline_ns;
    }
    for (int i = 0; i < n_all && n < cap; i++)
        fds[n++] = (struct pollfd){.fd = all[i], .events = POLLIN};
    return n;
}

/* A change that others should know at once. */
static bool has_changed(const struct boards *b)
{
    const char *trouble = b->cfg.trouble(b->cfg.ctx);
    struct rigclock_state c;
    return strcmp(trouble ? trouble : "ready to capture", b->said.sentence) != 0 ||
           (!b->said.clock_known && rigclock_read(&b->clock, clocks_now(), &c));
}

void boards_step(struct boards *b)
{
    struct mqtt_event m;
    struct task *k = &b->task;
    while (mqtt_next(b->mqtt, &m) == OK) {
        boards_hear(b, &m);
        mqtt_event_free(&m);
    }
    while (tasks_outcome(b->disk, k))
        take_outcome(b, k);
    for (int i = 0; i < BOARDS_FETCHERS && b->has_conductor; i++)
        while (tasks_outcome(b->fetch[i], k))
            take_outcome(b, k);
    const int64_t now = clocks_now();
    boards_tell_conductor(b, (struct conductor_event){.kind = CONDUCTOR_TICK});
    ask_time(b, now);
    if (b->has_member && b->member.up && b->member.led &&
        (now - b->said_ns > HEARTBEAT_NS || has_changed(b)))
        announce(b);
}

err_t boards_press(struct boards *b, bool asked)
{
    struct message_time m = {0};
    if (b->has_conductor)
        return lead(b, (struct conductor_event){.kind = CONDUCTOR_PRESS, .asked = asked});
    if (!b->member.up || !b->member.led)
        return err_fail(ERR_LOST, "%s", boards_trouble(b));
    if (asked)
        return err_fail(ERR_UNSUPPORTED, "this board is a member of the rig: the conductor alone "
                                         "tells how a capture ended");
    memcpy(m.epoch, b->member.epoch, sizeof m.epoch);
    m.sent_ns = clocks_now();
    boards_publish_time(b, MESSAGE_PRESS, b->member.name, &m);
    return OK;
}

err_t boards_cancel(struct boards *b)
{
    return lead(b, (struct conductor_event){.kind = CONDUCTOR_CANCEL});
}

err_t boards_forget(struct boards *b, const char *what)
{
    return lead(b, (struct conductor_event){.kind = CONDUCTOR_FORGET, .take = what});
}

const char *boards_trouble(const struct boards *b)
{
    if (b->broker[0])
        return b->broker;
    if (b->has_conductor)
        return conductor_check(&b->conductor, clocks_now()) != OK ? err_text() : NULL;
    if (!b->member.up)
        return "the broker is not reached yet";
    return b->member.led ? NULL : "the rig has no conductor";
}

/* ---- the end ---- */

/* The broker is told, not left to find out. */
static void say_goodbye(struct boards *b)
{
    const struct message_member gone = {.online = false};
    struct message_member m = gone;
    memcpy(m.boot, b->boot, sizeof m.boot);
    if (b->has_member)
        publish(b, MESSAGE_MEMBER, b->member.name, put_member, &m);
    if (b->has_conductor && b->conductor.state == CONDUCTOR_LEADS)
        claim(b, false);
}

void boards_close(struct boards *b)
{
    if (!b)
        return;
    if (b->mqtt)
        say_goodbye(b);
    mqtt_close(b->mqtt);
    for (int i = 0; i < BOARDS_FETCHERS; i++)
        tasks_close(b->fetch[i]);
    tasks_close(b->disk);
    free(b);
}
