/* Any sequence of events: actions are few and in range, states change only as documented, evidence
 * is there for exactly the frames that were said to be kept, and is sound; a set ends. */
#include "firmware/capture/bracket.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CAMERAS = 3, FRAMES_MAX = 2000, PATCHES = 64 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct input {
    const uint8_t *p;
    size_t left;
};

struct rig {
    struct bracket *b;
    int n;
    int64_t now;
    struct bracket_plan plan[CAMERAS];
    struct exposure base[CAMERAS];
    struct frame frame[CAMERAS]; // the last one
    bool kept[CAMERAS][BRACKET_EXPOSURES_MAX];
    int frames;   // since BEGIN, usable or not
    bool willing; // cameras do as they are asked
};

static unsigned byte(struct input *in)
{
    if (in->left == 0)
        return 0;
    in->left--;
    return *in->p++;
}

static void must(bool truth)
{
    if (!truth)
        abort();
}

/* Mostly sensible; sometimes not even a number. */
static double number(struct input *in)
{
    static const double odd[] = {0.0, -1.0, NAN, INFINITY, 1e-300, 1e300, 1e9, 60.0};
    unsigned k = byte(in);
    return k < 8 ? odd[k] : 0.01 * exp2((double)k / 16.0 - 8.0);
}

static struct exposure exposure(struct input *in)
{
    struct exposure e = {number(in), 1.0};
    unsigned k = byte(in);
    if (k < 4)
        e.gain = number(in);
    return e;
}

static void make_probe(struct input *in, double e, struct exposure_probe *w)
{
    unsigned light = byte(in), part = byte(in);
    memset(w, 0, sizeof *w);
    w->overlap = 1.0f;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        double x = i < PATCHES ? e * exp2(0.1 * i) * exp2(light / 32.0) : 0.0;
        if (part < 8 && i % 8 < (int)part)
            x *= 4.0;
        w->x[i] = (float)fmin(x, 1.0);
        w->sd[i] = (float)(0.007 * fmin(x, 1.0));
        w->floor[i] = 1e-3f;
        w->state[i] = x >= 1.0    ? EXPOSURE_PROBE_CLIPPED
                      : x >= 1e-3 ? EXPOSURE_PROBE_GOOD
                                  : EXPOSURE_PROBE_DARK;
        w->good += w->state[i] == EXPOSURE_PROBE_GOOD;
        w->dark += w->state[i] == EXPOSURE_PROBE_DARK;
        w->clipped += w->state[i] == EXPOSURE_PROBE_CLIPPED;
    }
}

static void check_action(struct rig *r, const struct bracket_action *a)
{
    must(a->camera >= 0 && a->camera < r->n);
    const struct bracket_plan *plan = &r->plan[a->camera];
    if (a->kind == BRACKET_REQUEST) {
        bool known = a->exposure.time_s == r->base[a->camera].time_s;
        for (int i = 0; i < plan->n; i++)
            known |= a->exposure.time_s == plan->requested[i].time_s;
        must(known && a->exposure.time_s > 0.0 && a->exposure.gain >= 1.0);
    } else if (a->kind == BRACKET_KEEP) {
        must(a->index >= 0 && a->index < plan->n && !r->kept[a->camera][a->index]);
        r->kept[a->camera][a->index] = true;
    } else if (a->kind == BRACKET_FORGET) {
        memset(r->kept[a->camera], 0, sizeof r->kept[0]);
    }
}

static void check_evidence(const struct rig *r)
{
    struct bracket_progress p;
    int kept = 0;
    for (int c = 0; c < r->n; c++)
        for (int i = 0; i < r->plan[c].n; i++) {
            const struct bracket_evidence *v = bracket_evidence(r->b, c, i);
            must((v != NULL) == r->kept[c][i]);
            if (!v)
                continue;
            kept++;
            must(v->exposure.time_s > 0.0 && isfinite(v->exposure.time_s) &&
                 v->exposure.gain > 0.0);
            must(v->proof >= BRACKET_REPORTED && v->proof <= BRACKET_UNVERIFIED_BRIGHT);
            must(v->proof > BRACKET_PIXELS || (v->ratio_known && v->patches > 5));
            must(v->proof != BRACKET_REPORTED || v->reported_known);
            must(!v->ratio_known || isfinite(v->ratio));
            must(v->requested.time_s == r->plan[c].requested[i].time_s);
        }
    bracket_progress(r->b, &p);
    must(p.kept == kept && p.kept <= p.wanted);
    must(bracket_state(r->b) != BRACKET_DONE || p.kept == p.wanted);
    must(bracket_state(r->b) == BRACKET_SHOOTING || bracket_deadline(r->b) == INT64_MAX);
}

