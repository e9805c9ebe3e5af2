/* The bracket machine: every transition and every reason, what it costs, and the extremes.
 * (Random sets against the truth: bracket_random_test.c.) */
#include "tests/unit/firmware/capture/bracket_sim.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TOLERANCE 0.10

/* ---- a plain rig ---- */

struct rig {
    struct sim sim;
    struct sim_camera camera[BRACKET_CAMERAS_MAX];
    struct bracket_camera cfg[BRACKET_CAMERAS_MAX];
    struct bracket_plan plan[BRACKET_CAMERAS_MAX];
    struct timing_cfg timing;
    double base_s;
};

static struct rig rig;

/* Cameras that do what they promise; n exposures, `step` stops apart, around base. */
static void rig_open(int cameras, int delay, int n, double step)
{
    memset(&rig, 0, sizeof rig);
    rig.sim = (struct sim){.n = cameras, .camera = rig.camera, .random = 7};
    rig.base_s = 0.01;
    rig.timing = (struct timing_cfg){.period_s = 1.0 / 30.0,
                                     .longest_s = 100.0,
                                     .gain_max = 1.0,
                                     .delay = delay,
                                     .length = TIMING_STRETCH};
    for (int i = 0; i < cameras; i++) {
        rig.cfg[i] = (struct bracket_camera){.period_s = rig.timing.period_s,
                                             .time_min_s = 1e-6,
                                             .time_max_s = 60.0,
                                             .delay_lo = delay,
                                             .delay_hi = delay,
                                             .reports = true,
                                             .tolerance = TOLERANCE};
        sim_camera_init(&rig.camera[i]);
        sim_scene(&rig.sim, &rig.camera[i], 10.0, 0.05, rig.base_s);
        rig.plan[i].n = n;
        for (int k = 0; k < n; k++)
            rig.plan[i].ask[k] =
                (struct exposure){rig.base_s * exp2(step * (k - 0.5 * (n - 1))), 1.0};
    }
}

static void rig_arm(int64_t start_ns)
{
    for (int i = 0; i < rig.sim.n; i++)
        sim_start(&rig.sim, i, &rig.timing, start_ns + 1000000 * i, rig.base_s);
}

static void rig_ready(void)
{
    assert_int_equal(bracket_new(rig.cfg, rig.sim.n, &rig.sim.b), OK);
    rig_arm(1000000000);
    for (int i = 0; i < 16 * rig.sim.n; i++)
        sim_step(&rig.sim);
}

static void rig_close(void)
{
    bracket_free(rig.sim.b);
}

static enum bracket_reason rig_shoot(void)
{
    int camera;
    sim_begin(&rig.sim, rig.plan);
    assert_true(sim_run(&rig.sim, 200000));
    return bracket_reason(rig.sim.b, &camera);
}

/* Every frame of the plans is kept, rightly labelled; with what proof at least. */
static void assert_complete(enum bracket_proof weakest)
{
    assert_int_equal(bracket_state(rig.sim.b), BRACKET_DONE);
    for (int c = 0; c < rig.sim.n; c++)
        for (int i = 0; i < rig.plan[c].n; i++) {
            const struct bracket_evidence *v = bracket_evidence(rig.sim.b, c, i);
            double t = rig.plan[c].ask[i].time_s;
            assert_non_null(v);
            assert_true(v->proof <= weakest);
            assert_true(fabs(log2(v->exposure.time_s / t)) < 0.01 && v->asked.time_s == t);
            assert_true(fabs(log2(rig.camera[c].truth[i] / t)) < 0.01);
            assert_true(!v->ratio_known || fabs(v->ratio - v->ratio_asked) < TOLERANCE);
        }
}

static void tell(enum bracket_event_kind kind, int camera)
{
    sim_tell(&rig.sim,
             &(struct bracket_event){.kind = kind, .camera = camera, .set = {rig.base_s, 1.0}});
}

