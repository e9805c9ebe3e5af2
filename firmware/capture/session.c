/* One machine for the rig (bracket.h) and a meter for each camera. A take is a row of plans for the
 * machine: probes until every meter has enough data, the exposures that probes do not already give,
 * and at most one more where the pictures show that something is not covered. Kept frames of all
 * plans are pooled and sorted by exposure at the end. */
#include "firmware/capture/session.h"

#include "drivers/device/clocks.h"
#include "firmware/base/backends.h"
#include "firmware/capture/idle_view.h"
#include "firmware/capture/schedule.h"
#include "firmware/capture/session_inner.h"

#include "core/base/log.h"
#include "drivers/format/subsample.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LOOK_NS INT64_C(250000000) // between looks at a camera that only waits: a fresh reference

/* ---- opening ---- */

static err_t prepare_camera(struct session *s, int i)
{
    struct cam *c = &s->cam[i];
    if (strlen(s->cfg.uri[i]) >= sizeof c->about.uri)
        return err_fail(ERR_ARG, "camera %d: its URI is longer than %zu bytes", i + 1,
                        sizeof c->about.uri - 1);
    strcpy(c->about.uri, s->cfg.uri[i]);
    err_t e = backends_camera(c->about.uri, &c->ops);
    if (e)
        return e;
    c->st = calloc(1, c->ops->state_bytes);
    if (!c->st)
        return err_fail(ERR_NOMEM, "%s: no memory for the camera", c->about.uri);
    e = session_machine_open(s, i);
    if (!e && s->cfg.calibration && c->about.info.unit[0])
        e = calib_load(s->cfg.calibration, &c->about.info, &c->calib, &c->calibrated);
    c->about.has_crf = c->calibrated && c->calib.has_crf;
    c->about.crf = c->calib.crf;
    return e;
}

static err_t make_machine(struct session *s)
{
    struct bracket_camera about[BRACKET_CAMERAS_MAX];
    size_t most = 0;
    for (int i = 0; i < s->n; i++) {
        const struct cam *c = &s->cam[i];
        size_t count = subsample_count(&c->about.info);
        if (!count)
            return err_fail(ERR_UNSUPPORTED, "%s: pictures of %dx%d px cannot be read",
                            c->about.uri, c->about.info.w, c->about.info.h);
        most = count > most ? count : most;
        calib_camera(&c->about.info, c->calibrated ? &c->calib : NULL, &about[i]);
    }
    s->sample.px = malloc(most * sizeof *s->sample.px);
    if (!s->sample.px)
        return err_fail(ERR_NOMEM, "cameras: no memory for a picture");
    return bracket_new(about, s->n, &s->machine);
}

err_t session_open(const struct session_config *cfg, struct session **out)
{
    *out = NULL;
    if (cfg->n < 1 || cfg->n > BRACKET_CAMERAS_MAX)
        return err_fail(ERR_ARG, "%d cameras are given, 1..%d are possible", cfg->n,
                        BRACKET_CAMERAS_MAX);
    struct session *s = calloc(1, sizeof *s);
    if (!s)
        return err_fail(ERR_NOMEM, "cameras: no memory for a session");
    s->cfg = *cfg;
    err_t e = OK;
    for (s->n = 0; !e && s->n < cfg->n; s->n++)
        e = prepare_camera(s, s->n);
    if (!e)
        e = make_machine(s);
    if (!e)
        e = session_machine_arm_all(s, false);
    if (e) {
        session_close(s);
        return e;
    }
    *out = s;
    return OK;
}

void session_close(struct session *s)
{
    if (!s)
        return;
    for (int i = 0; i < s->n; i++) {
        frame_buffer_cut(&s->cam[i].roll, 0);
        session_machine_close(&s->cam[i]);
        free(s->cam[i].st);
    }
    bracket_free(s->machine);
    free(s->sample.px);
    free(s);
}

/* ---- frames ---- */

/* Updates the picture of the status page. */
static void update_view(const struct session *s, struct cam *c, int64_t now)
{
    c->look_ns = now + LOOK_NS;
    c->looked = true;
    c->view.exposure = c->set;
    idle_view_look(&s->sample, &c->view);
    idle_view_shrink(&s->sample, &c->picture);
}

