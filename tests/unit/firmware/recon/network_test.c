/* Times of a network in a job, and cameras alone; the network itself is tested against golden
 * data. */
#include "firmware/base/engine.h"
#include "firmware/recon/network.h"
#include "tests/unit/small_model.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cmocka.h>

/* ---- times ---- */

static int steps_heard;

static void hear(void *ctx, const char *stage, int done, int total, const char *note)
{
    (void)stage, (void)done, (void)total, (void)note;
    assert_ptr_equal(ctx, &steps_heard);
    steps_heard++;
}

/* Steps, and the clock before and after each: however late the machine is, times are between. */
enum { TIMED = 6 };
static double before[TIMED + 1], after[TIMED + 1];

static void wait_ms(int ms)
{
    nanosleep(&(struct timespec){0, ms * 1000000L}, NULL);
}

static void timed_step_after(int ms, int i, const struct run *r, const char *stage, int done)
{
    wait_ms(ms);
    before[i] = engine_seconds();
    r->progress(r->progress_ctx, stage, done, 2, NULL);
    after[i] = engine_seconds();
}

static void assert_between_steps(double seconds, const int (*span)[2], int n)
{
    double least = 0, most = 0;
    for (int k = 0; k < n; k++) {
        least += before[span[k][1]] - after[span[k][0]];
        most += after[span[k][1]] - before[span[k][0]];
    }
    assert_true(seconds >= least && seconds <= most);
}

static double seconds(const struct network_clock *c, const char *name)
{
    return network_seconds(c, (const char *const[]){name, NULL});
}

static void time_belongs_to_the_stage_that_passed_it(void **state)
{
    (void)state;
    struct network_clock c;
    struct run r = {.progress = hear, .progress_ctx = &steps_heard}, timed;
    before[0] = engine_seconds();
    timed = network_timed(&r, &c);
    after[0] = engine_seconds();
    timed_step_after(40, 1, &timed, "a", 1); // says when it has done something
    timed_step_after(20, 2, &timed, "a", 2);
    timed_step_after(0, 3, &timed, "b", 0); // says that it begins
    timed_step_after(30, 4, &timed, "c", 0);
    timed_step_after(10, 5, &timed, "b", 1);
    wait_ms(50);
    before[6] = engine_seconds();
    network_clock_stop(&c);
    after[6] = engine_seconds();
    assert_int_equal(steps_heard, 5);
    assert_between_steps(seconds(&c, "a"), (const int[][2]){{0, 3}}, 1);
    assert_between_steps(seconds(&c, "b"), (const int[][2]){{3, 4}, {4, 6}}, 2);
    assert_float_equal(seconds(&c, "c"), 0, 1e-9);
    assert_true(network_seconds(&c, (const char *const[]){"a", "b", NULL}) >= 0.15);
    assert_float_equal(seconds(&c, "d"), 0, 0);
}

/* ---- cameras alone ---- */

static void correspondences_are_sought_if_asked(void **state)
{
    (void)state;
    static struct small_model m;
    static struct engine en;
    static uint8_t rgb[2 * 3 * 42 * 42];
    struct network n = {0};
    struct prediction p;
    const struct views v = {.n = 2,
                            .size = 42,
                            .extent = squares(2, 42),
                            .rgb = rgb,
                            .log2t = (float[2]){0, 0},
                            .names = (char[2][NAME_CAP]){""}};
    for (size_t i = 0; i < sizeof rgb; i++)
        rgb[i] = (uint8_t)(i * 37 % 251);
    small_model_init(&m, &small_model_tiny, PRECISION_F32);
    assert_int_equal(net_bind(&m.model, 0, &n.net), OK);
    assert_int_equal(engine_open(&en, 1), OK);
    struct plan plan = plan_begin(1);
    network_look_plan(&plan, &n, true, &v);
    assert_int_equal(engine_reserve(&en, 0, 2 * plan.keep.peak, plan.tmp.peak, 1000), OK);
    for (int attend = 0; attend < 2; attend++) {
        assert_int_equal(network_look(&en.run, &n, attend, &v, &p), OK);
        assert_true(!p.matches.token == !attend);
        assert_non_null(p.geom.cams);
    }
    engine_close(&en);
    small_model_free(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(time_belongs_to_the_stage_that_passed_it),
        cmocka_unit_test(correspondences_are_sought_if_asked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