static void refused(const struct bracket_event *ev, const char *sentence)
{
    struct bracket_action a;
    enum bracket_state before = bracket_state(rig.sim.b);
    assert_int_equal(bracket_event(rig.sim.b, ev), ERR_ARG);
    if (!strstr(err_text(), sentence))
        fail_msg("\"%s\" lacks \"%s\"", err_text(), sentence);
    assert_int_equal(bracket_state(rig.sim.b), before);
    assert_false(bracket_action(rig.sim.b, &a));
}

/* ---- what it costs ---- */

enum { SILENT = 1, UNKNOWN = 2, ELSEWHERE = 4, KINDS = 8 }; // report, delay, base: not in the plan

/* Frames beyond exposures and delay, the worse of two sets. */
static int frames_beyond(int n, int delay, int kind)
{
    int worst = 0;
    struct bracket_progress p;
    rig_open(1, delay, n, 1.0);
    rig.camera[0].report = kind & SILENT ? SIM_SILENT : SIM_HONEST;
    rig.cfg[0].reports = !(kind & SILENT);
    rig.base_s *= kind & ELSEWHERE ? 1.3 : 1.0;
    if (kind & UNKNOWN) {
        rig.cfg[0].delay_lo = 0;
        rig.cfg[0].delay_hi = 8;
    }
    rig_ready();
    for (int set = 0; set < 2; set++) { // the second without a new reference
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(kind & SILENT ? BRACKET_PIXELS : BRACKET_REPORTED);
        bracket_progress(rig.sim.b, &p);
        assert_int_equal(p.frames, rig.sim.frames);
        assert_true(p.kept == n && p.wanted == n && p.rejected == 0 && !p.resting);
        worst = p.frames - n - delay > worst ? p.frames - n - delay : worst;
    }
    rig_close();
    return worst;
}

static void test_frames_used(void **state)
{
    (void)state;
    for (int n = 1; n <= 9; n++)
        for (int delay = 0; delay <= 6; delay++)
            for (int kind = 0; kind < KINDS; kind++)
                assert_in_range(frames_beyond(n, delay, kind), 0, 1); // 2 are allowed
}

/* ---- transitions ---- */

static void test_states(void **state)
{
    int camera;
    (void)state;
    rig_open(2, 2, 3, 2.0);
    assert_int_equal(bracket_new(rig.cfg, 2, &rig.sim.b), OK);
    struct bracket *b = rig.sim.b;
    struct bracket_event begin = {.kind = BRACKET_BEGIN, .plan = rig.plan};
    assert_int_equal(bracket_state(b), BRACKET_IDLE);
    refused(&begin, "once all cameras stream");
    tell(BRACKET_ARM, 0);
    assert_int_equal(bracket_state(b), BRACKET_IDLE);
    tell(BRACKET_ARM, 1);
    assert_int_equal(bracket_state(b), BRACKET_ARMED);
    tell(BRACKET_LOST, 0);
    assert_int_equal(bracket_state(b), BRACKET_IDLE);
    refused(&begin, "once all cameras stream");
    assert_true(bracket_deadline(b) == INT64_MAX);
    rig_arm(1000);
    assert_int_equal(bracket_state(b), BRACKET_ARMED);
    tell(BRACKET_CANCEL, 0); // nothing to cancel
    tell(BRACKET_TICK, 0);
    assert_int_equal(bracket_state(b), BRACKET_ARMED);
    sim_begin(&rig.sim, rig.plan); // has to wait for the reference
    assert_int_equal(bracket_state(b), BRACKET_SHOOTING);
    refused(&begin, "once all cameras stream");
    refused(&(struct bracket_event){.kind = BRACKET_ARM, .set = {0.01, 1.0}},
            "while a bracket runs");
    assert_true(sim_run(&rig.sim, 1000));
    assert_complete(BRACKET_REPORTED);
    tell(BRACKET_CANCEL, 0);
    assert_int_equal(bracket_state(b), BRACKET_DONE);
    tell(BRACKET_LOST, 1);
    assert_int_equal(bracket_state(b), BRACKET_DONE); // evidence can still be read
    assert_non_null(bracket_evidence(b, 1, 0));
    refused(&begin, "once all cameras stream");
    tell(BRACKET_ARM, 0);
    assert_int_equal(bracket_state(b), BRACKET_IDLE);
    assert_null(bracket_evidence(b, 0, 0));
    tell(BRACKET_ARM, 1);
    assert_int_equal(bracket_state(b), BRACKET_ARMED);
    sim_begin(&rig.sim, rig.plan);
    tell(BRACKET_CANCEL, 0);
    assert_int_equal(bracket_state(b), BRACKET_FAULT);
    assert_true(bracket_reason(b, &camera) == BRACKET_CANCELLED && camera == -1);
    tell(BRACKET_CANCEL, 0);
    tell(BRACKET_LOST, 0);
    assert_int_equal(bracket_state(b), BRACKET_FAULT);
    rig_arm(5000000000);
    assert_int_equal(bracket_state(b), BRACKET_ARMED);
    assert_true(bracket_reason(b, &camera) == BRACKET_NONE && camera == -1);
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_REPORTED);
    rig_close();
}

