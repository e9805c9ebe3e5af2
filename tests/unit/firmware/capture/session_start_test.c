/* Takes that begin at a given time, by simulated cameras of any phase, clock and delay: when the
 * first frame of the plan really began, by the simulator. */
#include "tests/unit/firmware/capture/session_rig.h"
#include "tests/unit/some_of.h"

#include "firmware/capture/session_inner.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

#define SECOND INT64_C(1000000000)
#define PERIOD_NS 33333333.0
#define SIM "sim:kind=room,seed=5,size=28,samples=1,shadow=1,fps=30,clock=virtual"

static struct session *s;
static char uri[3][1024];
static unsigned dice = 1;

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

static double rolled(double lo, double hi)
{
    dice = dice * 1664525u + 1013904223u;
    return lo + (hi - lo) * (dice >> 8) / (double)(1 << 24);
}

static void open_rig(int n, const char *options)
{
    struct session_config c = {.n = n};
    session_close(s);
    for (int i = 0; i < n; i++) {
        char name[16];
        snprintf(name, sizeof name, "truth%d", i);
        remove(tmpdir_path(name));
        snprintf(uri[i], sizeof uri[i], SIM ",views=4,view=%d,truth=%s,skew=%.3f,drift=%.3f,%s", i,
                 tmpdir_path(name), rolled(0, 33333), rolled(-100, 100), options);
        c.uri[i] = uri[i];
    }
    if (session_open(&c, &s) != OK)
        fail_msg("%s", err_text());
    for (int i = 0; i < 500 && !session_settled(s); i++)
        assert_int_equal(rig_turn(s), OK);
}

static struct take *run_take(const struct session_order *o)
{
    struct take *t;
    if (session_begin(s, o) != OK)
        fail_msg("%s", err_text());
    for (int i = 0; i < 5000 && session_state(s) != SESSION_READY; i++)
        assert_int_equal(rig_turn(s), OK);
    assert_int_equal(session_collect(s, &t), OK);
    if (t->status != TAKE_COMPLETE)
        fail_msg("%s: %s", uri[0], t->reason);
    return t;
}

/* A list whose first exposure is the only one of its length, to begin after lo..hi frames. */
static struct session_order order_in(double lo, double hi)
{
    struct session_order o = {.mode = SESSION_LIST, .n = (int)rolled(1, 3.99)};
    double first = rolled(-1, 1);
    o.middle_s = rolled(0.002, 0.008);
    for (int k = 0; k < o.n; k++)
        o.ev[k] = first + k * (dice & 64 ? 1.5 : -1.5);
    o.start_ns = session_machine_now(s) + (int64_t)(rolled(lo, hi) * PERIOD_NS);
    return o;
}

/* The largest error of all cameras, ns; what is recorded is the truth. */
static double start_error(const struct take *t, const struct session_order *o)
{
    double worst = 0;
    int seen = 0;
    for (int i = 0; i < t->n; i++) {
        const struct take_frame *f = &t->frame[i];
        double first_s = o->middle_s * exp2(o->ev[0]);
        struct rig_truth truth = rig_truth(f->camera, f);
        assert_true(truth.found);
        if (llabs(truth.start_ns - f->evidence.start_ns) > 10)
            fail_msg("recorded %lld, true %lld", (long long)f->evidence.start_ns,
                     (long long)truth.start_ns);
        if (fabs(log2(f->evidence.requested.time_s / first_s)) > 0.1)
            continue;
        worst = fmax(worst, fabs((double)(truth.start_ns - o->start_ns)));
        seen++;
    }
    assert_int_equal(seen, t->n_cameras);
    return worst;
}

/* Starts takes with rigs of 1 to 3 cameras. Returns the largest error, ns. */
static double worst_of(int rigs, int takes, double lead, const char *options)
{
    double worst = 0, sum = 0;
    for (int k = 0; k < rigs; k += some_of(7)) {
        char text[256];
        snprintf(text, sizeof text, "delay=%d,stamp=%s,grid=%s,metadata=%s,%s", k % 3 + 1,
                 k % 2 ? "end" : "start", k / 2 % 2 ? "end" : "start",
                 k % 5 == 4 ? "absent" : "correct", options);
        open_rig(k / 6 % 3 + 1, text);
        for (int i = 0; i < takes; i++) {
            struct session_order o = order_in(lead, 1.7 * lead);
            struct take *t = run_take(&o);
            double off = start_error(t, &o);
            worst = fmax(worst, off);
            sum += off;
            take_free(t);
        }
    }
    print_message("%s: %.1f us at most, %.1f us on average\n", options, worst * 1e-3,
                  sum * 1e-3 / (rigs * takes));
    return worst;
}

