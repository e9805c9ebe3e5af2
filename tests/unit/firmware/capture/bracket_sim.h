/* bracket_sim.h - a rig of free-running cameras for tests of the bracket machine: exposures by
 * sim/device/timing.h, probes of a made-up scene instead of pictures, faults, and the truth. */
#ifndef CAPTURE_BRACKET_SIM_H
#define CAPTURE_BRACKET_SIM_H

#include "core/base/splitmix.h"
#include "firmware/capture/bracket.h"

#include "sim/device/timing.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SIM_QUEUE = 4, SIM_NOISE = 4096, SIM_PATCHES = 192 }; // the other patches are black
#define SIM_TORN (2.0 / 4096)
enum sim_report { SIM_HONEST, SIM_SILENT, SIM_LATE, SIM_EARLY, SIM_HALF };
enum sim_readback { SIM_EXACT, SIM_CACHED, SIM_LAGGED };

struct sim_camera {
    struct timing timing;
    enum sim_report report;
    enum sim_readback readback;
    enum camera_stamp stamp;
    double skew_s; // start of frame 0

    // probabilities per frame, from frame `from` on
    double drop, hide, error, twice, repeat, lag, garble, tear;
    int64_t from;
    bool stuck, stamp_fixed;
    int64_t stamp_value, stamp_add_ns;
    uint32_t sequence_add;
    int64_t ignore_from, ignore_frames; // -1 for ever
    double quantum_s, rollover_s, gain_step, digital, balance_step;
    bool tell_gains;
    bool gains_later;
    int64_t stall_at, stall_frames; // -1 for ever
    int refuse;                     // requests, -1 for ever
    err_t refuse_with;
    int64_t lamp_at, lamp_frames;
    double lamp, lamp_share; // factor; of the patches, 1: all

    float scene[SIM_PATCHES]; // relative exposure after 1 s
    float floor;              // below is dark
    bool bright;              // the other patches are white, not black

    // running
    uint32_t sequence;
    double drift, balance;
    struct exposure last_true, last_set, last_programmed;
    double last_pixels;
    int n_queue;
    struct sim_shot {
        struct frame f;
        double pixels, truth; // exposure by pixels; time x gain
        double former;        // that of the frame before
        int torn;             // patches that have it
        int64_t number;
    } queue[SIM_QUEUE], shot, kept_shot[BRACKET_EXPOSURES_MAX];
    int64_t hold_until;
    double truth[BRACKET_EXPOSURES_MAX];
    struct exposure recorded[BRACKET_EXPOSURES_MAX];
    bool kept[BRACKET_EXPOSURES_MAX];
    int forgotten, restarted;
};

struct sim {
    struct bracket *b;
    int n;
    struct sim_camera *camera;
    int64_t now;
    uint64_t random;
    int frames; // delivered
};

static float sim_noise[SIM_NOISE];

static inline double sim_uniform(struct sim *s)
{
    return (double)(splitmix_next(&s->random) >> 11) * 0x1p-53;
}

static inline int sim_below(struct sim *s, int n)
{
    return (int)(sim_uniform(s) * n);
}

static inline bool sim_chance(struct sim *s, double p)
{
    return p > 0.0 && sim_uniform(s) < p;
}

static inline void sim_make_noise(struct sim *s)
{
    for (int i = 0; i < SIM_NOISE; i++)
        sim_noise[i] = (float)(sqrt(-2.0 * log(1.0 - sim_uniform(s))) *
                               cos(6.283185307179586 * sim_uniform(s)));
}