static bool is_shooting(const struct session *s)
{
    return bracket_state(s->machine) == BRACKET_SHOOTING;
}

/* While nothing runs, most frames only count; their pixels are looked at now and then. */
static err_t take_frame(struct session *s, int i, struct frame *f, int64_t now)
{
    struct cam *c = &s->cam[i];
    struct bracket_event ev = {.kind = BRACKET_FRAME, .now_ns = now, .camera = i, .frame = f};
    bool view = now >= c->look_ns, bad = (f->flags & (FRAME_ERROR | FRAME_SHORT)) != 0;
    bool trouble = s->phase == PHASE_TROUBLE;
    if (!is_shooting(s))
        session_start_see(s, i, f, now);
    if (!bad && (is_shooting(s) || view || trouble || s->phase == PHASE_WAIT)) {
        bad = subsample_run(&c->about.info, f, &s->sample) != OK;
        if (!bad && view)
            update_view(s, c, now);
        if (!bad)
            exposure_probe_measure(&s->sample, c->about.has_crf ? &c->about.crf : NULL, &s->probe);
        ev.probe = bad ? NULL : &s->probe;
    }
    if (bad)
        ev.kind = BRACKET_UNUSABLE;
    err_t e = session_machine_event(s, &ev, f);
    if (!e && trouble && ev.probe)
        e = session_trouble_see(s, i, f, ev.probe);
    c->ops->release(c->st, f);
    return e;
}

/* Takes at most as many frames as the camera has buffers, so that no camera delays the others. */
static err_t drain_camera(struct session *s, int i)
{
    struct cam *c = &s->cam[i];
    err_t e = OK;
    for (int n = c->about.info.buffers; n > 0 && c->open && !e; n--) {
        if (s->phase == PHASE_WAIT && session_start_due(s, i))
            return OK;
        struct frame f;
        int64_t now = backends_now(c->ops, c->st); // looking at a frame takes time
        struct bracket_event ev = {.now_ns = now, .camera = i};
        err_t got = c->ops->next(c->st, &f);
        if (got == ERR_AGAIN)
            return OK;
        if (got == OK) {
            e = take_frame(s, i, &f, now);
            continue;
        }
        if (got == ERR_LOST)
            session_machine_lose(s, i);
        ev.kind = got == ERR_LOST ? BRACKET_LOST : BRACKET_UNUSABLE;
        e = session_machine_event(s, &ev, NULL);
    }
    return e;
}

/* ---- lost and found ---- */

static bool same_device(const struct camera_info *a, const struct camera_info *b)
{
    return strcmp(a->unit, b->unit) == 0 && a->w == b->w && a->h == b->h && a->format == b->format;
}

static double better_base(const struct cam *c)
{
    return idle_view_base(&c->view, &c->about.info, c->set.time_s);
}

static err_t adapt_base(struct session *s, int i)
{
    const struct cam *c = &s->cam[i];
    bool waits = c->open && c->looked && s->phase == PHASE_NONE && !s->ready;
    double t = waits ? better_base(c) : 0;
    return t > 0 ? session_machine_arm(s, i, t) : OK;
}

bool session_settled(const struct session *s)
{
    for (int i = 0; i < s->n; i++)
        if (!s->cam[i].looked || better_base(&s->cam[i]) > 0)
            return false;
    return true;
}

static err_t find_lost(struct session *s)
{
    int64_t now = clocks_now();
    bool lost = false;
    for (int i = 0; i < s->n; i++) {
        struct cam *c = &s->cam[i];
        struct camera_info before = c->about.info;
        if (!c->open && now >= c->retry_ns) {
            c->retry_ns = now + SESSION_RETRY_NS;
            c->set.time_s = 0;
            if (session_machine_open(s, i) == OK && !same_device(&before, &c->about.info)) {
                log_warn("%s: came back as %s %dx%d, but was %s %dx%d; it stays unused",
                         c->about.uri, c->about.info.unit, c->about.info.w, c->about.info.h,
                         before.unit, before.w, before.h);
                session_machine_close(c);
                c->about.info = before;
            } else if (c->open)
                log_info("%s: available again", c->about.uri);
        }
        lost = lost || !c->open;
    }
    bool found = s->lost && !lost;
    s->lost = lost;
    err_t e = found ? session_machine_arm_all(s, false) : OK;
    return e == ERR_NOMEM ? e : OK;
}