/* Cancelled after any number of frames, the camera goes back to base. */
static void test_cancel(void **state)
{
    (void)state;
    for (int frames = 0; frames < 8; frames++) {
        rig_open(1, 2, 3, 2.0);
        rig_ready();
        sim_begin(&rig.sim, rig.plan);
        for (int i = 0; i < frames; i++)
            sim_step(&rig.sim);
        tell(BRACKET_CANCEL, 0);
        bool over = bracket_state(rig.sim.b) == BRACKET_DONE;
        assert_int_equal(bracket_state(rig.sim.b), over ? BRACKET_DONE : BRACKET_FAULT);
        assert_true(over == (frames == 6));
        if (over)
            frames = 8;
        for (int i = 0; i < 4; i++)
            sim_step(&rig.sim);
        assert_true(rig.camera[0].timing.now.time_s == rig.base_s);
        rig_close();
    }
}

static void plan_refused(double time_s, double gain, const char *sentence)
{
    rig.plan[1].ask[2] = (struct exposure){time_s, gain};
    refused(&(struct bracket_event){.kind = BRACKET_BEGIN, .plan = rig.plan}, sentence);
}

static void test_bad_arguments(void **state)
{
    struct bracket *b;
    struct bracket_camera c;
    static const struct exposure_probe w;
    (void)state;
    rig_open(2, 2, 3, 2.0);
    c = rig.cfg[0];
    assert_int_equal(bracket_new(rig.cfg, 0, &b), ERR_ARG);
    assert_int_equal(bracket_new(rig.cfg, 17, &b), ERR_ARG);
    assert_null(b);
    c.delay_hi = 33;
    assert_int_equal(bracket_new(&c, 1, &b), ERR_ARG);
    assert_non_null(strstr(err_text(), "the delay is 2 to 33 frames"));
    c = rig.cfg[0];
    c.period_s = NAN;
    assert_int_equal(bracket_new(&c, 1, &b), ERR_ARG);
    c = rig.cfg[0];
    c.time_min_s = 0.0;
    assert_int_equal(bracket_new(&c, 1, &b), ERR_ARG);
    c = rig.cfg[0];
    c.tolerance = 0.0;
    assert_int_equal(bracket_new(&c, 1, &b), ERR_ARG);
    bracket_free(NULL);
    rig_ready();
    plan_refused(61.0, 1.0, "camera 1: exposure 2 of the plan is 61 s");
    plan_refused(0.0, 1.0, "exposure 2 of the plan is 0 s");
    plan_refused(NAN, 1.0, "exposure 2");
    plan_refused(INFINITY, 1.0, "exposure 2");
    plan_refused(0.01, 0.5, "at gain 0.5");
    plan_refused(0.01, NAN, "exposure 2");
    rig.plan[1].n = 10;
    plan_refused(0.01, 1.0, "the plan has 10 exposures");
    rig.plan[0].n = rig.plan[1].n = 0;
    plan_refused(0.01, 1.0, "no exposure for any camera");
    refused(&(struct bracket_event){.kind = BRACKET_BEGIN}, "with a plan");
    refused(&(struct bracket_event){.kind = BRACKET_FRAME, .probe = &w}, "without a frame");
    refused(&(struct bracket_event){.kind = BRACKET_TICK + 100, .camera = 2}, "of camera 2");
    refused(&(struct bracket_event){.kind = BRACKET_LOST, .camera = -1}, "of camera -1");
    refused(&(struct bracket_event){.kind = BRACKET_ARM, .set = {0.0, 1.0}}, "cannot be armed");
    refused(&(struct bracket_event){.kind = BRACKET_ANSWER, .set = {-1.0, 1.0}}, "no exposure");
    assert_null(bracket_evidence(rig.sim.b, 2, 0));
    assert_null(bracket_evidence(rig.sim.b, 0, 9));
    assert_null(bracket_evidence(rig.sim.b, -1, -1));
    rig_close();
}
/* ---- reasons ---- */

