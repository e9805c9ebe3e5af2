/* Takes with simulated cameras, compared with what the simulator says of every frame. */
#include "tests/unit/firmware/capture/session_rig.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

#define SECOND INT64_C(1000000000)

static struct session *s;
static char uri[4][512];

#define VIRTUAL "clock=virtual" // whatever the machine is doing

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    s = NULL;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    session_close(s);
    tmpdir_remove();
    return 0;
}

static err_t open_rig(int n, const char *options)
{
    struct session_config c = {.n = n};
    for (int i = 0; i < n; i++) {
        snprintf(uri[i], sizeof uri[i],
                 "sim:kind=room,seed=5,size=56,samples=1%s,views=4,view=%d,truth=%s/truth%d%s%s",
                 strstr(options, "fps=") ? "" : ",fps=100", i, tmpdir_root, i, *options ? "," : "",
                 options);
        c.uri[i] = uri[i];
    }
    return session_open(&c, &s);
}

static void turn(void)
{
    assert_int_equal(rig_turn(s), OK);
}

static void run_until(enum session_state state)
{
    int64_t end = clocks_now() + 60 * SECOND; // it hangs
    while (session_state(s) != state && clocks_now() < end)
        turn();
    if (session_state(s) != state)
        fail_msg("never in state %d, but %d: %s", state, session_state(s), session_status(s));
}

static struct take *run_take(const struct session_order *o)
{
    struct take *t;
    if (session_begin(s, o) != OK)
        fail_msg("%s", err_text());
    run_until(SESSION_READY);
    assert_int_equal(session_collect(s, &t), OK);
    return t;
}

static void check_labels(const struct take *t)
{
    for (int i = 0; i < t->n; i++) {
        const struct take_frame *f = &t->frame[i];
        struct rig_truth truth = rig_truth(f->camera, f);
        if (!truth.found || !(fabs(log2(take_exposure_s(f) / truth.exposure_s)) <= t->tolerance))
            fail_msg("camera %d index %d: recorded %g, true %g", f->camera, f->index,
                     take_exposure_s(f), truth.exposure_s);
        const struct camera_info *info = &t->camera[f->camera].info;
        assert_true(f->bytes == (size_t)(info->stride * info->h));
        assert_true(f->start.realtime_ns > f->start.monotonic_ns);
    }
}

static void a_list_of_exposures(void **state)
{
    (void)state;
    struct session_order o = {
        .mode = SESSION_LIST, .n = 3, .ev = {2, -2, 0}, .middle_s = 0.004, .trigger_ns = 5};
    assert_int_equal(open_rig(1, VIRTUAL), OK);
    run_until(SESSION_ARMED);
    for (int i = 0; i < 30; i++) // a reference is at hand
        turn();
    struct take *t = run_take(&o);
    assert_int_equal(t->status, TAKE_COMPLETE);
    assert_int_equal(t->n, 3);
    assert_int_equal(t->trigger.monotonic_ns, 5);
    for (int i = 0; i < 3; i++) { // by rising exposure
        assert_int_equal(t->frame[i].index, i);
        assert_true(fabs(log2(take_exposure_s(&t->frame[i]) / 0.004) - (2 * i - 2)) < 0.05);
    }
    check_labels(t);
    struct bracket_progress p;
    session_progress(s, &p);
    assert_true(p.frames <= 3 + 2 + 2);
    take_free(t);
    t = run_take(&o); // and once more
    assert_int_equal(t->n, 3);
    check_labels(t);
    take_free(t);
}

static void metered_with_two_cameras(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_AUTO, .verify = true};
    assert_int_equal(open_rig(2, VIRTUAL), OK);
    struct take *t = run_take(&o);
    if (t->status != TAKE_COMPLETE)
        fail_msg("%s", t->reason);
    assert_true(t->n >= 2 && t->n <= 2 * BRACKET_EXPOSURES_MAX);
    assert_true(t->metered && t->meter[0].stops > 3 && t->meter[1].stops > 3);
    for (int i = 0; i < 2; i++)
        assert_true(t->meter[i].clipped < 0.02);
    check_labels(t);
    for (int i = 1; i < t->n; i++)
        assert_true(t->frame[i].camera > t->frame[i - 1].camera ||
                    take_exposure_s(&t->frame[i]) > take_exposure_s(&t->frame[i - 1]));
    take_free(t);
}

