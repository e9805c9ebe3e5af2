/* Simulated cameras, calibrated and tested: what is found is compared with what was simulated. Each
 * fault must fail its checks and no other. */
#include "firmware/capture/calibrate.h"

#include "firmware/base/engine.h"
#include "firmware/cmd/selftest.h"

#include "sim/sensor/curve.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#define LONGEST 0.3
#define ALL (CALIBRATE_LATENCY | CALIBRATE_RANGE | CALIBRATE_RESPONSE)

static struct calibrate c;
static struct selftest t;
static struct device_probe *w;
static char uri[512];

static int set_up(void **state)
{
    (void)state;
    tmpdir_make();
    atomic_store(&engine_cancel, false);
    w = NULL;
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    device_probe_close(w);
    tmpdir_remove();
    return 0;
}

static const char *camera(const char *options)
{
    const char *size = strstr(options, "size=") ? "" : "size=34,"; // quick, as mosaics are
    snprintf(uri, sizeof uri, "sim:kind=room,seed=5,%ssamples=1,shadow=1,fps=100,clock=virtual%s%s",
             size, *options ? "," : "", options);
    return uri;
}

static err_t calibrate_parts(unsigned parts)
{
    struct calib known;
    bool found;
    assert_int_equal(calib_load(tmpdir_root, &w->info, &known, &found), OK);
    return calibrate_run(w, parts, LONGEST, &known, &c);
}

static void open_camera(const char *options)
{
    struct camera_cfg cfg = {.uri = camera(options)};
    device_probe_close(w);
    if (device_probe_open(&cfg, &w) != OK)
        fail_msg("%s", err_text());
}

static void calibrate(const char *options)
{
    open_camera(options);
    if (calibrate_parts(ALL) != OK)
        fail_msg("%s: %s", options, err_text());
    assert_int_equal(c.parts, ALL);
    assert_true(c.calib.when_s > 1600000000);
}

/* ---- calibration ---- */

static void everything_of_a_good_camera(void **state)
{
    (void)state;
    calibrate("size=56,format=rggb,delay=5");
    assert_int_equal(c.calib.delay_lo, 5);
    assert_int_equal(c.calib.delay_hi, 5);
    assert_true(c.trials >= 12 && c.unsure == 0);
    assert_true(c.calib.tolerance == 0.10 && !c.calib.has_crf);
    assert_true(c.calib.time_min_s == w->info.time_min_s);
    assert_true(c.calib.time_max_s == w->info.time_max_s);
    assert_true(c.seen_min_s < 2e-4 && c.seen_max_s > 0.05);
    for (int i = 1; i < c.n; i++) {
        assert_int_not_equal(c.step[i].verdict, CALIBRATE_WRONG);
        assert_true(c.step[i].time_s > c.step[i - 1].time_s);
    }
    assert_true(fabs(c.step[c.n - 1].time_s - LONGEST) < 1e-4);
}

/* Largest error of a ratio by the recovered curve, over display values that matter, stops. */
static double curve_error(const struct crf *got, enum curve_family family)
{
    struct curve truth;
    double lo = INFINITY, hi = -INFINITY;
    curve_make(family, NAN, 5, &truth);
    for (int z = 32; z < 240; z++) {
        double off =
            (double)got->log2x[1][z] - log2((double)curve_exposure(&truth, (float)z / 255));
        lo = fmin(lo, off);
        hi = fmax(hi, off);
    }
    return hi - lo;
}

static void response_curves(void **state)
{
    (void)state;
    const struct {
        const char *word;
        enum curve_family family;
    } of[] = {{"filmic", CURVE_FILMIC}, {"agx", CURVE_AGX}};
    for (int i = 0; i < 2; i++) {
        char options[40];
        snprintf(options, sizeof options, "size=56,curve=%s", of[i].word);
        calibrate(options);
        assert_true(c.calib.has_crf && c.calib.crf.known && c.calib.tolerance == 0.10);
        double off = curve_error(&c.calib.crf, of[i].family);
        if (!(off < 0.25))
            fail_msg("%s: ratios are up to %.2f stops wrong", of[i].word, off);
        assert_true(c.calib.time_min_s == w->info.time_min_s);
        assert_true(c.calib.time_max_s == w->info.time_max_s);
    }
}

/* One part leaves the others as they were. */
static void parts(void **state)
{
    (void)state;
    open_camera("claim=-1");
    assert_int_equal(calibrate_parts(CALIBRATE_LATENCY), OK);
    assert_int_equal(c.parts, CALIBRATE_LATENCY);
    assert_true(c.calib.delay_lo == 2 && c.calib.delay_hi == 2);
    assert_true(!c.calib.has_crf && c.n == 0 && c.calib.tolerance == 0.30);
    assert_int_equal(calib_save(tmpdir_root, &w->info, &c.calib), OK);
    assert_int_equal(calibrate_parts(CALIBRATE_RESPONSE), OK);
    assert_true(c.calib.delay_hi == 2 && c.calib.has_crf && c.calib.tolerance == 0.10);
}