/* ---- a take ---- */

static err_t begin_plan(struct session *s, enum phase phase, int64_t now)
{
    struct bracket_event ev = {.kind = BRACKET_BEGIN, .now_ns = now, .plan = s->plan};
    for (int i = 0; i < s->n; i++)
        if (!s->cam[i].open) // lost between two plans
            return session_machine_name(
                &s->cam[i], err_fail(ERR_LOST, "%s", bracket_sentence(BRACKET_DEVICE_LOST)));
    s->phase = phase;
    for (int i = 0; i < s->n; i++)
        schedule_steady(&s->order, &s->cam[i].about, &s->plan[i]);
    for (int i = 0; i < s->n; i++)
        s->cam[i].n_before = s->cam[i].roll.n;
    return session_machine_event(s, &ev, NULL);
}

static int count_planned(const struct session *s)
{
    int n = 0;
    for (int i = 0; i < s->n; i++)
        n += s->plan[i].n;
    return n;
}

/* Only now: a kept frame may still be forgotten while its plan runs. */
static err_t meter_probes(struct session *s)
{
    err_t e = OK;
    for (int i = 0; i < s->n && !e; i++) {
        struct cam *c = &s->cam[i];
        e = frame_buffer_meter(&c->roll, c->n_before, &c->about, &s->sample, &c->meter);
    }
    return e;
}

static void plan_probes(struct session *s)
{
    for (int i = 0; i < s->n; i++) {
        const struct cam *c = &s->cam[i];
        schedule_probe(meter_probe(&c->meter), c->set.time_s, &c->about.info, &s->plan[i]);
    }
}

static err_t begin_meters(struct session *s)
{
    for (int i = 0; i < s->n; i++) {
        struct cam *c = &s->cam[i];
        const struct camera_info *info = &c->about.info;
        struct raw kind = subsample_kind(info);
        struct meter_config m;
        bool known = c->calibrated && c->calib.time_max_s > 0;
        meter_defaults(&kind, known ? c->calib.time_min_s : info->time_min_s,
                       known ? c->calib.time_max_s : info->time_max_s, info->time_step_s, &m);
        if (s->order.snr > 0)
            m.snr = s->order.snr;
        m.exposures_max = BRACKET_EXPOSURES_MAX;
        err_t e = meter_begin(&m, &c->meter);
        if (e)
            return session_machine_name(c, e);
    }
    return OK;
}

static err_t plan_shots(struct session *s)
{
    int turn = s->order.turn < 0 ? s->turn : s->order.turn;
    for (int i = 0; i < s->n; i++) {
        struct cam *c = &s->cam[i];
        if (schedule_is_metered(&s->order) && meter_choose(&c->meter, &c->plan) != OK)
            return session_machine_name(c, ERR_ARG);
        schedule_shots(&s->order, i + turn, &c->about.info, &c->plan, &c->roll, &s->plan[i]);
    }
    s->turn += s->order.stagger && s->order.turn < 0;
    return OK;
}

/* Note what is covered; plan one more exposure where it helps; false: nothing to do. */
static bool plan_extension(struct session *s)
{
    bool any = false;
    for (int i = 0; i < s->n; i++) {
        struct cam *c = &s->cam[i];
        struct meter_coverage cover;
        s->plan[i].n = 0;
        frame_buffer_cover(&c->roll, &c->about, &c->meter.cfg, &cover);
        c->plan.clipped = cover.clipped;
        c->plan.dark = cover.dark;
        if (!(cover.extend_s > 0) || frame_buffer_used(&c->roll) >= BRACKET_EXPOSURES_MAX)
            continue;
        s->plan[i] = (struct bracket_plan){.n = 1, .requested = {{cover.extend_s, 1}}};
        any = true;
    }
    return any;
}

static void finish_take(struct session *s, bool complete)
{
    s->complete = complete;
    s->ready = true;
    s->phase = PHASE_NONE;
}

static void note_limits(struct session *s)
{
    for (int i = 0; i < s->n && s->complete && !s->note[0]; i++) {
        const char *limit = schedule_limit(&s->order, &s->cam[i].about.info, &s->cam[i].plan);
        if (limit)
            snprintf(s->note, sizeof s->note, "camera %d: %s", i + 1, limit);
    }
}