static void stagger_gives_every_camera_one(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_LIST,
                              .n = 3,
                              .ev = {-2, 0, 2},
                              .middle_s = 0.004,
                              .stagger = true,
                              .turn = -1};
    int seen[3][3] = {{0}};
    assert_int_equal(open_rig(3, VIRTUAL), OK);
    for (int k = 0; k < 3; k++) {
        struct take *t = run_take(&o);
        assert_int_equal(t->n, 3);
        assert_true(t->stagger);
        check_labels(t);
        for (int i = 0; i < 3; i++) {
            int level = (int)lround(log2(take_exposure_s(&t->frame[i]) / 0.004) / 2) + 1;
            assert_int_equal(t->frame[i].camera, i);
            seen[i][level]++;
        }
        take_free(t);
    }
    for (int i = 0; i < 9; i++) // every camera every exposure once
        assert_int_equal(seen[i / 3][i % 3], 1);
}

static void lost_in_the_middle_and_found_again(void **state)
{
    (void)state;
    char options[300];
    struct session_order o = {
        .mode = SESSION_LIST, .n = 9, .middle_s = 0.2, .ev = {0, 1, 0, 1, 0, 1, 0, 1, 0}};
    struct take *t;
    tmpdir_text("node", "");
    snprintf(options, sizeof options, "node=%s", tmpdir_path("node"));
    assert_int_equal(open_rig(2, options), OK);
    assert_int_equal(session_begin(s, &o), OK);
    assert_int_equal(session_begin(s, &o), ERR_BUSY);
    for (int i = 0; i < 20; i++)
        turn();
    unlink(tmpdir_path("node"));
    run_until(SESSION_READY);
    assert_int_equal(session_collect(s, &t), OK);
    assert_int_equal(t->status, TAKE_ABORTED);
    assert_non_null(strstr(t->reason, "unplugged"));
    check_labels(t);
    take_free(t);
    run_until(SESSION_LOST);
    assert_int_equal(session_begin(s, &o), ERR_LOST);
    tmpdir_text("node", "");
    run_until(SESSION_ARMED);
    struct session_order quick = {.mode = SESSION_LIST, .n = 2, .ev = {-2, 0}, .middle_s = 0.004};
    t = run_take(&quick);
    assert_int_equal(t->status, TAKE_COMPLETE);
    take_free(t);
}

static void cancelled(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_LIST, .n = 2, .middle_s = 1, .ev = {0, 1}};
    struct take *t;
    assert_int_equal(open_rig(1, ""), OK);
    session_cancel(s, "nothing runs");
    assert_int_equal(session_state(s), SESSION_ARMED);
    assert_int_equal(session_begin(s, &o), OK);
    turn();
    session_cancel(s, "shutdown");
    assert_int_equal(session_state(s), SESSION_READY);
    assert_int_equal(session_collect(s, &t), OK);
    assert_int_equal(t->status, TAKE_ABORTED);
    assert_string_equal(t->reason, "shutdown");
    take_free(t);
    assert_int_equal(session_collect(s, &t), ERR_AGAIN);
}

static void lies_are_not_believed(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}, .middle_s = 0.004};
    assert_int_equal(open_rig(1, VIRTUAL ",metadata=late,faults=at frame 60 lose 0.2"), OK);
    for (int k = 0; k < 4; k++) {
        struct take *t = run_take(&o);
        check_labels(t);
        take_free(t);
    }
    session_close(s);
    assert_int_equal(open_rig(1, VIRTUAL ",readback=lagged,first=500"), OK);
    struct take *lagged = run_take(&o);
    if (lagged->status != TAKE_COMPLETE)
        fail_msg("%s", lagged->reason);
    check_labels(lagged);
    take_free(lagged);
    session_close(s);
    assert_int_equal(
        open_rig(1, VIRTUAL ",readback=cached,metadata=absent,faults=at frame 10 ignore 0"), OK);
    for (int i = 0; i < 30; i++)
        turn();
    struct take *t = run_take(&o);
    assert_int_equal(t->status, TAKE_ABORTED);
    check_labels(t);
    take_free(t);
}

