/* The bracket machine: every transition and every reason, what it costs, and the extremes.
 * (Random sets against the truth: bracket_random_test.c.) */
#include "tests/unit/firmware/capture/bracket_rig.h"

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

/* A complete set leaves its reference for the next one, if the camera waits as before; any other
 * exposure, a fault and a camera that was lost do not. */
static void test_reference_is_kept(void **state)
{
    (void)state;
    rig_open(1, 2, 3, 2.0);
    rig_ready();
    struct bracket_event arm = {.kind = BRACKET_ARM, .set = {rig.base_s, 1.0}, .same = true};
    assert_true(bracket_settled(rig.sim.b, 0));
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    sim_tell(&rig.sim, &arm);
    assert_true(bracket_settled(rig.sim.b, 0));
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_REPORTED);
    assert_int_equal(rig.sim.frames, rig.plan[0].n + 2 + 1); // at once
    arm.same = false;
    sim_tell(&rig.sim, &arm);
    assert_false(bracket_settled(rig.sim.b, 0));
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    arm.same = true;
    arm.set.time_s *= 0.9;
    sim_tell(&rig.sim, &arm);
    assert_false(bracket_settled(rig.sim.b, 0));
    arm.set.time_s = rig.base_s;
    sim_tell(&rig.sim, &arm);
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    tell(BRACKET_LOST, 0);
    sim_tell(&rig.sim, &arm);
    assert_false(bracket_settled(rig.sim.b, 0));
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
    rig.plan[1].requested[2] = (struct exposure){time_s, gain};
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
    while (bracket_state(rig.sim.b) == BRACKET_SHOOTING) {
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

/* Frames from rest, torn where their exposure begins: one is kept when the one before was the same,
 * also where exposures differ by little. */
static void test_torn_from_rest(void **state)
{
    (void)state;
    for (int seed = 0; seed < 20; seed++) {
        rig_open(1, 3, 3, 0.15);
        struct sim_camera *c = &rig.camera[0];
        c->report = SIM_SILENT;
        rig.cfg[0].reports = false;
        rig.cfg[0].delay_lo = 2;
        rig.base_s *= 1.11; // half a step, and not in the plan
        rig_ready();
        rig.sim.random = (uint64_t)seed;
        c->tear = 0.5;
        assert_int_equal(rig_shoot(), BRACKET_NONE);
        assert_complete(BRACKET_PIXELS);
        for (int i = 0; i < 3; i++)
            assert_true(bracket_evidence(rig.sim.b, 0, i)->rested);
        rig_close();
    }
}

/* A flash in the first frame that may be the reference: a second one that looks like it is wanted,
 * also if the trigger or a stall comes between them. */
static void flash_in_the_reference(int at, int waited, bool stall)
{
    rig_open(1, 2, 3, 2.0);
    assert_int_equal(bracket_new(rig.cfg, 1, &rig.sim.b), OK);
    rig_arm(1000000000);
    struct sim_camera *c = &rig.camera[0];
    c->lamp_at = at;
    c->lamp_frames = 1;
    c->lamp = 3.0;
    c->lamp_share = 1.0;
    if (stall) {
        c->stall_at = at + 1;
        c->stall_frames = 1000000; // until the restart
    }
    for (int i = 0; i < waited; i++)
        sim_step(&rig.sim);
    assert_int_equal(rig_shoot(), BRACKET_NONE);
    assert_complete(BRACKET_REPORTED);
    assert_true(c->forgotten == 0 && c->restarted == stall);
    rig_close();
}

static void test_flash_in_the_reference(void **state)
{
    (void)state;
    for (int at = 0; at < 24; at++)
        flash_in_the_reference(at, 0, false);
    for (int at = 0; at < 16; at++) {
        flash_in_the_reference(at, at + 1, false);
        flash_in_the_reference(at, 0, at < 14);
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
        cmocka_unit_test(test_reference_is_kept),
        cmocka_unit_test(test_cancel),
        cmocka_unit_test(test_bad_arguments),
        cmocka_unit_test(test_reasons),
        cmocka_unit_test(test_reasons_of_devices),
        cmocka_unit_test(test_odd_frames),
        cmocka_unit_test(test_lamp),
        cmocka_unit_test(test_torn_from_rest),
        cmocka_unit_test(test_flash_in_the_reference),
        cmocka_unit_test(test_digital_gain_before),
        cmocka_unit_test(test_gains_behind_raw_pixels),
        cmocka_unit_test(test_stall),
    };
    return cmocka_run_group_tests(tests, make_noise, NULL);
}