static err_t start_plans(struct session *s, int64_t now);

/* The plan that ran is done: the next one, or the end. */
static err_t advance_plan(struct session *s, int64_t now)
{
    err_t e = OK;
    enum phase next = s->phase;
    if (s->relit && s->again)
        return err_fail(ERR_CANCELLED, "%s", bracket_sentence(BRACKET_SCENE_CHANGED));
    if (s->relit) {
        s->relit = false;
        s->again = true;
        return start_plans(s, now);
    }
    if (s->phase == PHASE_PROBE) {
        e = meter_probes(s);
        plan_probes(s);
        if (!e && count_planned(s) == 0) {
            e = plan_shots(s);
            next = PHASE_SHOOT;
        }
    } else if (s->order.mode == SESSION_AUTO && !s->order.stagger && s->order.verify &&
               plan_extension(s) && s->phase == PHASE_SHOOT)
        next = PHASE_EXTEND;
    else {
        finish_take(s, true);
        return OK;
    }
    if (e)
        return e;
    if (count_planned(s) == 0) { // probes were enough
        s->phase = next;
        return advance_plan(s, now);
    }
    return begin_plan(s, next, now);
}

static void fail_take(struct session *s, const char *why)
{
    snprintf(s->reason, sizeof s->reason, "%s", why);
    finish_take(s, false);
}

static err_t handle_fault(struct session *s)
{
    int i = 0;
    enum bracket_reason r = bracket_reason(s->machine, &i);
    if (!s->cancelled)
        session_trouble_sentence(s, i, r);
    if (!s->cancelled && session_trouble_is_light(s, r))
        return session_trouble_begin(s);
    finish_take(s, false);
    return OK;
}

/* While flicker is measured. If it is the reason, the take starts again. */
static err_t follow_trouble(struct session *s, int64_t now)
{
    enum session_outcome what = SESSION_STEADY;
    err_t e = s->cancelled || s->lost ? OK : session_trouble_end(s, &what);
    if (!e && what == SESSION_FLICKERS)
        return start_plans(s, now);
    if (e || what == SESSION_STEADY)
        finish_take(s, false);
    return OK;
}

/* While lenses focus. */
static err_t follow_focus(struct session *s, int64_t now)
{
    err_t e = s->cancelled ? OK : session_focus(s, false);
    if (s->cancelled)
        finish_take(s, false);
    return e == ERR_AGAIN || s->cancelled ? OK : e ? e : start_plans(s, now);
}

/* While the start is in the future. */
static err_t follow_wait(struct session *s, int64_t now)
{
    err_t e = s->cancelled ? OK : session_start_wait(s);
    if (s->cancelled)
        finish_take(s, false);
    return e == ERR_AGAIN || s->cancelled ? OK : e ? e : begin_plan(s, PHASE_SHOOT, now);
}

/* Continues the take from the state of the machine. */
static err_t follow_machine(struct session *s, int64_t now)
{
    struct bracket_progress p;
    err_t e = s->phase == PHASE_TROUBLE ? follow_trouble(s, now)
              : s->phase == PHASE_FOCUS ? follow_focus(s, now)
              : s->phase == PHASE_WAIT  ? follow_wait(s, now)
                                        : OK;
    while (s->phase > PHASE_WAIT && s->phase != PHASE_TROUBLE && !e && !is_shooting(s)) {
        bracket_progress(s->machine, &p);
        s->frames_used += p.frames;
        s->rejected += p.rejected;
        if (bracket_state(s->machine) == BRACKET_DONE)
            e = advance_plan(s, now);
        else
            e = handle_fault(s);
    }
    if (e && s->phase != PHASE_NONE) {
        fail_take(s, err_text());
        e = OK;
    }
    return e;
}

/* Starts the take anew: empty meters, no kept frames. */
static err_t start_plans(struct session *s, int64_t now)
{
    bool metered = schedule_is_metered(&s->order);
    s->reason[0] = 0;
    for (int i = 0; i < s->n; i++)
        frame_buffer_cut(&s->cam[i].roll, 0);
    err_t e = begin_meters(s);
    if (!e && metered)
        plan_probes(s);
    else if (!e)
        e = plan_shots(s);
    if (!e && s->order.start_ns > 0)
        e = session_start_begin(s);
    else if (!e)
        e = begin_plan(s, metered ? PHASE_PROBE : PHASE_SHOOT, now);
    return e;
}