static void assert_fault(enum bracket_reason want, int most)
{
    int camera;
    enum bracket_reason got = bracket_reason(rig.sim.b, &camera);
    struct bracket_progress p;
    bracket_progress(rig.sim.b, &p);
    if (got != want || camera != 0 || p.frames > most)
        fail_msg("\"%s\" of camera %d after %d frames, not \"%s\" within %d", bracket_sentence(got),
                 camera, p.frames, bracket_sentence(want), most);
    assert_int_equal(bracket_state(rig.sim.b), BRACKET_FAULT);
    rig_close();
}

static struct sim_camera *rig_plain(void)
{
    rig_open(1, 2, 3, 2.0);
    rig_ready();
    return &rig.camera[0];
}

static void test_reasons(void **state)
{
    (void)state;
    struct sim_camera *c = rig_plain();
    c->ignore_from = 0; // from base on
    c->ignore_frames = -1;
    rig_shoot();
    assert_fault(BRACKET_INEFFECTIVE, 20);
    c = rig_plain(); // in the middle of the set: then base is ignored as well
    c->ignore_from = 19;
    c->ignore_frames = -1;
    rig_shoot();
    assert_null(bracket_evidence(rig.sim.b, 0, 0)); // what were they compared with?
    assert_fault(BRACKET_INEFFECTIVE, 15);
    c = rig_plain(); // 9 ms instead of 10 and 2.5
    c->quantum_s = 0.0015;
    rig_shoot();
    assert_fault(BRACKET_INEFFECTIVE, 38);
    c = rig_plain(); // on and off again
    c->lamp_at = 18;
    c->lamp_frames = 17;
    c->lamp = 3.0;
    c->lamp_share = 1.0;
    rig_shoot();
    assert_int_equal(c->forgotten, 1 + (bracket_state(rig.sim.b) == BRACKET_FAULT));
    assert_fault(BRACKET_SCENE_CHANGED, 80);
    c = rig_plain(); // out: what is left cannot be compared with anything
    c->lamp_at = 18;
    c->lamp_frames = 10000;
    c->lamp = 1e-9;
    c->lamp_share = 1.0;
    rig_shoot();
    assert_fault(BRACKET_SCENE_CHANGED, 40);
    c = rig_plain();
    c->report = SIM_HALF;
    rig_shoot();
    assert_fault(BRACKET_DISAGREES, 40);
}

