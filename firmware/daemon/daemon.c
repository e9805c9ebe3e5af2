/* Every turn of the loop collects descriptors and the nearest deadline, waits, and runs each part
 * once; no part blocks. A press becomes a take when the session is armed and the writer has room;
 * for a press in between trigger.busy is the policy. */
#include "firmware/daemon/daemon.h"

#include "drivers/device/clocks.h"
#include "firmware/base/backends.h"
#include "firmware/capture/schedule.h"
#include "firmware/daemon/daemon_inner.h"

#include "core/base/log.h"
#include "drivers/format/file.h"
#include "drivers/format/json.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/signalfd.h>
#include <sys/timerfd.h>
#include <systemd/sd-daemon.h>
#include <time.h>
#include <unistd.h>

enum {
    FDS_MAX = 64,
    RETRY_S = 2,          // for missing devices
    WRITER_LIMIT_S = 120, // a take that is written for longer hangs
    STOP_MARGIN_MS = 1500 // beyond the longest exposure
};

static void remember_take(struct daemon *d, const char *id)
{
    struct summary s;
    if (summary_read(d->set->store_path, id, &s) != OK) {
        log_warn("%s", err_text());
        return;
    }
    memmove(&d->recent[1], &d->recent[0], (DAEMON_RECENT - 1) * sizeof d->recent[0]);
    d->recent[0] = s;
    d->n_recent += d->n_recent < DAEMON_RECENT;
}

/* ---- takes ---- */

static void tell_asking(struct daemon *d, const char *json)
{
    for (int i = 0; i < d->n_asking; i++)
        ctl_answer(d->ctl, d->asking[i], json);
    d->n_asking = 0;
}

/* {"ok": false, "error": sentence}, or with the name of a take. */
static void tell_error(struct daemon *d, uint64_t id, const char *text)
{
    char *json = NULL;
    size_t n;
    FILE *f = open_memstream(&json, &n);
    if (!f)
        return;
    fputs("{\"ok\": false, \"error\": ", f);
    json_put_string(f, text);
    fputs("}", f);
    if (fclose(f) == 0 && id)
        ctl_answer(d->ctl, id, json);
    else if (json)
        tell_asking(d, json);
    free(json);
}

static err_t begin_order(struct daemon *d, const struct session_order *o)
{
    uint64_t need = 0;
    for (int i = 0; i < session_cameras(d->session); i++)
        need += store_need(d->store, &session_camera(d->session, i)->info, schedule_frames(o));
    err_t e = store_room(d->store, need);
    if (!e)
        e = collect_room(&d->collect);
    return e ? e : session_begin(d->session, o);
}

static err_t begin_take(struct daemon *d, int64_t press_ns, bool asked)
{
    struct session_order o;
    schedule_order(d->set, press_ns, &o);
    o.refocus = d->collect.places.n == 0; // the places of a scene have one focus
    err_t e = d->boards ? boards_press(d->boards, asked) : begin_order(d, &o);
    snprintf(d->trouble, sizeof d->trouble, "%s", e ? err_text() : "");
    if (e) {
        d->count.refused++;
        log_warn("no capture: %s", err_text());
    }
    return e;
}

static bool can_shoot(struct daemon *d)
{
    return d->session && session_state(d->session) == SESSION_ARMED && writer_free(d->writer) &&
           !d->stopping;
}

static bool can_begin(struct daemon *d)
{
    return d->boards ? !d->stopping && !boards_trouble(d->boards) : can_shoot(d);
}

static bool is_busy(const struct daemon *d)
{
    if (d->boards)
        return boards_is_busy(d->boards);
    return d->session && session_state(d->session) != SESSION_LOST;
}