/* Blocks of 64 px with 10,000 electrons at saturation. */
static inline void sim_probe(struct sim *s, const struct sim_camera *c, const struct sim_shot *shot,
                             bool garbled, struct exposure_probe *w)
{
    int at = sim_below(s, SIM_NOISE - SIM_PATCHES);
    bool lamp = shot->number >= c->lamp_at && shot->number < c->lamp_at + c->lamp_frames;
    float e = (float)shot->pixels;
    int lit = lamp ? (int)(c->lamp_share * SIM_PATCHES) : 0;
    w->dark = w->clipped = 0;
    for (int i = 0; i < SIM_PATCHES; i++) {
        float x = c->scene[i] * (i < lit ? (float)c->lamp : 1.0f);
        x *= i < shot->torn ? (float)shot->former : e;
        float sd = 1.0f / sqrtf(640000.0f * fminf(x, 1.0f) + 1e-6f);
        x *= 1.0f + sd * sim_noise[at + i];
        if (garbled)
            x *= exp2f(3.0f * sim_noise[at + i]);
        w->sd[i] = sd * fminf(x, 1.0f);
        w->x[i] = fminf(x, 1.0f);
        w->floor[i] = c->floor;
        w->state[i] = x >= 0.95f     ? EXPOSURE_PROBE_CLIPPED
                      : x < c->floor ? EXPOSURE_PROBE_DARK
                                     : EXPOSURE_PROBE_GOOD;
        w->clipped += w->state[i] == EXPOSURE_PROBE_CLIPPED;
        w->dark += w->state[i] == EXPOSURE_PROBE_DARK;
    }
    w->good = SIM_PATCHES - w->dark - w->clipped;
    w->overlap = 1.0f;
    w->step = 1.0f / 4096;
    w->linear = true;
    for (int i = SIM_PATCHES; i < EXPOSURE_PROBE_PATCHES; i++) {
        w->x[i] = c->bright ? 1.0f : 0.0f;
        w->floor[i] = c->floor;
        w->state[i] = c->bright ? EXPOSURE_PROBE_CLIPPED : EXPOSURE_PROBE_DARK;
    }
    *(c->bright ? &w->clipped : &w->dark) += EXPOSURE_PROBE_PATCHES - SIM_PATCHES;
}

/* Log radiance evenly over `stops`, its middle at `middle` of saturation in exposure e. */
static inline void sim_scene(struct sim *s, struct sim_camera *c, double stops, double middle,
                             double e)
{
    for (int i = 0; i < SIM_PATCHES; i++)
        c->scene[i] = (float)(middle / e * exp2(stops * (sim_uniform(s) - 0.5)));
    c->floor = 1.0f / 512;
}

static inline void sim_act(struct sim *s);

static inline void sim_tell(struct sim *s, const struct bracket_event *ev)
{
    struct bracket_event e = *ev;
    e.now_ns = s->now;
    err_t code = bracket_event(s->b, &e);
    if (code) {
        printf("%s\n", err_text());
        abort();
    }
    if (ev->kind != BRACKET_ANSWER)
        sim_act(s);
}

static inline err_t sim_request(struct sim_camera *c, const struct exposure *requested,
                                struct exposure *set)
{
    struct timing *t = &c->timing;
    struct exposure got = {timing_time(&t->cfg, requested->time_s),
                           timing_gain(&t->cfg, requested->gain)};
    if (c->refuse != 0) {
        c->refuse -= c->refuse > 0;
        return c->refuse_with;
    }
    *set = c->readback == SIM_EXACT ? got : c->readback == SIM_CACHED ? *requested : c->last_set;
    c->last_set = got;
    timing_write(t, requested->time_s, requested->gain);
    if (t->cfg.delay == 0 && t->time.n > 0) { // even the frame that runs
        t->time.value = t->now.time_s = got.time_s;
        t->time.n = 0;
        if (t->cfg.length == TIMING_STRETCH)
            t->now.end_ns = t->now.start_ns + (int64_t)(fmax(t->cfg.period_s, got.time_s) * 1e9);
    }
    return OK;
}

static inline void sim_act(struct sim *s)
{
    struct bracket_action a;
    struct bracket_event ev;
    while (bracket_action(s->b, &a)) {
        struct sim_camera *c = &s->camera[a.camera];
        switch (a.kind) {
        case BRACKET_REQUEST:
            ev = (struct bracket_event){.kind = BRACKET_ANSWER, .camera = a.camera};
            ev.err = sim_request(c, &a.exposure, &ev.set);
            sim_tell(s, &ev);
            break;
        case BRACKET_KEEP:
            c->kept[a.index] = true;
            c->truth[a.index] = c->shot.truth;
            c->kept_shot[a.index] = c->shot;
            c->recorded[a.index] = a.exposure;
            break;
        case BRACKET_FORGET:
            memset(c->kept, 0, sizeof c->kept);
            c->forgotten++;
            break;
        case BRACKET_RESTART:
            c->restarted++;
            if (c->stall_frames >= 0)
                c->stall_at = INT64_MAX;
            c->n_queue = 0;
            c->sequence = 0;
            sim_tell(s, &(struct bracket_event){.kind = BRACKET_OPENED, .camera = a.camera});
            break;
        }
    }
}