static void tell(struct rig *r, struct bracket_event *ev, struct input *in)
{
    static const bool legal[5][5] = {
        [BRACKET_IDLE] = {true, true, false, false, false},
        [BRACKET_ARMED] = {true, true, true, false, false},
        [BRACKET_SHOOTING] = {false, false, true, true, true},
        [BRACKET_DONE] = {true, true, true, true, false},
        [BRACKET_FAULT] = {true, true, false, false, true},
    };
    enum bracket_state before = bracket_state(r->b);
    struct bracket_action a;
    ev->now_ns = r->now;
    err_t e = bracket_event(r->b, ev);
    must(legal[before][bracket_state(r->b)] && (!e || before == bracket_state(r->b)));
    if (!e && (ev->kind == BRACKET_BEGIN || ev->kind == BRACKET_ARM))
        memset(r->kept, 0, ev->kind == BRACKET_BEGIN ? sizeof r->kept : 0);
    if (!e && ev->kind == BRACKET_ARM) {
        r->base[ev->camera] = ev->set;
        r->plan[ev->camera].n = 0;
        memset(r->kept[ev->camera], 0, sizeof r->kept[0]);
    }
    for (int i = 0; bracket_action(r->b, &a); i++) {
        must(i < 4 * CAMERAS);
        check_action(r, &a);
        struct bracket_event answer = {.kind = BRACKET_ANSWER, .camera = a.camera};
        answer.now_ns = r->now;
        answer.set = a.exposure;
        unsigned k = r->willing ? 255 : byte(in);
        if (k < 16)
            answer.set.time_s = number(in);
        else if (k < 32)
            answer.err = k == 16 ? ERR_LOST : ERR_BUSY;
        if (a.kind == BRACKET_REQUEST && k != 32)
            (void)!bracket_event(r->b, &answer);
    }
    check_evidence(r);
}

static void frame(struct rig *r, struct bracket_event *ev, struct input *in)
{
    static struct exposure_probe w;
    struct frame *f = &r->frame[ev->camera];
    unsigned how = byte(in);
    struct exposure shown = exposure(in);
    f->w = f->h = 64;
    f->flags = how == 1 ? FRAME_ERROR : how == 2 ? FRAME_SHORT : 0;
    f->sequence += how == 3 ? byte(in) : how == 4 ? 0 : 1;
    f->timestamp_ns = how == 5 ? (int64_t)byte(in) * 100000000 : r->now - 33000000;
    if (how == 6)
        f->timestamp_ns = byte(in) & 1 ? INT64_MAX : INT64_MIN;
    if (how == 7)
        f->w = 32;
    f->exposure_known = how & 16;
    f->exposure = how & 32 ? shown : exposure(in);
    f->gains_known = how & 64;
    f->digital_gain = how == 72 ? number(in) : 1.0;
    f->red_gain = how == 73 ? number(in) : 2.0;
    f->blue_gain = 1.5;
    make_probe(in, shown.time_s, &w);
    ev->frame = how == 8 ? NULL : f;
    ev->probe = how == 9 ? NULL : &w;
    must(++r->frames < FRAMES_MAX || bracket_state(r->b) != BRACKET_SHOOTING);
    tell(r, ev, in);
}

static void begin(struct rig *r, struct bracket_event *ev, struct input *in)
{
    struct bracket_plan plan[CAMERAS] = {0};
    for (int c = 0; c < r->n; c++) {
        plan[c].n = (int)(byte(in) % 11);
        for (int i = 0; i < plan[c].n && i < BRACKET_EXPOSURES_MAX; i++)
            plan[c].requested[i] = exposure(in);
    }
    ev->plan = plan;
    // nothing else may look at a plan that is refused
    struct bracket_plan before[CAMERAS];
    memcpy(before, r->plan, sizeof before);
    enum bracket_state state = bracket_state(r->b);
    memcpy(r->plan, plan, sizeof before);
    ev->now_ns = r->now;
    struct bracket_action a;
    if (bracket_event(r->b, ev)) {
        memcpy(r->plan, before, sizeof before);
        must(bracket_state(r->b) == state && !bracket_action(r->b, &a));
        return;
    }
    must(state == BRACKET_ARMED || state == BRACKET_DONE);
    memset(r->kept, 0, sizeof r->kept);
    r->frames = 0;
    ev->kind = BRACKET_ANSWER; // answers nothing: only to take the actions
    ev->err = ERR_BUSY;
    ev->camera = 0;
    tell(r, ev, in);
}

static void step(struct rig *r, struct input *in)
{
    unsigned k = byte(in);
    struct bracket_event ev = {.camera = (int)(byte(in) % (unsigned)r->n)};
    r->now += (int64_t)(byte(in) + 1) * (k & 128 ? 1000000000 : 300000);
    ev.kind = k % 16 < 7 ? BRACKET_FRAME : (enum bracket_event_kind)(k % 16 - 7);
    switch (ev.kind) {
    case BRACKET_FRAME:
    case BRACKET_UNUSABLE:
        frame(r, &ev, in);
        break;
    case BRACKET_BEGIN:
        begin(r, &ev, in);
        break;
    case BRACKET_ANSWER:
    case BRACKET_ARM:
        ev.set = exposure(in);
        tell(r, &ev, in);
        break;
    default:
        tell(r, &ev, in);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input in = {data, size};
    struct rig r = {.n = 1 + (int)(byte(&in) % CAMERAS)};
    struct bracket_camera cfg[CAMERAS];
    for (int i = 0; i < r.n; i++) {
        unsigned k = byte(&in);
        cfg[i] = (struct bracket_camera){.period_s = 0.033,
                                         .time_min_s = 1e-5,
                                         .time_max_s = 60.0,
                                         .time_step_s = k & 1 ? 1e-5 : 0.0,
                                         .delay_lo = (int)(k >> 1 & 3),
                                         .delay_hi = (int)((k >> 1 & 3) + (k >> 3 & 7)),
                                         .reports = k & 64,
                                         .tolerance = k & 128 ? 0.1 : 0.3};
    }
    unsigned kind = byte(&in);
    r.now = kind & 1 ? INT64_MAX / 2 : 1000000000;
    r.willing = !(kind & 2);
    must(bracket_new(cfg, r.n, &r.b) == OK);
    while (in.left > 0)
        step(&r, &in);
    bracket_free(r.b);
    return 0;
}