static err_t queue_press(struct daemon *d, int64_t press_ns)
{
    int slots = d->set->trigger_busy == CONFIG_QUEUE ? d->set->trigger_queue : 1;
    if (d->set->trigger_busy == CONFIG_REJECT || d->n_waiting == slots) {
        if (d->set->trigger_busy == CONFIG_COALESCE) {
            d->count.coalesced++;
            return OK;
        }
        d->count.rejected++;
        return err_fail(ERR_BUSY, d->set->trigger_busy == CONFIG_REJECT
                                      ? "a capture runs"
                                      : "a capture runs and the queue is full");
    }
    d->waiting[d->n_waiting++] = press_ns;
    d->count.queued++;
    return OK;
}

static err_t handle_press(struct daemon *d, int64_t press_ns, bool asked)
{
    d->count.presses++;
    if (can_begin(d))
        return begin_take(d, press_ns, asked);
    if (is_busy(d))
        return queue_press(d, press_ns);
    d->count.refused++;
    return err_fail(ERR_LOST, "%s",
                    d->boards ? boards_trouble(d->boards) : daemon_status_sentence(d));
}

static void begin_waiting(struct daemon *d)
{
    while (d->n_waiting > 0 && can_begin(d)) {
        int64_t press_ns = d->waiting[0];
        d->n_waiting--;
        memmove(d->waiting, d->waiting + 1, (size_t)d->n_waiting * sizeof d->waiting[0]);
        if (begin_take(d, press_ns, d->n_asking > 0) == OK)
            return;
    }
}

/* A place goes to the writer when the one before is stored, since that decides its session. */
static void collect_place(struct daemon *d)
{
    struct take *t;
    if (!d->session || session_state(d->session) != SESSION_READY || !writer_free(d->writer) ||
        (d->collect.on && d->n_written > 0))
        return;
    if (session_collect(d->session, &t) != OK)
        return;
    collect_take(&d->collect, t);
    if (d->boards && boards_works(d->boards) && !boards_take(d->boards, t)) {
        take_free(t); // it was for metering
        return;
    }
    if (writer_put(d->writer, t) == OK)
        d->n_written++;
    else
        take_free(t);
}

static void tell_take(struct daemon *d, const char *id)
{
    char *json = NULL;
    size_t n;
    FILE *f = open_memstream(&json, &n);
    if (!f)
        return;
    fprintf(f, "{\"ok\": true, \"id\": \"%s\"", id);
    if (d->collect.on) {
        fputs(", \"session\": ", f);
        collect_write(&d->collect, f);
    }
    fputs("}", f);
    if (fclose(f) == 0)
        tell_asking(d, json);
    free(json);
}

/* A part of a rig's take: the rig tells of the whole. */
static bool finish_part(struct daemon *d, const struct writer_outcome *o)
{
    if (!d->boards || !o->take->rig.take[0])
        return false;
    log_info("%s: %d frames, part of %s%s%s", o->err ? "not stored" : o->id, o->take->n,
             o->take->rig.take, o->err ? ": " : "", o->err ? o->text : "");
    boards_stored(d->boards, o->take, o->id, o->err, o->text);
    return true;
}

static void finish_take(struct daemon *d, const struct writer_outcome *o)
{
    bool complete = o->take->status == TAKE_COMPLETE;
    if (finish_part(d, o))
        return;
    if (o->err) {
        log_error("capture not stored: %s", o->text);
        snprintf(d->trouble, sizeof d->trouble, "%.*s", TAKE_TEXT - 1, o->text);
        tell_error(d, 0, o->text);
        d->count.aborted++;
        return;
    }
    bool is_place = complete && o->take->is_place;
    if (complete && collect_look(&d->collect) != OK)
        log_warn("%s", err_text());
    log_info("%s: %d frames%s%s%s%s", o->id, o->take->n, o->take->reason[0] ? ", " : "",
             o->take->reason, is_place ? ", " : "", is_place ? d->collect.line : "");
    remember_take(d, o->id);
    d->count.takes += complete;
    d->count.aborted += !complete;
    if (complete)
        tell_take(d, o->id);
    else
        tell_error(d, 0, o->take->reason);
    if (complete && !is_place && d->jobs && jobs_add(d->jobs, o->id) != OK)
        log_warn("%s", err_text());
}

