/* One frame at a time: what it may be by requests, pixels and report (firmware/capture/label.h).
 * What a label does in a whole bracket is in bracket_test.c. */
#include "firmware/capture/label.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define PERIOD_S 0.01
#define BASE_S 0.004

static struct label l;
static struct frame f;
static struct exposure_probe w;
static int64_t now;
static bool linear;
static double light = 10.0; // a few patches clip at BASE_S; below 7 none

static void open_label(int delay_lo, int delay_hi, double tolerance)
{
    struct bracket_camera cfg = {.period_s = PERIOD_S,
                                 .time_min_s = 1e-6,
                                 .time_max_s = 1.0,
                                 .delay_lo = delay_lo,
                                 .delay_hi = delay_hi,
                                 .tolerance = tolerance};
    now = 1000000000;
    memset(&f, 0, sizeof f);
    label_init(&l, &cfg);
    label_restart(&l, &(struct exposure){BASE_S, 1.0}, now);
}

static void request_exposure(int index, double time_s)
{
    struct exposure e = {time_s, 1.0};
    label_asked(&l,
                &(struct label_request){
                    .index = index, .requested = e, .set = e, .asked_ns = now, .answered_ns = now});
}

/* A scene of ten stops, without noise. */
static void see(double time_s)
{
    memset(&w, 0, sizeof w);
    w.linear = linear;
    w.overlap = 1.0f;
    w.step = 1.0f / 65536;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        float x = (float)(time_s * light * exp2(10.0 * i / EXPOSURE_PROBE_PATCHES - 5.0));
        w.x[i] = fminf(x, 1.0f);
        w.sd[i] = 0.01f * w.x[i];
        w.floor[i] = 0.002f;
        w.state[i] = x >= 1.0f    ? EXPOSURE_PROBE_CLIPPED
                     : x < 0.002f ? EXPOSURE_PROBE_DARK
                                  : EXPOSURE_PROBE_GOOD;
        w.good += w.state[i] == EXPOSURE_PROBE_GOOD;
        w.clipped += w.state[i] == EXPOSURE_PROBE_CLIPPED;
        w.dark += w.state[i] == EXPOSURE_PROBE_DARK;
    }
}

/* The first rows are of another exposure. */
static void tear(int rows, double time_s)
{
    static struct exposure_probe whole;
    size_t n = (size_t)(rows * EXPOSURE_PROBE_EDGE);
    whole = w;
    see(time_s);
    memcpy(whole.x, w.x, n * sizeof *w.x);
    memcpy(whole.sd, w.sd, n * sizeof *w.sd);
    memcpy(whole.state, w.state, n);
    w = whole;
}

/* The next frame, a period later. */
static void frame(double time_s)
{
    now += (int64_t)(PERIOD_S * 1e9);
    f.sequence++;
    f.timestamp_ns = now;
    label_advance(&l, &f, now);
    see(time_s);
}

static void settle(void)
{
    bool same;
    for (int i = 0; i < 12; i++)
        frame(BASE_S);
    assert_int_equal(label_settle(&l, &f, &w, &same), OK);
}

static enum label_verdict look(struct label_look *k)
{
    label_look(&l, &f, &w, k);
    return k->verdict;
}

static bool whole(struct label_look *k)
{
    label_whole(&l, &w, k);
    return k->whole;
}

/* Two exposures may be in force, and are so near to each other that the pixels fit both. */
static void test_rivals(void **state)
{
    struct label_look k;
    (void)state;
    open_label(1, 2, 0.30);
    settle();
    request_exposure(0, BASE_S * exp2(2.0));
    frame(BASE_S);
    request_exposure(1, BASE_S * exp2(2.2));
    frame(BASE_S * exp2(2.0)); // the first, or none yet
    assert_int_equal(look(&k), LABEL_PROVEN);
    frame(BASE_S * exp2(2.2)); // the second, or the first for one frame more
    assert_int_equal(look(&k), LABEL_UNDECIDED);
    frame(BASE_S * exp2(2.2));
    assert_int_equal(look(&k), LABEL_PROVEN);
    assert_int_equal(l.log[k.entry].index, 1);
}