/* Half of the light comes and goes with the mains, also in step with the frames. */
static void lamps_that_flicker(void **state)
{
    static const struct {
        const char *options;
        double hz;
    } rigs[] = {
        {"fps=30,hz=100", 100}, {"fps=25,hz=100,stamp=end", 100}, {"fps=30,hz=120,line=20", 120}};
    (void)state;
    for (int k = 0; k < 6; k++) {
        char options[128];
        struct session_order o = {.mode = SESSION_AUTO, .verify = true};
        if (k % 2)
            o = (struct session_order){
                .mode = SESSION_LIST, .n = 3, .ev = {-4, 0, 4}, .middle_s = 0.004};
        snprintf(options, sizeof options, VIRTUAL ",flicker=0.5,%s", rigs[k / 2].options);
        assert_int_equal(open_rig(1, options), OK);
        struct take *t = run_take(&o);
        if (t->status != TAKE_COMPLETE)
            fail_msg("%s: %s", options, t->reason);
        const struct flicker_light *l = &t->camera[0].light;
        print_message("%s: %.0f Hz, %.2f\n", options, l->hz, l->depth);
        assert_true(k > 3 || l->hz > 0); // then it may not have mattered
        assert_true(l->hz == 0 || (l->hz == rigs[k / 2].hz && fabs(l->depth - 0.5) < 0.15));
        check_labels(t);
        for (int i = 0; i < t->n; i++) { // in whole periods where the light allows
            double periods = take_exposure_s(&t->frame[i]) * rigs[k / 2].hz;
            bool proven = t->frame[i].evidence.proof < BRACKET_UNVERIFIED;
            assert_true(periods < 0.8 || fabs(periods - floor(periods + 0.5)) < 0.05 || l->hz == 0);
            assert_true(!proven || periods > 0.8 || l->hz == 0);
        }
        take_free(t);
        session_close(s);
        s = NULL;
    }
}

/* Rows that a rolling shutter reads as the lamp goes on and off look torn. */
static void rows_under_lamps(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_LIST, .n = 3, .ev = {-3, 0, 3}, .middle_s = 0.002};
    struct session_config c = {.n = 1, .uri = {uri[0]}};
    snprintf(uri[0], sizeof uri[0],
             "sim:kind=room,seed=5,size=56,samples=1,shadow=1,fps=30,flicker=0.9,hz=100,line=100,"
             "truth=%s/truth0," VIRTUAL,
             tmpdir_root);
    assert_int_equal(session_open(&c, &s), OK);
    for (int i = 0; i < 200 && !session_settled(s); i++)
        turn();
    struct take *t = run_take(&o);
    if (t->status != TAKE_COMPLETE)
        fail_msg("%s", t->reason);
    assert_true(t->camera[0].light.hz == 100);
    check_labels(t);
    take_free(t);
}

/* Rooms whose exposures are long: few patches are bright at those that show the flicker, and long
 * ones are never still. */