static void finish_takes(struct daemon *d)
{
    struct writer_outcome o;
    while (writer_outcome(d->writer, &o) == OK) {
        d->n_written--;
        finish_take(d, &o);
        take_free(o.take);
    }
}

/* ---- the rig ---- */

static const char *on_trouble(void *ctx)
{
    struct daemon *d = ctx;
    if (can_shoot(d) && !d->calibrator.on)
        return NULL;
    return d->session && session_state(d->session) == SESSION_ARMED ? "stores a capture"
                                                                    : daemon_status_sentence(d);
}

static double on_lead(void *ctx)
{
    const struct daemon *d = ctx;
    return d->session ? session_lead_s(d->session) : 0;
}

static err_t on_begin(void *ctx, const struct session_order *o)
{
    struct daemon *d = ctx;
    return can_shoot(d) ? begin_order(d, o) : err_fail(ERR_BUSY, "%s", on_trouble(d));
}

static void on_stop(void *ctx)
{
    struct daemon *d = ctx;
    if (d->session)
        session_cancel(d->session, "cancelled");
}

static void on_told(void *ctx, err_t err, const char *id, const char *text, bool asked)
{
    struct daemon *d = ctx;
    d->count.takes += !err;
    d->count.aborted += err != OK;
    snprintf(d->trouble, sizeof d->trouble, "%s", err ? text : "");
    if (!err) {
        log_info("%s: all boards%s%s", id, text[0] ? ", but " : "", text);
        remember_take(d, id);
    }
    if (asked && err)
        tell_error(d, 0, text);
    else if (asked)
        tell_take(d, id);
    if (!err && d->jobs && jobs_add(d->jobs, id) != OK)
        log_warn("%s", err_text());
}

/* ---- commands ---- */

static void cancel_work(struct daemon *d)
{
    if (d->calibrator.on)
        calibrator_cancel(&d->calibrator);
    else if (d->boards && boards_cancel(d->boards) == OK)
        log_info("cancelled");
    else if (d->session && (session_state(d->session) == SESSION_SHOOTING ||
                            session_state(d->session) == SESSION_METERING))
        session_cancel(d->session, "cancelled");
    else if (d->jobs)
        jobs_cancel(d->jobs);
    d->n_waiting = 0;
}

static err_t end_session(struct daemon *d)
{
    bool idle = !is_busy(d) || session_state(d->session) == SESSION_ARMED;
    return collect_end(&d->collect, d->n_written > 0 || d->n_waiting > 0 || !idle);
}

static void on_press(void *ctx, int64_t press_ns, bool is_long)
{
    struct daemon *d = ctx;
    if ((is_long ? end_session(d) : handle_press(d, press_ns, false)) != OK)
        log_info("press not answered: %s", err_text());
}

static err_t run_command(void *ctx, const char *line)
{
    struct daemon *d = ctx;
    if (strcmp(line, "capture") == 0 || strcmp(line, "capture wait") == 0)
        return handle_press(d, clocks_now(), line[7] != 0);
    const bool accepts = strncmp(line, "accept ", 7) == 0;
    if (accepts || strncmp(line, "forget ", 7) == 0)
        return !d->boards ? err_fail(ERR_ARG, "rig.role is alone: no capture waits for boards")
               : accepts  ? boards_accept(d->boards, line + 7)
                          : boards_forget(d->boards, line + 7);
    if (strcmp(line, "cancel") == 0) {
        cancel_work(d);
        return OK;
    }
    if (strcmp(line, "session") == 0)
        return OK;
    if (strcmp(line, "session end") == 0)
        return end_session(d);
    if (strcmp(line, "session scene") == 0)
        return collect_scene(&d->collect);
    return err_fail(ERR_ARG,
                    "unknown command \"%.40s\": status, capture [wait], session [end|scene], "
                    "calibrate [WHAT SECONDS], accept ID, forget ID, cancel",
                    line);
}

static void write_session(void *ctx, FILE *f)
{
    const struct daemon *d = ctx;
    fputs("{\"ok\": true, \"session\": ", f);
    collect_write(&d->collect, f);
    fputs("}", f);
}