/* Where neither sequence nor stamp count, a frame may have been lost before each. */
static void test_hidden_frames(void **state)
{
    const struct label_request *r;
    (void)state;
    for (int told = 0; told < 3; told++) { // nothing, sequence, stamp
        open_label(2, 2, 0.10);
        settle();
        request_exposure(0, 0.001);
        for (int i = 0; i < 3; i++) {
            now += (int64_t)(PERIOD_S * 1e9);
            f.sequence += told == 1;
            f.timestamp_ns = told == 2 ? now : 0;
            label_advance(&l, &f, now);
        }
        r = label_newest(&l);
        assert_int_equal(r->age_lo, 2);
        assert_int_equal(r->age_hi, told == 0 ? 5 : told == 1 ? 2 : r->age_hi);
        assert_true(told != 2 || r->age_hi <= 3); // the first stamp after none at all
    }
}

/* Gain is part of an exposure. */
static void test_reported_gain(void **state)
{
    struct label_look k;
    bool same;
    (void)state;
    open_label(1, 1, 0.10);
    settle();
    request_exposure(0, 0.001);
    for (int i = 0; i < 3; i++)
        frame(0.001);
    f.exposure_known = true;
    f.exposure = (struct exposure){0.001, 1.0};
    assert_int_equal(look(&k), LABEL_PROVEN);
    f.exposure.gain = 2.0;
    assert_int_equal(look(&k), LABEL_CONFLICT);
    assert_true(k.disagrees);
    f.exposure = (struct exposure){0.001, 1.5};
    assert_int_equal(label_settle(&l, &f, &w, &same), ERR_AGAIN);
}

/* `of` patches in `all` were good before, and are now so dark that it cannot be. */
static void darken(int of, int all)
{
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        if (i % all < of && w.state[i] == EXPOSURE_PROBE_GOOD && w.x[i] > 0.05f) {
            w.state[i] = EXPOSURE_PROBE_DARK;
            w.floor[i] = 0.01f;
            w.x[i] = 0.005f;
        }
}

/* What dark and clipped patches allow binds where few patches have a ratio. */
static void test_bounds(void **state)
{
    struct label_look k;
    (void)state;
    open_label(1, 1, 0.10);
    settle();
    request_exposure(0, 0.008);
    for (int i = 0; i < 3; i++)
        frame(0.008);
    assert_int_equal(look(&k), LABEL_PROVEN);
    assert_true(k.lo < k.stops && k.hi > k.stops);
    darken(1, 4); // somebody stands there
    assert_int_equal(look(&k), LABEL_PROVEN);
    darken(11, 12);
    assert_int_equal(look(&k), LABEL_CONFLICT);
}

/* Rows of the frame before: where the pixels fit the exposure, but do not rule them out, the frame
 * is not whole. */
static void test_rows_of_the_frame_before(void **state)
{
    static const struct {
        double before_s, time_s;
        int rows;
    } cases[] = {
        {0.008, 0.064, 2},           // dark in the reference, not in the frame before
        {BASE_S, BASE_S * 1.13, 10}, // a step that is hardly seen
        {BASE_S, BASE_S * 1.3, 1},   // few rows
        {BASE_S * 1.4, BASE_S, 14},  // so many that noise seems to be high
    };
    struct label_look k;
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        open_label(1, 1, 0.10);
        settle();
        request_exposure(0, cases[i].before_s);
        for (int n = 0; n < 3; n++)
            frame(cases[i].before_s);
        assert_int_equal(look(&k), LABEL_PROVEN);
        assert_true(whole(&k));
        label_hold(&l, 0, &w, &k);
        request_exposure(1, cases[i].time_s);
        frame(cases[i].before_s);
        frame(cases[i].time_s);
        assert_int_equal(look(&k), LABEL_PROVEN);
        if (i > 0 && !whole(&k)) // the first clips in a row, and cannot be told
            fail_msg("case %zu: a frame of %g s is whole", i, cases[i].time_s);
        tear(cases[i].rows, cases[i].before_s);
        look(&k);
        if (whole(&k))
            fail_msg("case %zu: %d rows of %g s in a frame of %g s", i, cases[i].rows,
                     cases[i].before_s, cases[i].time_s);
    }
}

/* A tear too faint to be seen, and after it one that would be seen if the first frame were right in
 * that row. */