static void test_reasons_of_devices(void **state)
{
    (void)state;
    struct sim_camera *c = rig_plain();
    c->digital = 1.006;
    rig_shoot();
    assert_fault(BRACKET_GAINS, 12);
    c = rig_plain();
    c->balance_step = 1.004;
    rig_shoot();
    assert_fault(BRACKET_GAINS, 14);
    c = rig_plain();
    c->error = 1.0;
    rig_shoot();
    assert_fault(BRACKET_BAD_FRAMES, 12);
    c = rig_plain();
    c->refuse = -1;
    c->refuse_with = ERR_UNSUPPORTED;
    rig_shoot();
    assert_fault(BRACKET_REFUSED, 8);
    c = rig_plain();
    c->refuse = 1;
    c->refuse_with = ERR_LOST;
    rig_shoot();
    assert_fault(BRACKET_DEVICE_LOST, 0);
    for (int frames = 0; frames < 5; frames++) { // and in every moment
        rig_plain();
        sim_begin(&rig.sim, rig.plan);
        for (int i = 0; i < frames; i++)
            sim_step(&rig.sim);
        tell(BRACKET_LOST, 0);
        assert_fault(BRACKET_DEVICE_LOST, frames);
    }
    for (int r = 0; r < BRACKET_REASONS; r++) // sentences differ
        for (int k = 0; k < r; k++)
            assert_string_not_equal(bracket_sentence((enum bracket_reason)r),
                                    bracket_sentence((enum bracket_reason)k));
}

/* A picture of another size, as after a change of format. */
static void test_odd_frames(void **state)
{
    static struct exposure_probe w;
    (void)state;
    rig_plain();
    sim_begin(&rig.sim, rig.plan);
    for (uint32_t i = 1; i <= 12; i++) {
        struct frame f = rig.camera[0].shot.f;
        f.sequence += i;
        f.timestamp_ns += i * 33333333;
        f.w /= 2;
        sim_tell(&rig.sim,
                 &(struct bracket_event){.kind = BRACKET_FRAME, .frame = &f, .probe = &w});
    }
    assert_fault(BRACKET_BAD_FRAMES, 12);
    rig_plain();
    sim_begin(&rig.sim, rig.plan);
    for (int i = 0; i < 12; i++)
        tell(BRACKET_UNUSABLE, 0);
    assert_fault(BRACKET_BAD_FRAMES, 12);
    rig_plain(); // now and then it does no harm
    sim_begin(&rig.sim, rig.plan);
    for (int i = 0; bracket_state(rig.sim.b) == BRACKET_SHOOTING; i++) {
        tell(BRACKET_UNUSABLE, 0);
        sim_step(&rig.sim);
    }
    assert_complete(BRACKET_REPORTED);
    rig_close();
}

/* The light changes once: everything again. */
static void test_lamp(void **state)
{
    (void)state;
    for (int part = 0; part < 2; part++)
        for (int at = 14; at < 22; at++) {
            struct sim_camera *c = rig_plain();
            c->lamp_at = at;
            c->lamp_frames = 10000;
            c->lamp = 4.0; // a step of the bracket
            c->lamp_share = part ? 0.5 : 1.0;
            assert_int_equal(rig_shoot(), BRACKET_NONE);
            assert_complete(BRACKET_REPORTED);
            assert_true(c->forgotten <= 1);
            rig_close();
        }
}

/* A flash in the first frame that may be the reference: a second one that looks like it is
 * wanted. */
static void test_flash_in_the_reference(void **state)
{
    (void)state;
    for (int at = 0; at < 24; at++) {
        rig_open(1, 2, 3, 2.0);
        assert_int_equal(bracket_new(rig.cfg, 1, &rig.sim.b), OK);
        rig_arm(1000000000);
        struct sim_camera *c = &rig.camera[0];
        c->lamp_at = at;
        c->lamp_frames = 1;
        c->lamp = 3.0;
        c->lamp_share = 1.0;
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
        assert_true(c->forgotten == 0);
        rig_close();
    }
}

/* Frames that were multiplied are no reference for others that are not. */
static void test_digital_gain_before(void **state)
{
    (void)state;
    struct bracket_progress p;
    rig_open(1, 2, 3, 2.0);
    struct sim_camera *c = &rig.camera[0];
    c->digital = 2.0;
    rig_ready();
    c->digital = 1.0;
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_REPORTED);
    bracket_progress(rig.sim.b, &p);
    assert_true(c->forgotten == 0 && p.rejected == 0);
    rig_close();
}