static void answer_with(struct daemon *d, uint64_t id, void (*write)(void *ctx, FILE *f))
{
    char *json = NULL;
    size_t n;
    FILE *f = open_memstream(&json, &n);
    if (!f)
        return;
    write(d, f);
    if (fclose(f) == 0)
        ctl_answer(d->ctl, id, json);
    free(json);
}

/* The cameras are closed for it; open_cameras opens them afterwards. */
static err_t begin_calibration(struct daemon *d, uint64_t id, const char *line)
{
    const bool busy = d->session && session_state(d->session) != SESSION_LOST && !can_shoot(d);
    if (d->stopping || busy)
        return err_fail(ERR_BUSY, "a capture runs: calibrate between captures");
    err_t e = calibrator_begin(&d->calibrator, id, line);
    if (e)
        return e;
    session_close(d->session);
    d->session = NULL;
    return OK;
}

static void on_line(void *ctx, uint64_t id, const char *line)
{
    struct daemon *d = ctx;
    bool wait = strcmp(line, "capture wait") == 0;
    bool is_order = strncmp(line, "calibrate", 9) == 0;
    if (strcmp(line, "status") == 0)
        answer_with(d, id, daemon_status_write);
    else if (is_order && begin_calibration(d, id, line) == OK)
        return; // the calibrator answers
    else if (is_order || run_command(d, line) != OK)
        tell_error(d, id, err_text());
    else if (strncmp(line, "session", 7) == 0)
        answer_with(d, id, write_session);
    else if (wait && d->n_asking < CTL_CLIENTS_MAX)
        d->asking[d->n_asking++] = id;
    else
        ctl_answer(d->ctl, id, "{\"ok\": true}");
}

/* ---- the loop ---- */

static void open_cameras(struct daemon *d, int64_t now, err_t *fatal)
{
    const struct config *c = d->set;
    if (d->session || d->calibrator.on || now < d->retry_ns || !c->camera[0][0])
        return;
    struct session_config s = {.w = c->camera_w,
                               .h = c->camera_h,
                               .format = (enum camera_format)c->camera_format,
                               .calibration = c->calibration_path,
                               .memory = (size_t)config_memory_mb(c) * 1000000};
    while (s.n < CONFIG_CAMERAS && c->camera[s.n][0]) {
        s.uri[s.n] = c->camera[s.n];
        s.n++;
    }
    err_t e = session_open(&s, &d->session);
    if (e == ERR_ARG || e == ERR_UNSUPPORTED || e == ERR_NOMEM)
        *fatal = e;
    else if (e && strcmp(d->trouble, err_text()) != 0)
        log_warn("%s; trying again", err_text());
    snprintf(d->trouble, sizeof d->trouble, "%s", e ? err_text() : "");
    d->retry_ns = now + RETRY_S * INT64_C(1000000000);
}

static void read_signals(struct daemon *d)
{
    struct signalfd_siginfo s;
    while (read(d->signals, &s, sizeof s) == sizeof s) {
        if (d->stopping)
            continue;
        double longest = d->session ? session_longest_s(d->session) : 0;
        log_info("%s: stopping", strsignal((int)s.ssi_signo));
        d->stopping = true;
        d->stop_ns = clocks_now() + (int64_t)(longest * 1e9) + STOP_MARGIN_MS * INT64_C(1000000);
        sd_notifyf(0, "STOPPING=1\nEXTEND_TIMEOUT_USEC=%.0f", (longest + 10) * 1e6);
        if (d->session)
            session_cancel(d->session, "shutdown");
    }
}

static bool set_clock(int fd)
{
    struct itimerspec far = {.it_value = {.tv_sec = INT32_MAX}};
    return timerfd_settime(fd, TFD_TIMER_ABSTIME | TFD_TIMER_CANCEL_ON_SET, &far, NULL) == 0;
}