static void dim_rooms_under_lamps(void **state)
{
    static const int seeds[] = {3, 6, 7, 8};
    (void)state;
    for (int k = 0; k < 4; k++) {
        struct session_order o = {.mode = SESSION_AUTO, .verify = true};
        if (k % 2)
            o = (struct session_order){
                .mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}, .middle_s = 0.016};
        struct session_config c = {.n = 1, .uri = {uri[0]}};
        snprintf(uri[0], sizeof uri[0],
                 "sim:kind=room,seed=%d,size=112,samples=1,shadow=1,format=rggb,fps=30,"
                 "flicker=%.1f,hz=%d,truth=%s/truth0," VIRTUAL,
                 seeds[k], k % 2 ? 0.5 : 0.3, k == 3 ? 120 : 100, tmpdir_root);
        assert_int_equal(session_open(&c, &s), OK);
        run_until(SESSION_ARMED);
        struct take *t = run_take(&o);
        if (t->status != TAKE_COMPLETE)
            fail_msg("%s: %s", uri[0], t->reason);
        const struct flicker_light *l = &t->camera[0].light;
        assert_true(l->hz == (k == 3 ? 120 : 100));
        check_labels(t);
        for (int i = 0; i < t->n; i++) { // the reference is steady, too
            bool proven = t->frame[i].evidence.proof < BRACKET_UNVERIFIED;
            double off = flicker_stops(l, take_exposure_s(&t->frame[i]));
            assert_true(proven == (off <= t->tolerance));
        }
        take_free(t);
        session_close(s);
        s = NULL;
    }
}

/* Each trouble has its own sentence. */
static void the_reason_is_said(void **state)
{
    static const struct {
        const char *options, *says;
    } troubles[] = {
        {"faults=at frame 0 ignore 0", "pictures do not show it"},
        {"faults=at frame 13 lose 0.7;at frame 18 ignore 0", "this machine is too slow"},
        {"faults=at frame 13 lose 0.7;at frame 16 refuse busy 0", "refuses the exposure"},
        {"faults=at frame 0 ignore 0;at frame 60 stall 0", "pictures do not show it"},
        {"flicker=0.5,fps=30,faults=at frame 120 ignore 0", "flickers at 100 Hz"},
    };
    (void)state;
    for (size_t k = 0; k < sizeof troubles / sizeof troubles[0]; k++) {
        char options[128];
        struct session_order o = {.mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}};
        o.middle_s = 0.004;
        snprintf(options, sizeof options, VIRTUAL ",%s", troubles[k].options);
        assert_int_equal(open_rig(1, options), OK);
        struct take *t = run_take(&o);
        print_message("%s: %s\n", options, t->reason);
        assert_non_null(strstr(t->reason, troubles[k].says));
        take_free(t);
        session_close(s);
        s = NULL;
    }
}

static void what_cannot_be_opened(void **state)
{
    (void)state;
    struct session_config c = {.n = 1, .uri = {"v4l2:/dev/nowhere"}};
    assert_int_equal(session_open(&c, &s), ERR_LOST);
    assert_null(s);
    c.uri[0] = "camera";
    assert_int_equal(session_open(&c, &s), ERR_ARG);
    assert_non_null(strstr(err_text(), "v4l2:"));
    c.n = 17;
    assert_int_equal(session_open(&c, &s), ERR_ARG);
    assert_int_equal(open_rig(1, ""), OK);
    struct session_order o = {.mode = SESSION_LIST, .n = 10, .middle_s = 1};
    assert_int_equal(session_begin(s, &o), ERR_ARG);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(a_list_of_exposures, set_up, tear_down),
        cmocka_unit_test_setup_teardown(metered_with_two_cameras, set_up, tear_down),
        cmocka_unit_test_setup_teardown(stagger_gives_every_camera_one, set_up, tear_down),
        cmocka_unit_test_setup_teardown(lost_in_the_middle_and_found_again, set_up, tear_down),
        cmocka_unit_test_setup_teardown(cancelled, set_up, tear_down),
        cmocka_unit_test_setup_teardown(lies_are_not_believed, set_up, tear_down),
        cmocka_unit_test_setup_teardown(lamps_that_flicker, set_up, tear_down),
        cmocka_unit_test_setup_teardown(rows_under_lamps, set_up, tear_down),
        cmocka_unit_test_setup_teardown(dim_rooms_under_lamps, set_up, tear_down),
        cmocka_unit_test_setup_teardown(the_reason_is_said, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_cannot_be_opened, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