/* Gains behind raw pixels are not in them: they may be anything and move. */
static void test_gains_behind_raw_pixels(void **state)
{
    (void)state;
    rig_open(1, 2, 3, 2.0);
    rig.camera[0].gains_later = true;
    rig.camera[0].digital = 2.0;
    rig_ready();
    rig.camera[0].balance = 1.3;
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_REPORTED);
    rig_close();
}

static void test_stall(void **state)
{
    struct sim_camera *c;
    struct bracket_progress p;
    (void)state;
    for (int at = 16; at < 22; at++) {
        c = rig_plain();
        c->stall_at = at;
        c->stall_frames = 1000000; // until the restart
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
        assert_int_equal(c->restarted, 1);
        rig_close();
    }
    c = rig_plain();
    c->stall_at = 18;
    c->stall_frames = -1; // for ever
    sim_begin(&rig.sim, rig.plan);
    sim_step(&rig.sim);
    sim_step(&rig.sim);
    int64_t last = rig.sim.now;
    // 3 frames of 40 ms, the longest exposure of the plan, which was asked for by now, and 1 s
    assert_true(llabs(bracket_deadline(rig.sim.b) - last - 1120000000) < 1000);
    tell(BRACKET_TICK, 0); // before its time
    assert_int_equal(c->restarted, 0);
    assert_true(sim_run(&rig.sim, 1000));
    assert_int_equal(c->restarted, 1);
    bracket_progress(rig.sim.b, &p);
    assert_int_equal(p.kept, 1); // base itself
    assert_true(rig.sim.now - last < 2300000000);
    assert_fault(BRACKET_STALLED, 2);
}

/* ---- extremes ---- */

static void test_long(void **state)
{
    (void)state;
    rig_open(1, 2, 0, 0.0);
    for (int i = 0; i < 9; i++)
        rig.plan[0].ask[i] = (struct exposure){60.0 * exp2(-2.8 * (8 - i)), 1.0}; // 10.8 us..60 s
    rig.plan[0].n = 9;
    rig.base_s = rig.plan[0].ask[0].time_s;
    sim_scene(&rig.sim, &rig.camera[0], 24.0, exp2(-12.0), rig.base_s);
    rig_ready();
    sim_begin(&rig.sim, rig.plan);
    int64_t wait = 0;
    while (bracket_state(rig.sim.b) == BRACKET_SHOOTING) {
        int64_t left = bracket_deadline(rig.sim.b) - rig.sim.now;
        wait = left > wait ? left : wait;
        sim_step(&rig.sim);
    }
    assert_complete(BRACKET_REPORTED);
    assert_true(llabs(wait - 181000000000) < 1000000); // 3 x 60 s + 1 s
    assert_true(rig.sim.frames <= 9 + 2 + 2);
    rig_close();
}

/* Nothing to compare: one after the other from rest, and marked. */
static void test_blind(void **state)
{
    struct bracket_progress p;
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        rig_open(1, 2, 3, 2.0);
        sim_scene(&rig.sim, &rig.camera[0], 2.0, kind & 1 ? 1000.0 : 1e-9, rig.base_s);
        rig.camera[0].bright = kind & 1;
        rig.camera[0].report = kind & 2 ? SIM_SILENT : SIM_HONEST;
        rig.cfg[0].reports = !(kind & 2);
        rig_ready();
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_UNVERIFIED_BRIGHT);
        for (int i = 0; i < 3; i++) {
            const struct bracket_evidence *v = bracket_evidence(rig.sim.b, 0, i);
            assert_int_equal(v->proof,
                             kind & 1 ? BRACKET_UNVERIFIED_BRIGHT : BRACKET_UNVERIFIED_DARK);
            assert_true(v->rested && !v->ratio_known && v->frames_since >= 10);
        }
        bracket_progress(rig.sim.b, &p);
        assert_true(p.frames < 80);
        rig_close();
    }
}

