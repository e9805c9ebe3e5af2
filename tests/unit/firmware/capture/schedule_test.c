/* Which exposures a camera is asked for. */
#include "firmware/capture/schedule.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static const struct camera_info device = {.time_min_s = 1e-4, .time_max_s = 0.1};
static const struct meter_result metered = {
    .n = 3, .time_s = {0.001, 0.008, 0.064}, .probe = {0, -1, 1}};

static void expect(const struct bracket_plan *p, int n, const double *times)
{
    assert_int_equal(p->n, n);
    for (int i = 0; i < n; i++) {
        assert_true(fabs(p->requested[i].time_s - times[i]) < 1e-9);
        assert_true(p->requested[i].gain == 1);
    }
}

static void a_list_around_its_middle(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_LIST, .n = 3, .ev = {0, -3, 2}, .middle_s = 0.004};
    struct bracket_plan p;
    struct frame_buffer roll = {0};
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 3, (double[]){0.004, 0.0005, 0.016});
    assert_false(schedule_is_metered(&o));
    assert_int_equal(schedule_frames(&o), 3);
    o.ev[1] = -9; // beyond the device
    o.ev[2] = 9;
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 3, (double[]){0.004, 0.0001, 0.1});
    o.middle_s = 0; // the middle of what the meter says
    assert_true(schedule_is_metered(&o));
    o.ev[1] = o.ev[2] = 1;
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 3, (double[]){0.008, 0.016, 0.016});
}

static void proven_probes_are_not_taken_again(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_AUTO};
    struct bracket_plan p;
    struct frame_buffer roll = {.n = 2};
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 1, (double[]){0.008});
    assert_true(roll.kept[0].used && roll.kept[1].used);
    memset(&roll, 0, sizeof roll);
    roll.n = 2;
    roll.kept[1].frame.evidence.proof = BRACKET_UNVERIFIED_DARK;
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 2, (double[]){0.008, 0.064});
    assert_true(roll.kept[0].used && !roll.kept[1].used);
    roll.n = 0; // the meter speaks of probes that are gone
    schedule_shots(&o, 0, &device, &metered, &roll, &p);
    expect(&p, 3, metered.time_s);
}

static void stagger_goes_round(void **state)
{
    (void)state;
    struct session_order o = {.mode = SESSION_AUTO, .stagger = true};
    struct bracket_plan p;
    struct frame_buffer roll = {.n = 2};
    assert_int_equal(schedule_frames(&o), 1);
    for (int turn = 0; turn < 7; turn++) {
        schedule_shots(&o, turn, &device, &metered, &roll, &p);
        expect(&p, 1, &metered.time_s[turn % 3]);
        assert_false(roll.kept[0].used);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_list_around_its_middle),
        cmocka_unit_test(proven_probes_are_not_taken_again),
        cmocka_unit_test(stagger_goes_round),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