/* CLOCK_REALTIME was set: names do not depend on it, and manifests have both clocks. */
static void read_clock(struct daemon *d)
{
    uint64_t n;
    if (read(d->clock, &n, sizeof n) >= 0 || errno != ECANCELED)
        return;
    d->count.clock_steps++;
    log_info("the time of day was set");
    set_clock(d->clock);
}

static void show_lamp(struct daemon *d, int64_t now)
{
    if (!d->lamp)
        return;
    enum lamp_state s = LAMP_BUSY;
    if (d->calibrator.on)
        s = LAMP_BUSY;
    else if (!d->session || session_state(d->session) == SESSION_LOST || d->trouble[0])
        s = LAMP_FAULT;
    else if (can_begin(d))
        s = LAMP_ARMED;
    lamp_show(d->lamp, s, now);
    if (now >= lamp_next_ns(d->lamp) && lamp_tick(d->lamp, now) != OK)
        log_warn("lamp: %s", err_text());
}

/* Only a loop that turns and a writer that makes progress keep the watchdog quiet. */
static void notify_watchdog(struct daemon *d, int64_t now)
{
    int64_t since = writer_since_ns(d->writer);
    if (!d->pet_every_ns || now < d->pet_ns)
        return;
    if (since && now - since > WRITER_LIMIT_S * INT64_C(1000000000))
        return;
    d->pet_ns = now + d->pet_every_ns;
    sd_notifyf(0, "WATCHDOG=1\nSTATUS=%s", daemon_status_sentence(d));
}

static int64_t earlier_deadline(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

static int gather_fds(struct daemon *d, struct pollfd *fds, int64_t *deadline)
{
    int64_t now = clocks_now();
    int n = 0;
    *deadline = now + RETRY_S * INT64_C(1000000000);
    fds[n++] = (struct pollfd){.fd = d->signals, .events = POLLIN};
    fds[n++] = (struct pollfd){.fd = d->clock, .events = POLLIN};
    fds[n++] = (struct pollfd){.fd = writer_fd(d->writer), .events = POLLIN};
    if (d->http)
        fds[n++] = http_poll(d->http, now, deadline);
    if (d->boards) {
        int64_t due = INT64_MAX;
        n += boards_poll(d->boards, fds + n, FDS_MAX - n, &due);
        *deadline = earlier_deadline(*deadline, due);
    }
    n += triggers_poll(d->triggers, fds + n, FDS_MAX - n);
    n += ctl_poll(d->ctl, fds + n, FDS_MAX - n);
    n += calibrator_poll(&d->calibrator, fds + n, FDS_MAX - n);
    if (d->jobs)
        n += jobs_poll(d->jobs, fds + n, FDS_MAX - n);
    if (d->session) {
        int64_t due = INT64_MAX;
        n += session_poll(d->session, fds + n, FDS_MAX - n, &due);
        *deadline = earlier_deadline(*deadline, due);
    }
    if (d->lamp)
        *deadline = earlier_deadline(*deadline, lamp_next_ns(d->lamp));
    if (d->pet_every_ns)
        *deadline = earlier_deadline(*deadline, d->pet_ns);
    return n;
}

static err_t run_turn(struct daemon *d)
{
    int64_t now = clocks_now();
    err_t e = OK;
    read_signals(d);
    read_clock(d);
    if (!d->stopping)
        open_cameras(d, now, &e);
    if (!e && d->session)
        e = session_step(d->session);
    if (e)
        return e;
    if (!d->stopping)
        e = triggers_step(d->triggers, now);
    if (e)
        return e;
    ctl_step(d->ctl);
    calibrator_step(&d->calibrator);
    calibrator_answer(&d->calibrator, can_begin(d), now);
    if (d->http)
        http_step(d->http);
    collect_place(d);
    finish_takes(d);
    if (d->boards && !d->stopping)
        boards_step(d->boards);
    begin_waiting(d);
    if (d->collect.ending && end_session(d) != OK)
        log_warn("the session does not end: %s", err_text());
    if (d->jobs && !d->stopping)
        jobs_step(d->jobs);
    show_lamp(d, now);
    notify_watchdog(d, now);
    return OK;
}

static bool is_finished(struct daemon *d)
{
    if (!d->stopping)
        return false;
    enum session_state s = d->session ? session_state(d->session) : SESSION_LOST;
    return s == SESSION_ARMED || s == SESSION_LOST || clocks_now() >= d->stop_ns;
}

static err_t run_loop(struct daemon *d)
{
    err_t e = run_turn(d);
    sd_notify(0, "READY=1");
    while (!e && !is_finished(d)) {
        struct pollfd fds[FDS_MAX];
        int64_t deadline;
        int n = gather_fds(d, fds, &deadline);
        int64_t left = deadline - clocks_now();
        struct timespec wait = {.tv_sec = left > 0 ? left / 1000000000 : 0,
                                .tv_nsec = left > 0 ? left % 1000000000 : 0};
        if (ppoll(fds, (nfds_t)n, &wait, NULL) < 0 && errno != EINTR)
            return err_fail(ERR_IO, "poll: %s", strerror(errno));
        e = run_turn(d);
    }
    return e;
}

/* ---- start and end ---- */

static err_t open_signals(struct daemon *d)
{
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGTERM);
    sigaddset(&set, SIGINT);
    signal(SIGPIPE, SIG_IGN); // writes tell of it, and of files that may not grow
    signal(SIGXFSZ, SIG_IGN);
    sigprocmask(SIG_BLOCK, &set, NULL);
    d->signals = signalfd(-1, &set, SFD_NONBLOCK | SFD_CLOEXEC);
    d->clock = timerfd_create(CLOCK_REALTIME, TFD_NONBLOCK | TFD_CLOEXEC);
    if (d->signals < 0 || d->clock < 0 || !set_clock(d->clock))
        return err_fail(ERR_IO, "signalfd or timerfd: %s", strerror(errno));
    return OK;
}