/* Whether any torn patch shows it: by more than the tolerance, as if its label were wrong, and two
 * codes, as if the black level were (core/photo/README.md 5.1). */
static inline bool sim_torn(const struct sim_camera *c, const struct sim_shot *shot)
{
    for (int i = 0; i < shot->torn; i++) {
        double x = fmin(c->scene[i] * shot->pixels, 1.0);
        double off = fabs(x - fmin(c->scene[i] * shot->former, 1.0));
        if (off > SIM_TORN + (exp2(BRACKET_TOLERANCE_LINEAR) - 1.0) * x)
            return true;
    }
    return false;
}

static inline void sim_deliver(struct sim *s, int camera, const struct sim_shot *shot)
{
    static struct exposure_probe w;
    struct sim_camera *c = &s->camera[camera];
    c->shot = *shot;
    bool garbled = sim_chance(s, c->garble);
    sim_probe(s, c, shot, garbled, &w);
    if (garbled || sim_torn(c, shot))
        c->shot.truth = NAN; // it must not be kept
    s->frames++;
    sim_tell(s, &(struct bracket_event){
                    .kind = BRACKET_FRAME, .camera = camera, .frame = &c->shot.f, .probe = &w});
}

/* What the sensor makes of it. */
static inline struct exposure sim_true(const struct sim_camera *c, struct exposure e)
{
    if (c->rollover_s > 0.0)
        e.time_s = fmax(fmod(e.time_s, c->rollover_s), 1e-6);
    if (c->quantum_s > 0.0)
        e.time_s = fmax(floor(e.time_s / c->quantum_s * (1.0 + 1e-9)), 1.0) * c->quantum_s;
    return e;
}

static inline void sim_shoot(struct sim_camera *c, const struct timing_frame *t,
                             struct sim_shot *out)
{
    struct exposure programmed = {t->time_s, t->gain}, e = sim_true(c, programmed);
    struct exposure next = {c->timing.now.time_s, c->timing.now.gain};
    bool struck = t->number >= c->from;
    bool ignored = t->number >= c->ignore_from &&
                   (c->ignore_frames < 0 || t->number < c->ignore_from + c->ignore_frames);
    if (ignored)
        e = c->last_true;
    c->last_true = e;
    c->drift *= struck ? c->gain_step : 1.0;
    c->balance *= struck ? c->balance_step : 1.0;
    memset(out, 0, sizeof *out);
    out->number = t->number;
    out->truth = e.time_s * e.gain * c->drift * (struck && !c->gains_later ? c->digital : 1.0);
    out->pixels = out->truth;
    struct frame *f = &out->f;
    f->w = f->h = 64;
    f->format = CAMERA_GREY;
    f->timestamp_ns = t->start_ns + c->stamp_add_ns * struck;
    if (c->stamp == CAMERA_STAMP_END)
        f->timestamp_ns +=
            (int64_t)(fmin(t->time_s, 1e-9 * (double)(t->end_ns - t->start_ns)) * 1e9);
    if (c->stamp_fixed && struck)
        f->timestamp_ns = c->stamp_value;
    f->exposure_known = c->report != SIM_SILENT;
    f->exposure = c->report == SIM_LATE    ? c->last_programmed
                  : c->report == SIM_EARLY ? next
                                           : programmed;
    if (c->report == SIM_HALF)
        f->exposure.time_s *= 0.5;
    f->gains_known = c->tell_gains;
    f->gains_later = c->gains_later;
    f->digital_gain = struck ? c->digital : 1.0;
    f->red_gain = 1.7 * c->balance;
    f->blue_gain = 1.4 / c->balance;
    c->last_programmed = programmed;
}