/* Base is too dark: what hangs on a frame that nobody could prove is not proven either. */
static void test_hearsay(void **state)
{
    (void)state;
    rig_open(1, 2, 2, 2.0);
    rig.base_s = 1e-5;
    rig_ready();
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_UNVERIFIED_DARK);
    int compared = 0;
    for (int i = 0; i < 2; i++) {
        const struct bracket_evidence *v = bracket_evidence(rig.sim.b, 0, i);
        assert_int_equal(v->proof, BRACKET_UNVERIFIED_DARK);
        compared += v->ratio_known;
    }
    assert_int_equal(compared, 1);
    rig_close();
}

/* A flash for some frames that is exactly a step of the bracket makes frames look like their
 * neighbours; the camera says nothing that could tell. */
static void flash(int claim, int at, int frames, bool up)
{
    static const int lo[] = {3, 0, 2, 0, 5}, hi[] = {3, 8, 4, 0, 5}; // right, none, wide, wrong
    rig_open(1, 3, 4, 2.0);
    struct sim_camera *c = &rig.camera[0];
    c->report = SIM_SILENT;
    rig.cfg[0].reports = false;
    rig.cfg[0].delay_lo = lo[claim];
    rig.cfg[0].delay_hi = hi[claim];
    rig.base_s = rig.plan[0].ask[up ? 0 : 3].time_s;
    c->lamp_at = 16 + at / 2;
    c->lamp_frames = frames;
    c->lamp = up ? 4.0 : 0.25;
    c->lamp_share = 1.0;
    rig_ready();
    rig_shoot();
    for (int i = 0; i < 4; i++) {
        const struct bracket_evidence *v = bracket_evidence(rig.sim.b, 0, i);
        // as long as the set, when nobody knows the delay: nothing in it can tell
        if (v && (claim != 1 || frames != 4))
            assert_true(fabs(log2(c->truth[i] / v->exposure.time_s)) <= TOLERANCE);
    }
    rig_close();
}

static void test_flash(void **state)
{
    (void)state;
    for (int claim = 0; claim < 5; claim++)
        for (int at = 0; at < 80; at++)
            for (int frames = 1; frames <= 5; frames++)
                flash(claim, at, frames, at % 2);
}

/* Frames that waited in buffers since before ARM are no reference, however many. */
static void backlog(bool stamps)
{
    static struct exposure_probe w;
    struct bracket_progress p;
    for (int i = 0; i < EXPOSURE_PROBE_PLACES; i++) {
        w.x[i] = 0.1f;
        w.sd[i] = 0.001f;
        w.floor[i] = 0.01f;
    }
    w.good = EXPOSURE_PROBE_PLACES;
    w.overlap = 1.0f;
    rig_open(1, 2, 1, 0.0);
    assert_int_equal(bracket_new(rig.cfg, 1, &rig.sim.b), OK);
    rig_arm(10000000000);
    for (uint32_t i = 0; i < 32; i++) {
        struct frame f = {.w = 64, .h = 64, .sequence = i};
        f.timestamp_ns = stamps ? 10000000000 - (32 - i) * 33333333 : 0;
        rig.sim.now += 1000000;
        sim_tell(&rig.sim,
                 &(struct bracket_event){.kind = BRACKET_FRAME, .frame = &f, .probe = &w});
    }
    sim_begin(&rig.sim, rig.plan);
    bracket_progress(rig.sim.b, &p);
    assert_true(p.resting && p.kept == 0);
    rig_close();
}

static void test_backlog(void **state)
{
    (void)state;
    backlog(true);
    backlog(false);
}

/* Whoever takes the frames is now and then late by some: still pipelined. */
static void test_late_host(void **state)
{
    (void)state;
    int frames = 0;
    for (int seed = 0; seed < 50; seed++) {
        struct sim_camera *c = rig_plain();
        rig_close();
        c->report = SIM_SILENT;
        c->lag = 0.1;
        c->stamp = rig.cfg[0].stamp = seed % 2 ? CAMERA_STAMP_END : CAMERA_STAMP_START;
        rig_ready();
        rig.sim.random = (uint64_t)seed;
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED + 1);
        assert_true(c->forgotten == 0 || seed % 2); // an end says less than a start
        frames += rig.sim.frames;
        rig_close();
    }
    assert_in_range(frames, 50 * (3 + 2 + 1), 50 * (3 + 2 + 9));
}

