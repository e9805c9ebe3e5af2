/* One list of exposures for what several cameras want. */
#include "firmware/rig/rigplan.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <stdio.h>

static struct config settings(int mode, const char *ev, int middle_us)
{
    struct config c = {.bracket_mode = mode, .bracket_middle_us = middle_us};
    snprintf(c.bracket_ev, sizeof c.bracket_ev, "%s", ev);
    return c;
}

static void expect_times(const struct rigplan *p, int n, const double *ms)
{
    assert_int_equal(p->n, n);
    for (int i = 0; i < n; i++)
        if (!(fabs(log2(p->time_s[i] / (ms[i] * 1e-3))) < 1e-6))
            fail_msg("exposure %d: %g ms instead of %g", i, p->time_s[i] * 1e3, ms[i]);
}

static void metered(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_AUTO, "", 0);
    assert_true(rigplan_is_metered(&c));
    c = settings(CONFIG_LIST, "0", 0);
    assert_true(rigplan_is_metered(&c));
    c = settings(CONFIG_LIST, "0", 1000);
    assert_false(rigplan_is_metered(&c));
}

static void one_camera(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_AUTO, "", 0);
    struct rigplan p;
    const struct message_meter three = {3, {0.001, 0.004, 0.016}}, one = {1, {0.002}};
    expect_ok(rigplan_make(&c, &three, 1, &p));
    expect_times(&p, 3, (double[]){1, 4, 16});
    expect_ok(rigplan_make(&c, &one, 1, &p));
    expect_times(&p, 1, (double[]){2});
    const struct message_meter falls = {3, {0.016, 0.004, 0.001}};
    expect_ok(rigplan_make(&c, &falls, 1, &p));
    expect_times(&p, 3, (double[]){1, 4, 16});
}

static void many_cameras(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_AUTO, "", 0);
    struct message_meter m[64] = {{0}};
    struct rigplan p;
    for (int i = 0; i < 64; i++)
        m[i] = (struct message_meter){1, {0.004}};
    expect_ok(rigplan_make(&c, m, 64, &p)); // all want the same
    expect_times(&p, 1, (double[]){4});
    m[5].time_s[0] = 0.0044; // nearly
    expect_ok(rigplan_make(&c, m, 64, &p));
    expect_times(&p, 1, (double[]){4 * sqrt(1.1)});
    m[5].time_s[0] = 0.064; // 4 stops: one step of RIGPLAN_STEP
    expect_ok(rigplan_make(&c, m, 64, &p));
    expect_times(&p, 2, (double[]){4, 64});
    m[7] = (struct message_meter){2, {0.001, 0.004}}; // steps of two stops are wanted
    m[9] = (struct message_meter){0};                 // this one could not be metered
    expect_ok(rigplan_make(&c, m, 64, &p));
    expect_times(&p, 4, (double[]){1, 4, 16, 64});
    m[7].time_s[1] = 0.001; // twice the same is not a step
    m[7].time_s[0] = 0.001;
    expect_ok(rigplan_make(&c, m, 64, &p));
    expect_times(&p, 3, (double[]){1, 8, 64});
}

/* Many small steps over a wide range become as many as a bracket may have. */
static void at_most_nine(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_AUTO, "", 0);
    const struct message_meter m[] = {{2, {1e-5, 2e-5}}, {1, {10}}},
                               all[] = {{1, {1e-9}}, {1, {1e4}}};
    struct rigplan p;
    expect_ok(rigplan_make(&c, m, 2, &p));
    assert_int_equal(p.n, BRACKET_EXPOSURES_MAX);
    expect_ok(rigplan_make(&c, all, 2, &p));
    assert_int_equal(p.n, BRACKET_EXPOSURES_MAX);
    for (int i = 1; i < p.n; i++)
        assert_true(p.time_s[i] > p.time_s[i - 1]);
    assert_true(p.time_s[0] >= MESSAGE_TIME_MIN_S && p.time_s[8] <= MESSAGE_TIME_MAX_S * 1.000001);
}

static void list(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_LIST, "+2, 0, -2", 4000);
    const struct message_meter m[] = {{2, {0.001, 0.002}}, {1, {0.064}}};
    struct rigplan p;
    expect_ok(rigplan_make(&c, NULL, 0, &p)); // with a middle: nobody is asked
    expect_times(&p, 3, (double[]){1, 4, 16});
    c.bracket_middle_us = 0;
    expect_ok(rigplan_make(&c, m, 2, &p));
    expect_times(&p, 3, (double[]){2, 8, 32});
    c = settings(CONFIG_LIST, "-4 -3 -2 -1 0 1 2 3 4", 16000);
    expect_ok(rigplan_make(&c, NULL, 0, &p));
    expect_times(&p, 9, (double[]){1, 2, 4, 8, 16, 32, 64, 128, 256});
    c = settings(CONFIG_LIST, "-4 -3 -2 -1 0 1 2 3 4 5", 16000);
    expect_err(rigplan_make(&c, NULL, 0, &p), ERR_ARG, "more than 9");
}

/* What an order could not say. */
static void list_within_messages(void **state)
{
    (void)state;
    struct config c = settings(CONFIG_LIST, "-16 16", 1);
    struct rigplan p;
    expect_ok(rigplan_make(&c, NULL, 0, &p));
    assert_true(p.time_s[0] >= MESSAGE_TIME_MIN_S);
    c.bracket_middle_us = 60000000;
    expect_ok(rigplan_make(&c, NULL, 0, &p));
    assert_true(p.time_s[1] <= MESSAGE_TIME_MAX_S && p.time_s[0] < 0.001);
}

static void nobody_is_metered(void **state)
{
    (void)state;
    const struct message_meter m[2] = {{0}};
    struct config c = settings(CONFIG_AUTO, "", 0);
    struct rigplan p;
    expect_err(rigplan_make(&c, m, 2, &p), ERR_ARG, "no camera");
    expect_err(rigplan_make(&c, NULL, 0, &p), ERR_ARG, "no camera");
    c = settings(CONFIG_LIST, "0", 0);
    expect_err(rigplan_make(&c, m, 2, &p), ERR_ARG, "no camera");
    assert_int_equal(p.n, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(metered),
        cmocka_unit_test(one_camera),
        cmocka_unit_test(many_cameras),
        cmocka_unit_test(at_most_nine),
        cmocka_unit_test(list),
        cmocka_unit_test(list_within_messages),
        cmocka_unit_test(nobody_is_metered),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