/* The frame of one camera that runs ends. */
static inline void sim_end_frame(struct sim *s, int camera)
{
    struct sim_camera *c = &s->camera[camera];
    struct sim_shot shot;
    struct timing_frame t = timing_step(&c->timing);
    s->now = t.end_ns + 200000;
    sim_shoot(c, &t, &shot);
    bool struck = t.number >= c->from;
    bool drop = struck && sim_chance(s, c->drop), hide = drop && sim_chance(s, c->hide);
    if (t.number == c->from)
        c->sequence += c->sequence_add;
    if (!(struck && c->stuck) && !hide)
        c->sequence++;
    shot.f.sequence = c->sequence;
    bool stalled = t.number >= c->stall_at &&
                   (c->stall_frames < 0 || t.number < c->stall_at + c->stall_frames);
    if (struck && sim_chance(s, c->repeat) && c->last_pixels > 0.0)
        shot.pixels = shot.truth = c->last_pixels;
    shot.former = c->last_pixels;
    c->last_pixels = shot.pixels;
    if (struck && shot.former > 0.0 && sim_chance(s, c->tear))
        shot.torn = EXPOSURE_PROBE_EDGE * (1 + sim_below(s, 2));
    if (struck && sim_chance(s, c->error)) {
        shot.f.flags = sim_chance(s, 0.5) ? FRAME_ERROR : FRAME_SHORT;
        shot.pixels *= 3.0;
        shot.truth = NAN;
    }
    if (drop || stalled)
        return;
    if (struck && c->hold_until <= s->now && sim_chance(s, c->lag))
        c->hold_until = s->now + (int64_t)(4.0 * c->timing.cfg.period_s * 1e9 * sim_uniform(s));
    if (c->n_queue < SIM_QUEUE)
        c->queue[c->n_queue++] = shot;
    if (c->hold_until > s->now)
        return;
    int n = c->n_queue;
    c->n_queue = 0;
    for (int i = 0; i < n; i++) {
        sim_deliver(s, camera, &c->queue[i]);
        if (struck && sim_chance(s, c->twice))
            sim_deliver(s, camera, &c->queue[i]);
    }
}

/* The next thing that happens. */
static inline void sim_step(struct sim *s)
{
    int next = 0;
    for (int i = 1; i < s->n; i++)
        if (s->camera[i].timing.now.end_ns < s->camera[next].timing.now.end_ns)
            next = i;
    int64_t due = bracket_deadline(s->b);
    if (due < s->camera[next].timing.now.end_ns) {
        s->now = due;
        sim_tell(s, &(struct bracket_event){.kind = BRACKET_TICK});
        return;
    }
    sim_end_frame(s, next);
}

static inline void sim_camera_init(struct sim_camera *c)
{
    memset(c, 0, sizeof *c);
    c->gain_step = c->balance_step = c->digital = c->drift = c->balance = 1.0;
    c->ignore_from = c->stall_at = c->lamp_at = INT64_MAX;
    c->tell_gains = true;
    c->hold_until = INT64_MIN;
}

static inline void sim_start(struct sim *s, int camera, const struct timing_cfg *t,
                             int64_t start_ns, double base_s)
{
    struct sim_camera *c = &s->camera[camera];
    timing_open(&c->timing, t, start_ns, base_s);
    s->now = start_ns;
    c->last_programmed = c->last_set = (struct exposure){c->timing.now.time_s, 1.0};
    c->last_true = sim_true(c, c->last_set);
    sim_tell(s,
             &(struct bracket_event){.kind = BRACKET_ARM, .camera = camera, .set = {base_s, 1.0}});
}

static inline void sim_begin(struct sim *s, const struct bracket_plan *plan)
{
    for (int i = 0; i < s->n; i++) {
        memset(s->camera[i].kept, 0, sizeof s->camera[i].kept);
        s->camera[i].forgotten = s->camera[i].restarted = 0;
    }
    s->frames = 0;
    sim_tell(s, &(struct bracket_event){.kind = BRACKET_BEGIN, .plan = plan});
}

/* Until the set is over; false if it never is. */
static inline bool sim_run(struct sim *s, int steps)
{
    while (bracket_state(s->b) == BRACKET_SHOOTING && steps-- > 0)
        sim_step(s);
    return bracket_state(s->b) != BRACKET_SHOOTING;
}

#endif