static void delays(void **state)
{
    (void)state;
    const struct {
        const char *options;
        int lo, hi;
    } of[] = {{"delay=1", 1, 1},
              {"format=rggb,delay=12,claim=3", 12, 12},
              {"format=rggb,delay=3,claim=-1,jitter=2", 3, 5},
              {"format=rggb,delay=4,faults=at frame 0 lose 0.15", 4, 4},
              {"format=rggb,delay=4,faults=at frame 0 sequence stuck", 4, 4}};
    for (size_t i = 0; i < sizeof of / sizeof of[0]; i++) {
        open_camera(of[i].options);
        if (calibrate_parts(CALIBRATE_LATENCY) != OK)
            fail_msg("%s: %s", of[i].options, err_text());
        if (c.calib.delay_lo != of[i].lo || c.calib.delay_hi != of[i].hi)
            fail_msg("%s: %d to %d", of[i].options, c.calib.delay_lo, c.calib.delay_hi);
        assert_true((c.unsure > 0) == (strstr(of[i].options, "lose") != NULL));
    }
}

static void ranges(void **state)
{
    (void)state;
    calibrate("faults=at frame 0 rollover 1500"); // steps of 20 us
    assert_true(c.calib.time_max_s > 0.022 && c.calib.time_max_s < 0.030);
    assert_true(c.calib.time_min_s == w->info.time_min_s && c.seen_max_s <= c.calib.time_max_s);
    calibrate("curve=agx,faults=at frame 0 quantum 0.001");
    assert_true(c.calib.time_min_s > 0.002 && c.calib.time_min_s < 0.008);
    assert_true(c.calib.time_max_s == w->info.time_max_s && c.calib.has_crf);
}

static void refused(const char *options, err_t code, const char *words)
{
    open_camera(options);
    err_t e = calibrate_parts(ALL);
    if (e != code || !strstr(err_text(), words))
        fail_msg("%s: %d, \"%s\"", options, e, e ? err_text() : "");
}

static void sentences(void **state)
{
    (void)state;
    refused("format=rggb,faults=at frame 0 ignore 0", ERR_UNSUPPORTED, "exposure has no effect");
    refused("format=rggb,full=1e8,longest=1000", ERR_LIMIT, "too dark");
    refused("format=rggb,full=10,quantum=20000", ERR_LIMIT, "too bright");
    refused("longest=20", ERR_LIMIT, "too dark");
    refused("format=rggb,faults=at frame 150 gain 1.004", ERR_LIMIT, "the same exposure differs");
    refused("format=rggb,faults=at frame 3 refuse access 0", ERR_UNSUPPORTED, "permission denied");
    refused("format=rggb,delay=2,faults=at frame 80 lose 0.9", ERR_LIMIT, "frames were lost");
    refused("faults=at frame 60 format", ERR_FORMAT, "17 x 17");
    refused("format=rggb,faults=at frame 60 unplug", ERR_LOST, "unplugged");
    open_camera("");
    atomic_store(&engine_cancel, true);
    assert_int_equal(calibrate_parts(ALL), ERR_CANCELLED);
}

/* ---- self-test ---- */

static void test_camera(const char *options)
{
    struct selftest_order o = {
        .camera = {.uri = camera(options)}, .calibration = tmpdir_root, .longest_s = LONGEST};
    if (selftest_run(&o, &t) != OK)
        fail_msg("%s: %s", options, err_text());
}

/* The checks that fail are those named, with blanks around. */
static void expect(const char *options, const char *failing)
{
    test_camera(options);
    for (int i = 0; i < SELFTEST_CHECKS; i++) {
        char name[32];
        snprintf(name, sizeof name, " %s ", selftest_name((enum selftest_check)i));
        bool fails = t.check[i].result == SELFTEST_FAIL;
        assert_true(t.check[i].text[0] && t.check[i].n <= SELFTEST_FIGURES);
        if (fails != (strstr(failing, name) != NULL))
            fail_msg("%s:%s%s: %s", options, name, fails ? "fails" : "does not fail",
                     t.check[i].text);
    }
    assert_true(selftest_passed(&t) == !failing[0]);
}

static void a_good_camera_passes(void **state)
{
    (void)state;
    expect("curve=filmic", "");
    for (int i = 0; i < SELFTEST_CHECKS; i++)
        assert_int_equal(t.check[i].result, SELFTEST_PASS);
    assert_true(!t.calibrated && t.measured.calib.has_crf);
}

/* Those that end before brackets. */
static void faults_that_end_it(void **state)
{
    (void)state;
    expect("faults=at frame 0 ignore 0", " effect ");
    assert_int_equal(t.check[SELFTEST_RATE].result, SELFTEST_PASS);
    assert_int_equal(t.check[SELFTEST_LATCHING].result, SELFTEST_SKIPPED);
    expect("faults=at frame 40 refuse access 0", " requests ");
    expect("faults=at frame 60 unplug", " stream ");
    expect("faults=at frame 200 format", " stream errors ");
    expect("full=1e8,longest=1000", "");
    assert_int_equal(t.check[SELFTEST_EFFECT].result, SELFTEST_SKIPPED);
    assert_non_null(strstr(t.check[SELFTEST_EFFECT].text, "too dark"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(everything_of_a_good_camera, set_up, tear_down),
        cmocka_unit_test_setup_teardown(response_curves, set_up, tear_down),
        cmocka_unit_test_setup_teardown(parts, set_up, tear_down),
        cmocka_unit_test_setup_teardown(delays, set_up, tear_down),
        cmocka_unit_test_setup_teardown(ranges, set_up, tear_down),
        cmocka_unit_test_setup_teardown(sentences, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_good_camera_passes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(faults_that_end_it, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
