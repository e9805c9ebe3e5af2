#include "firmware/rig/boards.h"

#include "firmware/rig/boards_inner.h"
#include "firmware/store/joint.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/statvfs.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)
#define HEARTBEAT_NS (5 * SECOND) // between announcements of an unchanged state
#define ASK_NS SECOND             // between questions for the time,
#define ASK_FAST_NS (SECOND / 10) // and the first of them
enum { ASK_FAST = 10, PASSWORD_MAX = 256 };

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

/* ---- the member ---- */

static void member_follow(struct boards *b);

static void describe(struct boards *b, struct message_member *m)
{
    struct rigclock_state c;
    struct statvfs v;
    const char *trouble = b->cfg.trouble(b->cfg.ctx);
    *m = (struct message_member){.online = true, .cameras = b->cfg.cameras, .ready = !trouble};
    memcpy(m->boot, b->boot, sizeof m->boot);
    snprintf(m->version, sizeof m->version, "%s", b->cfg.version);
    memcpy(m->token, b->token, sizeof m->token);
    m->port = b->cfg.http_port;
    if (mqtt_address(b->mqtt, m->host, sizeof m->host) != OK)
        m->host[0] = 0;
    snprintf(m->sentence, sizeof m->sentence, "%s", trouble ? trouble : "ready to capture");
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
    member_follow(b);
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

static void member_follow(struct boards *b)
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
    publish(b, MESSAGE_ASK, b->member.name, put_time, &m);
}

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
    publish(b, MESSAGE_TIME, member, put_time, m);
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

/* ---- the conductor ---- */

err_t boards_lead(struct boards *b, struct conductor_event ev)
{
    ev.now_ns = clocks_now();
    if (!b->has_conductor)
        return err_fail(ERR_ARG, "this board is not the rig's conductor");
    err_t e = conductor_event(&b->conductor, &ev);
    boards_conduct(b);
    return e;
}

static void lead(struct boards *b, struct conductor_event ev)
{
    if (b->has_conductor && boards_lead(b, ev) != OK)
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
    for (int i = 0; i < b->conductor.n; i++) {
        const struct message_member *m = &b->conductor.member[i].said;
        const bool v6 = strchr(m->host, ':') != NULL;
        if (strcmp(b->conductor.member[i].name, a->name) != 0)
            continue;
        snprintf(k.url, sizeof k.url, "http://%s%s%s:%d", v6 ? "[" : "", m->host, v6 ? "]" : "",
                 m->port);
        memcpy(k.token, m->token, sizeof k.token);
    }
    add_task(b->fetch, &k);
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

void boards_conduct(struct boards *b)
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
    member_follow(b);
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
    if (k->kind == TASK_RELEASE || k->kind == TASK_HOLDS) {
        member_holds(b, k);
    } else if (k->kind != TASK_CLEAR) {
        ev.kind = kinds[k->kind];
        lead(b, ev);
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
    lead(b, (struct conductor_event){.kind = CONDUCTOR_OTHER, .conductor = &c});
    member_event(&b->member, &(struct member_event){.kind = MEMBER_CONDUCTOR, .conductor = &c});
    member_follow(b);
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
    member_follow(b);
}

static void hear_member(struct boards *b, const char *name, const struct mqtt_event *m)
{
    struct conductor_event ev = {.kind = CONDUCTOR_MEMBER, .name = name, .member = &b->heard};
    if (!m->n) // forgotten
        return;
    if (message_read_member(m->payload, m->n, &b->heard) == OK)
        lead(b, ev);
    else
        log_warn("rig: %s: %s", name, err_text());
}

static void hear_report(struct boards *b, const char *name, const struct mqtt_event *m)
{
    struct message_report r;
    struct conductor_event ev = {.kind = CONDUCTOR_REPORT, .name = name, .report = &r};
    if (message_read_report(m->payload, m->n, &r) == OK)
        lead(b, ev);
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
    if (b->has_conductor && boards_press(b, false) != OK)
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

static void on_broker(struct boards *b, const struct mqtt_event *m)
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
    member_follow(b);
    lead(b, (struct conductor_event){.kind = up ? CONDUCTOR_UP : CONDUCTOR_DOWN});
}

/* ---- the loop ---- */

int boards_poll(const struct boards *b, struct pollfd *fds, int cap, int64_t *deadline_ns)
{
    const int all[BOARDS_FDS] = {mqtt_fd(b->mqtt), tasks_fd(b->disk),
                                 b->fetch ? tasks_fd(b->fetch) : -1};
    int n = 0;
    *deadline_ns = b->has_member && b->member.led ? b->ask_ns : INT64_MAX;
    if (b->has_conductor) {
        const int64_t due = conductor_deadline(&b->conductor, clocks_now());
        *deadline_ns = due < *deadline_ns ? due : *deadline_ns;
    }
    for (int i = 0; i < BOARDS_FDS && n < cap; i++)
        if (all[i] >= 0)
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
        on_broker(b, &m);
        mqtt_event_free(&m);
    }
    while (tasks_outcome(b->disk, k))
        take_outcome(b, k);
    while (b->fetch && tasks_outcome(b->fetch, k))
        take_outcome(b, k);
    const int64_t now = clocks_now();
    lead(b, (struct conductor_event){.kind = CONDUCTOR_TICK});
    ask_time(b, now);
    if (b->has_member && b->member.up && b->member.led &&
        (now - b->said_ns > HEARTBEAT_NS || has_changed(b)))
        announce(b);
}

