/* The machine of the rig (bracket.h) and its cameras: what it asks for is done, what happens to the
 * cameras is told to it. */
#include "firmware/capture/session_inner.h"

#include "drivers/device/clocks.h"
#include "firmware/base/backends.h"

#include "core/base/log.h"

#include <math.h>

#define BASE_S 0.01 // exposure while armed, to begin with

int64_t session_machine_now(const struct session *s)
{
    int64_t now = INT64_MAX;
    for (int i = 0; i < s->n; i++) {
        int64_t t = s->cam[i].open ? backends_now(s->cam[i].ops, s->cam[i].st) : INT64_MAX;
        now = t < now ? t : now;
    }
    return now < INT64_MAX ? now : clocks_now();
}

/* ---- cameras ---- */

err_t session_machine_name(const struct cam *c, err_t e)
{
    return err_fail(e, "%s: %s", c->about.uri, err_text());
}

/* Asked before the first order: one that comes too late to try it would leave it open, and all
 * later ones would be given the time to. */
static bool is_fixed(const struct cam *c)
{
    double set_s;
    return !c->ops->shift || c->ops->shift(c->st, 0.0, &set_s) == ERR_UNSUPPORTED;
}

err_t session_machine_open(struct session *s, int i)
{
    struct cam *c = &s->cam[i];
    struct camera_cfg cfg = {c->about.uri, s->cfg.w, s->cfg.h, s->cfg.format, 0};
    struct camera_info info;
    err_t e = c->ops->open(c->st, &cfg);
    if (e)
        return session_machine_name(c, e);
    c->ops->info(c->st, &info);
    c->open = true;
    c->starts.fixed = is_fixed(c);
    session_start_forget(c);
    c->view = (struct session_view){.present = true};
    c->about.info = info;
    return OK;
}

void session_machine_close(struct cam *c)
{
    if (c->open)
        c->ops->close(c->st);
    c->open = false;
    c->view.present = false;
}

/* ---- actions of the machine ---- */

static err_t keep_frame(struct session *s, const struct bracket_action *a, const struct frame *f)
{
    struct cam *c = &s->cam[a->camera];
    struct take_frame t = {.camera = a->camera,
                           .index = a->index,
                           .evidence = *bracket_evidence(s->machine, a->camera, a->index)};
    size_t held = f->bytes;
    for (int i = 0; i < s->n; i++)
        held += frame_buffer_bytes(&s->cam[i].roll);
    if (s->cfg.memory && held > s->cfg.memory)
        return err_fail(ERR_LIMIT, "%s: the frames need %zu MB, max_memory_mb allows %zu",
                        c->about.uri, held / 1000000, s->cfg.memory / 1000000);
    if (s->phase == PHASE_PROBE && a->index + 1 < s->plan[a->camera].n)
        return OK; // a link
    t.start = clocks_at(t.evidence.start_ns);
    return frame_buffer_add(&c->roll, &t, f, s->phase != PHASE_PROBE);
}

/* Drops the frames of this plan; if the light changed, earlier frames and probes as well. */
static void forget_frames(struct session *s, const struct bracket_action *a)
{
    struct cam *c = &s->cam[a->camera];
    bool relit = a->index == 1;
    s->relit = s->relit || (relit && c->n_before > 0);
    frame_buffer_cut(&c->roll, relit ? 0 : c->n_before);
}

static err_t request_exposure(struct session *s, const struct bracket_action *a, int64_t now)
{
    struct cam *c = &s->cam[a->camera];
    struct bracket_event answer = {
        .kind = BRACKET_ANSWER, .now_ns = now, .camera = a->camera, .err = ERR_LOST};
    if (c->open)
        answer.err = c->ops->request(c->st, &a->exposure, &answer.set);
    if (!answer.err) {
        c->set = answer.set;
        session_start_asked(c);
    }
    return bracket_event(s->machine, &answer);
}

void session_machine_lose(struct session *s, int i)
{
    struct cam *c = &s->cam[i];
    log_warn("%s: %s", c->about.uri, err_text());
    session_machine_close(c);
    c->retry_ns = clocks_now() + SESSION_RETRY_NS; // it may have no clock any more
    s->lost = true;
}

static err_t restart_camera(struct session *s, int i, int64_t now)
{
    struct bracket_event ev = {.kind = BRACKET_OPENED, .now_ns = now, .camera = i};
    log_warn("%s: no frames come, it is started again", s->cam[i].about.uri);
    session_machine_close(&s->cam[i]);
    if (session_machine_open(s, i) != OK) {
        session_machine_lose(s, i);
        ev.kind = BRACKET_LOST;
    }
    return bracket_event(s->machine, &ev);
}

/* Passes an event to the machine and carries out its actions. f: the frame of the event. */
err_t session_machine_event(struct session *s, const struct bracket_event *ev,
                            const struct frame *f)
{
    struct bracket_action a;
    err_t e = bracket_event(s->machine, ev);
    while (!e && bracket_action(s->machine, &a)) {
        if (a.kind == BRACKET_REQUEST)
            e = request_exposure(s, &a, ev->now_ns);
        else if (a.kind == BRACKET_KEEP && f) // nothing else is kept
            e = keep_frame(s, &a, f);
        else if (a.kind == BRACKET_FORGET)
            forget_frames(s, &a);
        else if (a.kind == BRACKET_RESTART)
            e = restart_camera(s, a.camera, ev->now_ns);
    }
    return e;
}

/* ---- waiting ---- */

/* A camera that refuses the request is treated as lost. */
static err_t arm(struct session *s, int i, double base_s, bool same)
{
    struct cam *c = &s->cam[i];
    const struct camera_info *info = &c->about.info;
    struct bracket_event ev = {.kind = BRACKET_ARM, .camera = i, .same = same};
    struct exposure requested = {fmin(fmax(base_s, info->time_min_s), info->time_max_s), 1};
    if (base_s > 0) {
        err_t e = c->ops->request(c->st, &requested, &c->set);
        if (!e && fabs(log2(c->set.time_s / requested.time_s)) > 0.1) // reads back what was before?
            e = c->ops->request(c->st, &requested, &c->set);
        if (e) {
            e = session_machine_name(c, e);
            session_machine_lose(s, i);
            return e;
        }
    }
    ev.now_ns = backends_now(c->ops, c->st);
    ev.set = c->set;
    c->looked = false;
    c->look_ns = ev.now_ns + (int64_t)(SESSION_SETTLE * fmax(info->period_s, c->set.time_s) * 1e9);
    err_t e = session_machine_event(s, &ev, NULL);
    session_start_rest(c, bracket_settled(s->machine, i));
    return e;
}

err_t session_machine_arm(struct session *s, int i, double base_s)
{
    return arm(s, i, base_s, false);
}

/* Arms all open cameras, also after an error. Returns the first error. */
err_t session_machine_arm_all(struct session *s, bool same)
{
    err_t first = OK;
    for (int i = 0; i < s->n; i++) {
        if (!s->cam[i].open)
            continue;
        err_t e = arm(s, i, s->cam[i].set.time_s > 0 ? 0 : BASE_S, same);
        first = first ? first : e;
    }
    return first;
}