static void within_half_a_frame(void **state)
{
    (void)state;
    assert_true(worst_of(36, 4, 40, "shift=no") <= 0.5 * PERIOD_NS * 1.0002);
}

/* One take after the other, as soon as the cameras promise: after exposures that fit into a frame
 * they need not look at new frames first. */
static void follows_at_once(void **state)
{
    double worst = 0, lead = 0;
    (void)state;
    for (int k = 0; k < 36; k += some_of(7)) {
        char text[256];
        snprintf(text, sizeof text, "shift=no,delay=%d,stamp=%s,grid=%s,metadata=%s", k % 3 + 1,
                 k % 2 ? "end" : "start", k / 2 % 2 ? "end" : "start",
                 k % 5 == 4 ? "absent" : "correct");
        open_rig(k / 6 % 3 + 1, text);
        for (int i = 0; i < 6; i++) {
            struct session_order o = {
                .mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}, .middle_s = 0.002};
            double lead_s = i ? session_lead_s(s) : 60 * PERIOD_NS * 1e-9;
            o.start_ns = session_machine_now(s) + (int64_t)((lead_s + rolled(0.1, 0.2)) * 1e9);
            struct take *t = run_take(&o);
            worst = fmax(worst, start_error(t, &o));
            lead = i > 1 ? fmax(lead, lead_s) : lead;
            take_free(t);
        }
    }
    print_message("%.1f us at most, %.1f frames ahead\n", worst * 1e-3, lead * 30);
    assert_true(worst <= 0.5 * PERIOD_NS * 1.01);
    assert_true(lead < 12 / 30.0);
}

/* After an exposure that makes frames longer, and where the first exposure is that of waiting. */
static void asks_for_time(void **state)
{
    struct session_order o = {.mode = SESSION_LIST, .n = 2, .ev = {0, 5}, .middle_s = 0.004};
    (void)state;
    open_rig(1, "shift=no,delay=2");
    o.start_ns = session_machine_now(s) + (int64_t)(100 * PERIOD_NS);
    take_free(run_take(&o)); // 128 ms
    assert_true(session_lead_s(s) > 28 / 30.0);
    o.start_ns = session_machine_now(s) + (int64_t)(100 * PERIOD_NS);
    o.ev[1] = 2;
    take_free(run_take(&o));
    assert_true(session_lead_s(s) < 12 / 30.0);
    o.middle_s = s->cam[0].set.time_s; // as it waits now
    o.ev[1] = 1;
    o.start_ns = session_machine_now(s) + (int64_t)((session_lead_s(s) + 0.1) * 1e9);
    take_free(run_take(&o));
    assert_true(session_lead_s(s) > 16 / 30.0 && session_lead_s(s) < 28 / 30.0);
    o.start_ns = session_machine_now(s) + (int64_t)((session_lead_s(s) + 0.1) * 1e9);
    struct take *t = run_take(&o);
    assert_true(start_error(t, &o) <= 0.5 * PERIOD_NS * 1.002);
    take_free(t);
    assert_true(session_lead_s(s) < 12 / 30.0);
}

/* Whether frames can be lengthened is known without an order that leaves time to try it. */
static void little_time(void **state)
{
    (void)state;
    open_rig(1, "shift=no,delay=2");
    for (int i = 0; i < 3; i++) {
        struct session_order o = {
            .mode = SESSION_LIST, .n = 3, .ev = {-2, 0, 2}, .middle_s = 0.002};
        o.start_ns = session_machine_now(s) + (int64_t)(20 * PERIOD_NS);
        take_free(run_take(&o));
    }
    assert_true(session_lead_s(s) < 12 / 30.0);
}

static void aligned(void **state)
{
    (void)state;
    assert_true(worst_of(36, 2, 70, "shift=yes") <= 100e3);
    assert_true(worst_of(6, 2, 70, "shift=yes,line=40") <= 100e3);
}

