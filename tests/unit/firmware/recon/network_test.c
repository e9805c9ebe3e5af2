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

static void wait_ms(int ms)
{
    nanosleep(&(struct timespec){0, ms * 1000000L}, NULL);
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
    timed = network_timed(&r, &c);
    wait_ms(40);
    timed.progress(timed.progress_ctx, "a", 1, 2, NULL); // says when it has done something
    wait_ms(20);
    timed.progress(timed.progress_ctx, "a", 2, 2, NULL);
    timed.progress(timed.progress_ctx, "b", 0, 1, NULL); // says that it begins
    wait_ms(30);
    timed.progress(timed.progress_ctx, "c", 0, 1, NULL);
    wait_ms(10);
    timed.progress(timed.progress_ctx, "b", 1, 2, NULL);
    wait_ms(50);
    network_clock_stop(&c);
    assert_int_equal(steps_heard, 5);
    assert_true(seconds(&c, "a") >= 0.06 && seconds(&c, "a") < 0.1);
    assert_true(seconds(&c, "b") >= 0.09 && seconds(&c, "b") < 0.13);
    assert_true(seconds(&c, "c") < 0.03);
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
