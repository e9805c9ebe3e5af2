#include "firmware/rig/boards.h"

#include "firmware/rig/boards_inner.h"

#include "core/base/log.h"
#include "drivers/device/clocks.h"

#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>

#define SECOND INT64_C(1000000000)
#define HEARTBEAT_NS (5 * SECOND) // between announcements of an unchanged state
#define ASK_NS SECOND             // between questions for the time,
#define ASK_FAST_NS (SECOND / 10) // and the first of them
enum { ASK_FAST = 10 };

/* ---- the member ---- */

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
    boards_act_report(b, MEMBER_METERED, &r);
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
            boards_act_failed(b, t->reason);
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
        boards_act_failed(b, e ? text : t->reason);
        return;
    }
    snprintf(r.part, sizeof r.part, "%s", id);
    for (int i = 0; i < t->n; i++)
        r.start[r.n_starts++] = (struct message_start){
            t->frame[i].camera, t->frame[i].index, t->frame[i].common_ns, t->frame[i].within_ns};
    b->report = r; // told when the parts have been listed again
    b->reports = true;
    boards_act_add(b->disk, &k);
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
    boards_act_publish_time(b, MESSAGE_ASK, b->member.name, &m);
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
    boards_act_member(b);
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
        boards_act_tell(b, ev);
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
    boards_act_tell(b, (struct conductor_event){.kind = CONDUCTOR_TICK});
    ask_time(b, now);
    if (b->has_member && b->member.up && b->member.led &&
        (now - b->said_ns > HEARTBEAT_NS || has_changed(b)))
        boards_act_announce(b);
}

err_t boards_press(struct boards *b, bool asked)
{
    struct message_time m = {0};
    if (b->has_conductor)
        return boards_act_lead(b,
                               (struct conductor_event){.kind = CONDUCTOR_PRESS, .asked = asked});
    if (!b->member.up || !b->member.led)
        return err_fail(ERR_LOST, "%s", boards_trouble(b));
    if (asked)
        return err_fail(ERR_UNSUPPORTED, "this board is a member of the rig: the conductor alone "
                                         "tells how a capture ended");
    memcpy(m.epoch, b->member.epoch, sizeof m.epoch);
    m.sent_ns = clocks_now();
    boards_act_publish_time(b, MESSAGE_PRESS, b->member.name, &m);
    return OK;
}

err_t boards_cancel(struct boards *b)
{
    return boards_act_lead(b, (struct conductor_event){.kind = CONDUCTOR_CANCEL});
}

err_t boards_forget(struct boards *b, const char *what)
{
    return boards_act_lead(b, (struct conductor_event){.kind = CONDUCTOR_FORGET, .take = what});
}

err_t boards_accept(struct boards *b, const char *take)
{
    return boards_act_lead(b, (struct conductor_event){.kind = CONDUCTOR_ACCEPT, .take = take});
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

void boards_close(struct boards *b)
{
    if (!b)
        return;
    if (b->mqtt)
        boards_act_leave(b);
    mqtt_close(b->mqtt);
    for (int i = 0; i < BOARDS_FETCHERS; i++)
        tasks_close(b->fetch[i]);
    tasks_close(b->disk);
    free(b);
}