static err_t check_order(const struct session *s, const struct session_order *o)
{
    if (o->mode == SESSION_LIST && (o->n < 1 || o->n > BRACKET_EXPOSURES_MAX))
        return err_fail(ERR_ARG, "%d exposures are given, 1..%d are possible", o->n,
                        BRACKET_EXPOSURES_MAX);
    if (o->start_ns > 0 && schedule_is_metered(o))
        return err_fail(ERR_ARG, "a start is given, but the exposures are to be metered first");
    if (s->ready || s->phase != PHASE_NONE)
        return err_fail(ERR_BUSY, "another capture is still running");
    for (int i = 0; i < s->n; i++)
        if (!s->cam[i].open)
            return err_fail(ERR_LOST, "%s: the camera is not there", s->cam[i].about.uri);
    return OK;
}

err_t session_begin(struct session *s, const struct session_order *o)
{
    int64_t now = session_machine_now(s);
    err_t e = check_order(s, o);
    if (e)
        return e;
    s->order = *o;
    s->cancelled = s->relit = s->again = s->tried = false;
    s->reason[0] = s->note[0] = 0;
    s->frames_used = s->rejected = 0;
    s->trigger = clocks_at(o->trigger_ns ? o->trigger_ns : now);
    e = session_focus(s, o->refocus);
    if (e == ERR_AGAIN) {
        s->phase = PHASE_FOCUS;
        return OK;
    }
    if (!e)
        e = start_plans(s, now);
    if (e)
        s->phase = PHASE_NONE;
    return e ? e : follow_machine(s, now);
}

void session_cancel(struct session *s, const char *reason)
{
    struct bracket_event ev = {.kind = BRACKET_CANCEL, .now_ns = session_machine_now(s)};
    if (s->phase == PHASE_NONE)
        return;
    s->cancelled = true;
    snprintf(s->reason, sizeof s->reason, "%s", reason);
    if (session_machine_event(s, &ev, NULL) != OK || follow_machine(s, ev.now_ns) != OK)
        fail_take(s, reason);
}

/* ---- the finished take ---- */

static void describe_take(struct session *s, struct take *t)
{
    t->status = s->complete ? TAKE_COMPLETE : TAKE_ABORTED;
    t->trigger = s->trigger;
    t->clock_synced = clocks_synced();
    t->stagger = s->order.stagger;
    t->metered = schedule_is_metered(&s->order);
    t->frames_used = s->frames_used;
    t->rejected = s->rejected;
    t->skew_s = take_skew_s(t);
    note_limits(s);
    if (s->complete && s->order.skew_s > 0 && t->skew_s > s->order.skew_s) {
        t->status = TAKE_ABORTED;
        snprintf(s->reason, sizeof s->reason,
                 "cameras started %.3g s apart, bracket.skew_ms is %.3g", t->skew_s,
                 s->order.skew_s * 1e3);
    }
    bool flickers = false;
    for (int i = 0; i < t->n; i++)
        flickers = flickers || t->frame[i].evidence.proof == BRACKET_UNVERIFIED_FLICKER;
    if (t->status == TAKE_COMPLETE && take_unverified(t))
        snprintf(s->reason, sizeof s->reason, "%s to prove every exposure by its pixels",
                 flickers ? "the light flickers too much" : "too dark or too bright");
    int moved = take_lens_moved(t);
    if (moved >= 0)
        snprintf(s->note, sizeof s->note, "the lens of camera %d moved between its frames",
                 moved + 1);
    bool both = s->reason[0] && s->note[0];
    snprintf(t->reason, sizeof t->reason, "%.180s%s%.70s", s->reason, both ? "; " : "", s->note);
}