err_t boards_press(struct boards *b, bool asked)
{
    struct message_time m = {0};
    if (b->has_conductor)
        return boards_lead(b, (struct conductor_event){.kind = CONDUCTOR_PRESS, .asked = asked});
    if (!b->member.up || !b->member.led)
        return err_fail(ERR_LOST, "%s", boards_trouble(b));
    if (asked)
        return err_fail(ERR_UNSUPPORTED, "this board is a member of the rig: the conductor alone "
                                         "tells how a capture ended");
    memcpy(m.epoch, b->member.epoch, sizeof m.epoch);
    m.sent_ns = clocks_now();
    publish(b, MESSAGE_PRESS, b->member.name, put_time, &m);
    return OK;
}

err_t boards_cancel(struct boards *b)
{
    return boards_lead(b, (struct conductor_event){.kind = CONDUCTOR_CANCEL});
}

err_t boards_forget(struct boards *b, const char *what)
{
    return boards_lead(b, (struct conductor_event){.kind = CONDUCTOR_FORGET, .take = what});
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

/* ---- start and end ---- */

/* Whether the joint take is on the disk with that member's part. */
static bool has_joint(void *ctx, const char *take, const char *member)
{
    const struct boards *b = ctx;
    char dir[FILE_PATH_CAP], path[FILE_PATH_CAP];
    struct cJSON *doc;
    bool found = false;
    if (file_join(b->set->store_path, take, dir) != OK ||
        file_join(dir, MANIFEST_FILE, path) != OK || !file_exists(path) ||
        json_read(path, &doc) != OK)
        return false;
    const struct cJSON *list = json_member(json_member(doc, "rig"), "members");
    for (const struct cJSON *x = json_first(list); x && !found; x = json_next(x)) {
        const char *name = json_string(json_member(x, "name"));
        found = name && strcmp(name, member) == 0;
    }
    json_free(doc);
    return found;
}

/* The name of this board: rig.board, else the host's, in the letters that names have. */
static err_t name_board(const struct config *set, char out[TAKE_MEMBER_CAP])
{
    char host[TAKE_MEMBER_CAP] = "";
    if (!set->rig_board[0] && gethostname(host, sizeof host - 1) != 0)
        return err_fail(ERR_ARG, "rig.board is empty, and this host has no name");
    snprintf(out, TAKE_MEMBER_CAP, "%.31s", set->rig_board[0] ? set->rig_board : host);
    for (char *p = out; *p && !set->rig_board[0]; p++) {
        *p = *p >= 'A' && *p <= 'Z' ? (char)(*p - 'A' + 'a') : *p;
        if (*p == '.')
            *p-- = 0;
    }
    if (strlen(set->rig_board) >= TAKE_MEMBER_CAP || !message_is_name(out))
        return err_fail(ERR_ARG,
                        "rig.board: \"%.40s\" is not a name of at most %d small letters, digits "
                        "and -",
                        out, TAKE_MEMBER_CAP - 1);
    return OK;
}

static err_t check_settings(const struct boards_config *cfg)
{
    const struct config *set = cfg->set;
    if (!message_is_name(set->rig_name))
        return err_fail(ERR_ARG, "rig.name: \"%.40s\" is not a name of small letters, digits and -",
                        set->rig_name);
    if (!set->rig_broker[0])
        return err_fail(ERR_ARG, "rig.broker is empty: a rig of several boards needs a broker");
    if (set->rig_role == CONFIG_MEMBER && !cfg->cameras)
        return err_fail(ERR_ARG, "rig.role is member, but no camera.1 is set");
    if (cfg->cameras && !cfg->http_port)
        return err_fail(ERR_ARG, "http.port is 0: the conductor could not fetch what this board "
                                 "photographs");
    return OK;
}

static err_t read_password(const char *path, char out[PASSWORD_MAX])
{
    out[0] = 0;
    if (!path[0])
        return OK;
    FILE *f = fopen(path, "re");
    if (!f || !fgets(out, PASSWORD_MAX, f)) {
        if (f)
            fclose(f);
        return err_fail(ERR_IO,
                        "rig.password_file: %s cannot be read, or is empty: hdrig rig join writes "
                        "it",
                        path);
    }
    fclose(f);
    out[strcspn(out, "\r\n")] = 0;
    return OK;
}

static void put_random(char *out, size_t digits)
{
    unsigned char raw[16] = {0};
    if (getrandom(raw, sizeof raw, 0) != (ssize_t)sizeof raw)
        log_warn("rig: no random numbers");
    for (size_t i = 0; i < digits; i++)
        out[i] = "0123456789abcdef"[i % 2 ? raw[i / 2] >> 4 : raw[i / 2] & 15];
    out[digits] = 0;
}

void boards_token(char *out)
{
    put_random(out, MESSAGE_TOKEN_CAP - 1);
}

static err_t open_mqtt(struct boards *b)
{
    char topic[MESSAGE_TOPIC_CAP], will[128], client[CONFIG_TEXT + 64], password[PASSWORD_MAX];
    const bool leads = b->has_conductor;
    struct mqtt_url url;
    message_topic(b->set->rig_name, MESSAGE_MEMBER, b->member.name, topic);
    snprintf(will, sizeof will, "{\"online\": false, \"boot\": \"%s\"}", b->boot);
    snprintf(client, sizeof client, "hdrig-%s-%s%s", b->set->rig_name, b->member.name,
             leads ? "-conductor" : "");
    err_t e = mqtt_parse_url(b->set->rig_broker, &url);
    if (e)
        return err_fail(e, "rig.broker: %s", err_text());
    e = read_password(b->set->rig_password_file, password);
    const struct mqtt_config m = {.host = url.host,
                                  .port = url.port,
                                  .tls = url.tls,
                                  .ca = url.tls ? b->set->rig_ca : NULL,
                                  .user = password[0] ? b->member.name : NULL,
                                  .password = password[0] ? password : NULL,
                                  .client = client,
                                  .will_topic = topic,
                                  .will = will};
    if (!e)
        e = mqtt_open(&m, &b->mqtt);
    memset(password, 0, sizeof password);
    return e;
}

static err_t subscribe(struct boards *b, enum message_topic t, const char *member)
{
    char topic[MESSAGE_TOPIC_CAP];
    message_topic(b->set->rig_name, t, member, topic);
    return mqtt_subscribe(b->mqtt, topic, t == MESSAGE_ASK || t == MESSAGE_TIME ? 0 : 1);
}

static err_t open_conductor(struct boards *b)
{
    char ids[CONDUCTOR_TAKES][STORE_ID_CAP];
    const struct clocks now = clocks_at(clocks_now());
    struct conductor_config c = {.set = b->set,
                                 .version = b->cfg.version,
                                 .common_ns = now.realtime_ns - now.monotonic_ns,
                                 .has = has_joint,
                                 .ctx = b};
    snprintf(c.epoch, sizeof c.epoch, "%016" PRIx64, (uint64_t)now.realtime_ns);
    memcpy(c.board, b->member.name, sizeof c.board);
    err_t e = conductor_init(&b->conductor, &c);
    if (!e)
        e = tasks_open("fetch", b->cfg.store, b->set->store_path, &b->fetch);
    for (int i = e ? 0 : joint_pending(b->set->store_path, ids, CONDUCTOR_TAKES) - 1; !e && i >= 0;
         i--) {
        struct message_order o;
        char *text = NULL;
        if (joint_order(b->set->store_path, ids[i], &text) == OK &&
            message_read_order(text, strlen(text), &o) == OK)
            lead(b, (struct conductor_event){.kind = CONDUCTOR_MEMORY, .order = &o});
        else
            log_warn("rig: %s waits for its parts, but %s", ids[i], err_text());
        free(text);
    }
    static const enum message_topic heard[] = {MESSAGE_MEMBER, MESSAGE_REPORT, MESSAGE_ASK,
                                               MESSAGE_PRESS};
    for (size_t i = 0; !e && i < sizeof heard / sizeof heard[0]; i++)
        e = subscribe(b, heard[i], "+");
    return e;
}

static err_t open_member(struct boards *b)
{
    struct task k = {.kind = TASK_HOLDS};
    err_t e = subscribe(b, MESSAGE_ORDER, NULL);
    if (!e)
        e = subscribe(b, MESSAGE_TIME, b->member.name);
    return e ? e : tasks_add(b->disk, &k);
}

err_t boards_open(const struct boards_config *cfg, struct boards **out)
{
    *out = NULL;
    struct boards *b = calloc(1, sizeof *b);
    char name[TAKE_MEMBER_CAP];
    if (!b)
        return err_fail(ERR_NOMEM, "rig: no memory for its state");
    b->cfg = *cfg;
    b->set = cfg->set;
    b->has_conductor = cfg->set->rig_role == CONFIG_CONDUCTOR;
    b->has_member = cfg->cameras > 0;
    put_random(b->boot, MESSAGE_EPOCH_CAP - 1);
    snprintf(b->token, sizeof b->token, "%s", cfg->token);
    snprintf(b->broker, sizeof b->broker, "the broker is not reached yet");
    err_t e = check_settings(cfg);
    if (!e)
        e = name_board(cfg->set, name);
    if (!e) {
        member_init(&b->member, name);
        e = tasks_open("rig-disk", cfg->store, cfg->set->store_path, &b->disk);
    }
    if (!e)
        e = open_mqtt(b);
    if (!e)
        e = subscribe(b, MESSAGE_CONDUCTOR, NULL);
    if (!e && b->has_conductor)
        e = open_conductor(b);
    if (!e && b->has_member)
        e = open_member(b);
    if (e) {
        boards_close(b);
        return e;
    }
    *out = b;
    return OK;
}

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
    tasks_close(b->fetch);
    tasks_close(b->disk);
    free(b);
}