static err_t open_triggers(struct daemon *d)
{
    const struct triggers_config t = {.uri = d->set->trigger,
                                      .lockout_ms = d->set->trigger_lockout_ms,
                                      .hold_ms = d->collect.on ? d->set->session_hold_ms : 0,
                                      .find = backends_trigger,
                                      .press = on_press,
                                      .ctx = d};
    return triggers_open(&t, &d->triggers);
}

static err_t open_store(struct daemon *d)
{
    char ids[DAEMON_RECENT][STORE_ID_CAP];
    struct store_config s = {d->set->store_path, (uint64_t)d->set->store_reserve_mb * 1000000,
                             d->set->store_merge != 0, d->set->bracket_moved / 100.0,
                             d->set->store_keep};
    err_t e = store_open(&s, &d->store);
    if (!e)
        e = writer_open(d->store, &d->writer);
    if (e)
        return e;
    for (int i = store_list(d->store, ids, DAEMON_RECENT) - 1; i >= 0; i--)
        remember_take(d, ids[i]);
    return OK;
}

static err_t open_lamp(struct daemon *d)
{
    if (!d->set->lamp[0])
        return OK;
    err_t e = lamp_open(d->set->lamp, &d->lamp);
    if (e == ERR_ARG || e == ERR_NOMEM)
        return e;
    if (e)
        log_warn("lamp: %s", err_text());
    return OK;
}

static err_t open_boards(struct daemon *d)
{
    const struct boards_config b = {.set = d->set,
                                    .version = d->cfg->version,
                                    .store = d->store,
                                    .cameras = d->collect.cameras,
                                    .http_port = d->http ? http_port(d->http) : 0,
                                    .token = d->parts_token,
                                    .ctx = d,
                                    .trouble = on_trouble,
                                    .lead_s = on_lead,
                                    .begin = on_begin,
                                    .stop = on_stop,
                                    .told = on_told};
    return boards_open(&b, &d->boards);
}