static void test_many_cameras(void **state)
{
    (void)state;
    rig_open(16, 3, 3, 2.0);
    rig.plan[5].n = 0; // takes no part
    for (int i = 0; i < 8; i++) {
        rig.plan[i + 8].n = 1; // staggered
        rig.plan[i + 8].ask[0] = rig.plan[0].ask[i % 3];
    }
    for (int i = 0; i < 16; i += 2) {
        rig.camera[i].drop = 0.05;
        rig.camera[i].hide = 0.5;
    }
    rig_ready();
    for (int i = 0; i < 20; i++) {
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
    }
    sim_begin(&rig.sim, rig.plan);
    tell(BRACKET_LOST, 5);
    assert_int_equal(bracket_state(rig.sim.b), BRACKET_SHOOTING);
    tell(BRACKET_LOST, 12);
    int camera;
    assert_int_equal(bracket_reason(rig.sim.b, &camera), BRACKET_DEVICE_LOST);
    assert_int_equal(camera, 12);
    rig_close();
}

/* Clocks far from zero. */
static void test_clock(void **state)
{
    static const int64_t start[] = {-4000000000000000000, -1, 1, 9000000000000000000};
    (void)state;
    for (int i = 0; i < 4; i++) {
        rig_open(1, 2, 3, 2.0);
        assert_int_equal(bracket_new(rig.cfg, 1, &rig.sim.b), OK);
        rig_arm(start[i]);
        for (int k = 0; k < 16; k++)
            sim_step(&rig.sim);
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
        rig_close();
    }
    static const int64_t stamp[] = {INT64_MIN, -1, 0, INT64_MAX};
    for (int i = 0; i < 4; i++) {
        struct sim_camera *c = rig_plain();
        c->stamp_fixed = true;
        c->stamp_value = stamp[i];
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
        rig_close();
    }
}

/* Exposures that repeat, and one that is base. */
static void test_repeats(void **state)
{
    (void)state;
    for (int same = 0; same < 2; same++) {
        rig_open(1, 2, 4, 0.0);
        for (int i = 0; i < 4; i++)
            rig.plan[0].ask[i].time_s = same ? 0.01 : i < 2 ? 0.04 : 0.01;
        rig.cfg[0].delay_lo = 0;
        rig.cfg[0].delay_hi = 8;
        rig_ready();
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_REPORTED);
        assert_true(rig.sim.frames <= 4 + 2 + 2);
        for (int i = 0; i < 4; i++)
            for (int k = 0; k < i; k++)
                assert_true(bracket_evidence(rig.sim.b, 0, i)->sequence !=
                            bracket_evidence(rig.sim.b, 0, k)->sequence);
        rig_close();
    }
}

static int make_noise(void **state)
{
    struct sim s = {.random = 1};
    (void)state;
    sim_make_noise(&s);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_frames_used),
        cmocka_unit_test(test_states),
        cmocka_unit_test(test_cancel),
        cmocka_unit_test(test_bad_arguments),
        cmocka_unit_test(test_reasons),
        cmocka_unit_test(test_reasons_of_devices),
        cmocka_unit_test(test_odd_frames),
        cmocka_unit_test(test_lamp),
        cmocka_unit_test(test_flash_in_the_reference),
        cmocka_unit_test(test_digital_gain_before),
        cmocka_unit_test(test_gains_behind_raw_pixels),
        cmocka_unit_test(test_stall),
        cmocka_unit_test(test_long),
        cmocka_unit_test(test_blind),
        cmocka_unit_test(test_hearsay),
        cmocka_unit_test(test_flash),
        cmocka_unit_test(test_backlog),
        cmocka_unit_test(test_late_host),
        cmocka_unit_test(test_many_cameras),
        cmocka_unit_test(test_clock),
        cmocka_unit_test(test_repeats),
    };
    return cmocka_run_group_tests(tests, make_noise, NULL);
}