static void test_torn_after_torn(void **state)
{
    static const double time_s[] = {4e-6, 6e-5, 9e-4};
    struct label_look k;
    (void)state;
    linear = true;
    open_label(1, 1, 0.10);
    settle();
    request_exposure(0, time_s[0]);
    frame(BASE_S);
    for (int i = 0; i < 3; i++) {
        if (i < 2)
            request_exposure(i + 1, time_s[i + 1]);
        frame(time_s[i]);
        if (i > 0)
            tear(1, time_s[i - 1]);
        look(&k);
        label_last(&l, &w, &k);
        if (i == 1) {
            assert_int_equal(k.verdict, LABEL_PROVEN);
            assert_true(k.whole && k.sure != 0 && !(k.sure & 1));
            label_hold(&l, 1, &w, &k);
        }
    }
    assert_int_equal(k.verdict, LABEL_PROVEN);
    assert_true(!k.whole && k.sure >> 1 == UINT32_MAX >> 1);
    linear = false;
}

/* A frame is whole by frames at hand, if it is nothing else that is wrong with it. */
static void test_not_whole(void **state)
{
    struct label_look k, good;
    (void)state;
    open_label(1, 1, 0.10);
    settle();
    request_exposure(0, 0.008);
    frame(BASE_S);
    frame(0.008);
    assert_int_equal(look(&good), LABEL_PROVEN);
    k = good;
    label_last(&l, &w, &k);
    assert_true(k.whole && l.anchor[LABEL_LAST].held);
    k = good;
    k.torn = true;
    label_last(&l, &w, &k);
    assert_true(!k.whole && k.sure == 0 && !l.anchor[LABEL_LAST].held);
    k = good;
    k.verdict = LABEL_CONFLICT;
    label_last(&l, &w, &k);
    assert_true(!k.whole && k.sure == 0 && !l.anchor[LABEL_LAST].held);
    k = good;
    label_forget(&l, true);
    assert_true(!whole(&k));
}

/* Each exposure that may have been that of the frame before counts. */
static void test_two_before(void **state)
{
    struct label_look k;
    (void)state;
    linear = true;
    light = 4.0;
    open_label(1, 2, 0.10);
    settle();
    request_exposure(0, BASE_S * 1.4);
    frame(BASE_S);
    request_exposure(1, BASE_S * 1.2);
    frame(BASE_S * 1.4);
    frame(BASE_S * 1.2);
    tear(1, BASE_S);
    assert_int_equal(look(&k), LABEL_PROVEN);
    assert_true(!whole(&k) && k.sure == ~1u);
    linear = false;
    light = 10.0;
}

/* What flicker, or a curve that is not known, could do to rows. */
static void test_slack_of_rows(void **state)
{
    static const struct {
        double tolerance, slack, before, stops, look; // stops from base
        bool whole;
    } cases[] = {
        {0.10, 0.0, 0.0, 0.2, 0.2, true},    {0.10, 0.3, 0.0, 0.2, 0.2, false},
        {0.10, 0.1, 0.0, 0.3, 0.3, true},    {0.10, 0.1, 0.0, 0.3, 0.08, false},
        {0.10, 0.0, -2.0, -1.7, -1.7, true}, {0.30, 0.0, -2.0, -1.7, -1.7, false},
        {0.30, 0.0, -2.0, -1.0, -1.0, true},
    };
    struct label_look k;
    (void)state;
    linear = true;
    light = 4.0;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        open_label(1, 1, cases[i].tolerance);
        settle();
        l.anchor[LABEL_REFERENCE].slack = cases[i].slack;
        double before_s = BASE_S * exp2(cases[i].before);
        request_exposure(0, before_s);
        for (int n = 0; n < 4; n++)
            frame(before_s);
        request_exposure(1, BASE_S * exp2(cases[i].stops));
        frame(before_s);
        frame(BASE_S * exp2(cases[i].stops));
        tear(1, BASE_S * exp2(cases[i].look));
        assert_int_equal(look(&k), LABEL_PROVEN);
        if (whole(&k) != cases[i].whole)
            fail_msg("case %zu: sure of rows %x", i, (unsigned)k.sure);
    }
    linear = false;
    light = 10.0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rivals),
        cmocka_unit_test(test_hidden_frames),
        cmocka_unit_test(test_reported_gain),
        cmocka_unit_test(test_bounds),
        cmocka_unit_test(test_rows_of_the_frame_before),
        cmocka_unit_test(test_torn_after_torn),
        cmocka_unit_test(test_not_whole),
        cmocka_unit_test(test_two_before),
        cmocka_unit_test(test_slack_of_rows),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