static err_t open_all(struct daemon *d)
{
    const struct config *c = d->set;
    err_t e = open_signals(d);
    if (!e)
        e = open_store(d);
    struct jobs_config jobs = {d->cfg->program, c->store_path, c->results_path, d->cfg->config_path,
                               c->job_launcher};
    if (!e && c->job_run)
        e = jobs_open(&jobs, &d->jobs);
    d->collect =
        (struct collect){.store = c->store_path, .jobs = d->jobs, .on = config_collects(c)};
    while (d->collect.cameras < CONFIG_CAMERAS && c->camera[d->collect.cameras][0])
        d->collect.cameras++;
    if (!e)
        e = collect_look(&d->collect);
    if (!e)
        e = ctl_open(c->control_socket, on_line, d, &d->ctl);
    d->calibrator = (struct calibrator){
        .set = c, .config_path = d->cfg->config_path, .program = d->cfg->program, .ctl = d->ctl};
    if (!e && c->rig_role != CONFIG_ALONE)
        e = boards_open_token(d->parts_token);
    struct http_config http = {.address = c->http_address,
                               .port = c->http_port,
                               .token = c->http_token,
                               .parts_token = c->rig_role != CONFIG_ALONE ? d->parts_token : NULL,
                               .captures = c->store_path,
                               .results = c->results_path,
                               .ctx = d,
                               .status = daemon_status_write,
                               .live = daemon_status_live,
                               .command = run_command};
    if (!e && c->http_port)
        e = http_open(&http, &d->http);
    if (!e && c->rig_role != CONFIG_ALONE)
        e = open_boards(d);
    if (!e)
        e = open_triggers(d);
    if (!e)
        e = open_lamp(d);
    uint64_t us = 0;
    if (!e && sd_watchdog_enabled(0, &us) > 0)
        d->pet_every_ns = (int64_t)us * 1000 / 3;
    return e;
}

/* Log what this daemon serves, and where. */
static void tell_start(const struct daemon *d)
{
    const struct config *c = d->set;
    const char *config = d->cfg->config_path;
    bool v6 = strchr(c->http_address, ':') != NULL;
    for (int i = 0; i < CONFIG_CAMERAS; i++)
        if (c->camera[i][0])
            log_info("camera.%d: %s", i + 1, c->camera[i]);
    for (int i = 0; i < CONFIG_TRIGGERS; i++)
        if (c->trigger[i][0])
            log_info("trigger.%d: %s", i + 1, c->trigger[i]);
    log_info("captures: %s, scenes: %s", c->store_path,
             d->jobs ? c->results_path : "none are made");
    if (d->collect.on)
        log_info("session: %s; hdrig session end makes one scene of its places", d->collect.line);
    if (d->http)
        log_info("page: http://%s%s%s:%d", v6 ? "[" : "", c->http_address, v6 ? "]" : "",
                 http_port(d->http));
    log_info("commands: hdrig capture|session|calibrate|status|cancel%s%s, at %s",
             config ? " --config " : "", config ? config : "", c->control_socket);
}

static void close_all(struct daemon *d)
{
    while (d->n_written > 0) { // a place that waits needs to know the session of those before
        struct pollfd p = {.fd = writer_fd(d->writer), .events = POLLIN};
        poll(&p, 1, -1);
        finish_takes(d);
    }
    collect_place(d);
    session_close(d->session);
    triggers_close(d->triggers);
    calibrator_close(&d->calibrator);
    lamp_close(d->lamp);
    boards_close(d->boards);
    writer_close(d->writer);
    store_close(d->store);
    jobs_close(d->jobs);
    http_close(d->http);
    ctl_close(d->ctl);
    if (d->signals >= 0)
        close(d->signals);
    if (d->clock >= 0)
        close(d->clock);
}

err_t daemon_run(const struct daemon_config *cfg)
{
    struct daemon *d = calloc(1, sizeof *d);
    if (!d)
        return err_fail(ERR_NOMEM, "daemon: no memory");
    d->cfg = cfg;
    d->set = cfg->settings;
    d->signals = d->clock = -1;
    d->start_ns = clocks_now();
    err_t e = open_all(d);
    if (!e)
        tell_start(d);
    if (!e)
        e = run_loop(d);
    close_all(d);
    free(d);
    return e;
}