err_t session_collect(struct session *s, struct take **out)
{
    *out = NULL;
    if (!s->ready)
        return err_fail(ERR_AGAIN, "no take is ready");
    struct take *t = calloc(1, sizeof *t);
    if (!t)
        return err_fail(ERR_NOMEM, "take: no memory for its frames");
    t->n_cameras = s->n;
    for (int i = 0; i < s->n; i++) {
        struct cam *c = &s->cam[i];
        struct bracket_camera about;
        calib_camera(&c->about.info, c->calibrated ? &c->calib : NULL, &about);
        t->tolerance = fmax(t->tolerance, about.tolerance);
        t->camera[i] = c->about;
        t->meter[i] = c->plan;
        frame_buffer_move(&c->roll, t);
    }
    describe_take(s, t);
    s->ready = false;
    *out = t;
    err_t e = session_machine_arm_all(s, t->status == TAKE_COMPLETE &&
                                             bracket_state(s->machine) == BRACKET_DONE);
    return e == ERR_NOMEM ? e : OK; // a camera that does not follow is looked for again
}

/* ---- state ---- */

enum session_state session_state(const struct session *s)
{
    if (s->ready)
        return SESSION_READY;
    if (s->phase == PHASE_FOCUS || s->phase == PHASE_PROBE)
        return SESSION_METERING;
    if (s->phase != PHASE_NONE)
        return SESSION_SHOOTING;
    return s->lost ? SESSION_LOST : SESSION_ARMED;
}

const char *session_status(const struct session *s)
{
    static const char *const words[] = {[SESSION_LOST] = "waits for a camera",
                                        [SESSION_ARMED] = "ready to capture",
                                        [SESSION_METERING] = "meters the light",
                                        [SESSION_SHOOTING] = "takes the exposures",
                                        [SESSION_READY] = "hands over a capture"};
    return s->phase == PHASE_FOCUS  ? "focuses"
           : s->phase == PHASE_WAIT ? "waits for the start"
                                    : words[session_state(s)];
}

double session_longest_s(const struct session *s)
{
    double longest = 0;
    for (int i = 0; i < s->n; i++)
        longest = fmax(longest, s->cam[i].set.time_s);
    return longest;
}

double session_lead_s(const struct session *s)
{
    return session_start_lead_s(s);
}

int session_cameras(const struct session *s)
{
    return s->n;
}

const struct take_camera *session_camera(const struct session *s, int i)
{
    return &s->cam[i].about;
}

void session_progress(const struct session *s, struct bracket_progress *out)
{
    bracket_progress(s->machine, out);
}

void session_view(const struct session *s, int camera, struct session_view *out)
{
    *out = s->cam[camera].view;
}

const struct idle_view_picture *session_picture(const struct session *s, int camera)
{
    return &s->cam[camera].picture;
}

/* ---- the loop ---- */

int session_poll(const struct session *s, struct pollfd *fds, int cap, int64_t *deadline_ns)
{
    int n = 0;
    bool timed = s->phase == PHASE_TROUBLE || s->phase == PHASE_FOCUS || s->phase == PHASE_WAIT;
    *deadline_ns = timed ? s->until_ns : bracket_deadline(s->machine);
    for (int i = 0; i < s->n; i++) {
        const struct cam *c = &s->cam[i];
        if (c->open && n < cap)
            fds[n++] = (struct pollfd){.fd = c->ops->fd(c->st), .events = POLLIN | POLLPRI};
        if (!c->open && c->retry_ns < *deadline_ns)
            *deadline_ns = c->retry_ns;
    }
    return n;
}

err_t session_step(struct session *s)
{
    // a frame is late only if it had not arrived by now: measuring the others takes time
    int64_t now = session_machine_now(s);
    struct bracket_event tick = {.kind = BRACKET_TICK, .now_ns = now};
    err_t e = OK;
    for (int i = 0; !e && i < s->n; i++)
        e = drain_camera(s, i);
    if (!e && now >= bracket_deadline(s->machine))
        e = session_machine_event(s, &tick, NULL);
    now = session_machine_now(s);
    if (e && e != ERR_NOMEM && s->phase != PHASE_NONE) {
        session_cancel(s, err_text());
        e = OK;
    }
    if (!e)
        e = follow_machine(s, now);
    for (int i = 0; !e && i < s->n; i++)
        e = adapt_base(s, i);
    if (!e && s->lost && s->phase == PHASE_NONE)
        e = find_lost(s);
    return e == ERR_NOMEM ? e : OK;
}
