/* The bracket machine with exposures, light, delays, clocks and numbers of cameras that are out of
 * the ordinary. */
#include "tests/unit/firmware/capture/bracket_rig.h"

static void test_long(void **state)
{
    (void)state;
    rig_open(1, 2, 0, 0.0);
    for (int i = 0; i < 9; i++)
        rig.plan[0].requested[i] =
            (struct exposure){60.0 * exp2(-2.8 * (8 - i)), 1.0}; // 10.8 us..60 s
    rig.plan[0].n = 9;
    rig.base_s = rig.plan[0].requested[0].time_s;
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
    rig.base_s = rig.plan[0].requested[up ? 0 : 3].time_s;
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
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        w.x[i] = 0.1f;
        w.sd[i] = 0.001f;
        w.floor[i] = 0.01f;
    }
    w.good = EXPOSURE_PROBE_PATCHES;
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
        rig.plan[i + 8].requested[0] = rig.plan[0].requested[i % 3];
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
            rig.plan[0].requested[i].time_s = same ? 0.01 : i < 2 ? 0.04 : 0.01;
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
        cmocka_unit_test(test_long),         cmocka_unit_test(test_blind),
        cmocka_unit_test(test_hearsay),      cmocka_unit_test(test_flash),
        cmocka_unit_test(test_backlog),      cmocka_unit_test(test_late_host),
        cmocka_unit_test(test_many_cameras), cmocka_unit_test(test_clock),
        cmocka_unit_test(test_repeats),
    };
    return cmocka_run_group_tests(tests, make_noise, NULL);
}