static void aligned_with_wobble(void **state)
{
    (void)state;
    assert_true(worst_of(12, 2, 140, "shift=yes,wobble=200") <= 400e3);
}

static void begin_in_an_hour(void)
{
    struct session_order o = {.mode = SESSION_LIST, .n = 1, .middle_s = 0.004};
    struct pollfd p[3];
    int64_t deadline, start = o.start_ns = session_machine_now(s) + 3600 * SECOND;
    assert_int_equal(session_begin(s, &o), OK);
    assert_int_equal(session_begin(s, &o), ERR_BUSY);
    for (int i = 0; i < 5; i++)
        assert_int_equal(rig_turn(s), OK);
    assert_int_equal(session_state(s), SESSION_SHOOTING);
    assert_string_equal(session_status(s), "waits for the start");
    assert_int_equal(session_poll(s, p, 3, &deadline), s->n);
    assert_true(deadline < start && deadline > start - SECOND);
}

static void check_aborted(const char *says)
{
    struct take *t;
    assert_int_equal(session_state(s), SESSION_READY);
    assert_int_equal(session_collect(s, &t), OK);
    assert_true(t->status == TAKE_ABORTED && t->n == 0);
    assert_non_null(strstr(t->reason, says));
    take_free(t);
}

static void ends_while_it_waits(void **state)
{
    char options[300];
    (void)state;
    tmpdir_text("node", "");
    snprintf(options, sizeof options, "node=%s", tmpdir_path("node"));
    open_rig(2, options);
    begin_in_an_hour();
    session_cancel(s, "shutdown");
    check_aborted("shutdown");
    begin_in_an_hour();
    unlink(tmpdir_path("node"));
    assert_int_equal(rig_turn(s), OK);
    check_aborted("lost");
}

static void late_and_refused(void **state)
{
    struct session_order o = {.mode = SESSION_LIST, .n = 1, .middle_s = 0.004, .start_ns = 1};
    (void)state;
    open_rig(1, "delay=2");
    int64_t now = session_machine_now(s);
    struct take *t = run_take(&o);
    assert_true(t->frame[0].evidence.start_ns < now + SECOND);
    take_free(t);
    o.middle_s = 0;
    assert_int_equal(session_begin(s, &o), ERR_ARG);
    o.mode = SESSION_AUTO;
    assert_int_equal(session_begin(s, &o), ERR_ARG);
}

/* For a conductor: what members see, and which exposures they take. */
static void meters_and_takes_turns(void **state)
{
    struct session_order meter = {.mode = SESSION_METER}, o = {.mode = SESSION_LIST,
                                                               .n = 3,
                                                               .ev = {-2, 0, 2},
                                                               .middle_s = 0.004,
                                                               .stagger = true};
    (void)state;
    open_rig(2, "delay=2");
    struct take *t = run_take(&meter);
    assert_true(t->metered && t->n == 0);
    assert_true(t->meter[0].n > 0 && t->meter[0].stops > 3 && t->meter[1].stops > 3);
    take_free(t);
    for (o.turn = 0; o.turn < 5; o.turn++) {
        t = run_take(&o);
        assert_int_equal(t->n, 2);
        for (int i = 0; i < 2; i++) {
            double stops = log2(take_exposure_s(&t->frame[i]) / 0.004);
            assert_true(fabs(stops - o.ev[(i + o.turn) % 3]) < 0.05);
        }
        take_free(t);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(follows_at_once, set_up, tear_down),
        cmocka_unit_test_setup_teardown(asks_for_time, set_up, tear_down),
        cmocka_unit_test_setup_teardown(little_time, set_up, tear_down),
        cmocka_unit_test_setup_teardown(within_half_a_frame, set_up, tear_down),
        cmocka_unit_test_setup_teardown(aligned, set_up, tear_down),
        cmocka_unit_test_setup_teardown(aligned_with_wobble, set_up, tear_down),
        cmocka_unit_test_setup_teardown(ends_while_it_waits, set_up, tear_down),
        cmocka_unit_test_setup_teardown(late_and_refused, set_up, tear_down),
        cmocka_unit_test_setup_teardown(meters_and_takes_turns, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
