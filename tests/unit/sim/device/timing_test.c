/* Controls take effect in the promised frame, in the order in which they were written; frames
 * follow each other and are as long as their exposure asks for. */
#include "sim/device/timing.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>

#include <cmocka.h>

static const struct timing_cfg usual = {.period_s = 0.04,
                                        .step_s = 1e-4,
                                        .longest_s = 1.0,
                                        .gain_max = 8.0,
                                        .delay = 2,
                                        .gain_delay = 1};

static bool near(double a, double b)
{
    return fabs(a - b) < 1e-9;
}

static void test_delay(void **state)
{
    (void)state;
    for (int delay = 1; delay <= TIMING_DELAY_MAX; delay++) {
        struct timing_cfg c = usual;
        struct timing t;
        c.delay = delay;
        timing_open(&t, &c, 0, 0.01);
        timing_step(&t); // frame 1 runs
        timing_write(&t, 0.02, 4.0);
        for (int i = 1; i < delay + 3; i++) {
            struct timing_frame f = timing_step(&t);
            assert_int_equal(f.number, i);
            assert_true(near(f.time_s, i >= 1 + delay ? 0.02 : 0.01));
            assert_true(near(f.gain, i >= 2 ? 4.0 : 1.0));
        }
    }
}

/* One write in each frame, as brackets do: each frame has the value written `delay` frames ago. */
static void test_pipeline(void **state)
{
    struct timing t;
    (void)state;
    timing_open(&t, &usual, 0, 0.01);
    for (int i = 0; i < 500; i++) {
        timing_write(&t, 0.001 * (i % 30 + 1), 1.0);
        timing_write(&t, 0.001 * (i % 31 + 1), 1.0); // the last one of a frame counts
        struct timing_frame f = timing_step(&t);
        assert_true(i < 2 || near(f.time_s, 0.001 * ((i - 2) % 31 + 1)));
    }
}

/* Late by chance, but never out of order, never early, and in the end the last one. */
static void test_jitter(void **state)
{
    struct timing_cfg c = usual;
    struct timing t;
    int late = 0;
    (void)state;
    c.delay = TIMING_DELAY_MAX;
    c.jitter = TIMING_DELAY_MAX;
    c.longest_s = 1e3;
    c.length = TIMING_FREE;
    c.step_s = 1.0;
    timing_open(&t, &c, 0, 1.0);
    for (int i = 0, last = 1; i < 900; i++) {
        for (int k = 0; k < 9; k++) // more writes than there is room for frames ahead
            timing_write(&t, i + 1.0, 1.0);
        struct timing_frame f = timing_step(&t);
        assert_true(f.time_s >= last && f.time_s <= fmax(i - TIMING_DELAY_MAX + 1, 1));
        late += i > 100 && f.time_s < i - TIMING_DELAY_MAX + 1;
        last = (int)f.time_s;
    }
    assert_true(late > 100);
    for (int i = 0; i < 2 * TIMING_DELAY_MAX; i++)
        timing_step(&t);
    assert_true(near(t.now.time_s, 900.0));
}

static void test_lengths(void **state)
{
    static const double exposure[3] = {0.5, 0.04, 0.5}, length[3] = {0.5, 0.04, 0.04};
    (void)state;
    for (int mode = TIMING_STRETCH; mode <= TIMING_FREE; mode++) {
        struct timing_cfg c = usual;
        struct timing t;
        c.length = (enum timing_length)mode;
        timing_open(&t, &c, 1000, 0.01);
        timing_write(&t, 0.5, 1.0);
        int64_t end = 1000;
        for (int i = 0; i < 4; i++) {
            struct timing_frame f = timing_step(&t);
            assert_true(f.start_ns == end);
            end = f.end_ns;
            assert_true(near((double)(f.end_ns - f.start_ns) * 1e-9, i < 2 ? 0.04 : length[mode]));
            assert_true(near(f.time_s, i < 2 ? 0.01 : exposure[mode]));
        }
        int64_t start = t.now.start_ns, length_ns = t.now.end_ns - start;
        timing_stall(&t, 777);
        assert_true(t.now.start_ns == start + 777 && t.now.end_ns == start + 777 + length_ns);
    }
}

/* A slow clock, starts around its grid, and one frame that is longer. */
static void test_starts(void **state)
{
    struct timing_cfg c = usual;
    struct timing t;
    double most = 0;
    (void)state;
    c.drift = 1e-4;
    c.wobble_s = 1e-4;
    timing_open(&t, &c, 5, 0.01);
    for (int i = 0; i < 200; i++) {
        struct timing_frame f = timing_step(&t);
        double off = (double)(f.start_ns - 5) * 1e-9 - i * 0.04 * (1 + 1e-4) - (i >= 103) * 0.007;
        assert_true(fabs(off) <= 1e-4 + 1e-6 && f.end_ns == t.now.start_ns);
        most = fmax(most, fabs(off));
        if (i == 99) { // frame 100 runs
            assert_true(timing_shift(&t, 7000000));
            assert_true(!timing_shift(&t, 7000000));
        }
    }
    assert_true(most > 5e-5 && timing_shift(&t, 1));
}

static void test_limits(void **state)
{
    struct timing_cfg c = usual;
    (void)state;
    assert_true(near(timing_time(&c, 0.00123), 0.0012)); // down
    assert_true(near(timing_time(&c, 3 * 1e-4), 3e-4));  // not to 2 steps
    assert_true(near(timing_time(&c, 1e-9), 1e-4) && near(timing_time(&c, 1e9), 1.0));
    c.length = TIMING_LIMIT;
    assert_true(near(timing_time(&c, 1.0), 0.04));
    c.length = TIMING_FREE;
    c.step_s = 0.0;
    assert_true(near(timing_time(&c, 0.00123), 0.00123) && near(timing_time(&c, 5.0), 1.0));
    assert_true(near(timing_gain(&c, 0.5), 1.0) && near(timing_gain(&c, 100.0), 8.0));
    for (int i = 1; i < 10000; i++) { // what can be set is kept
        c.step_s = 2e-5;
        double v = timing_time(&c, i * 1e-4 / 3.0);
        assert_true(timing_time(&c, v) == v);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_delay),  cmocka_unit_test(test_pipeline),
        cmocka_unit_test(test_jitter), cmocka_unit_test(test_lengths),
        cmocka_unit_test(test_limits), cmocka_unit_test(test_starts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
