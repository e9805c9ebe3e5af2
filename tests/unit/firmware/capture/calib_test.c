#include "firmware/capture/calib.h"
#include "firmware/capture/take.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const struct camera_info info = {.unit = "usb-0000:00:14.0/2%",
                                        .w = 1280,
                                        .h = 720,
                                        .format = CAMERA_YUYV,
                                        .bits = 8,
                                        .period_s = 1.0 / 30,
                                        .time_min_s = 0.0001,
                                        .time_max_s = 0.5,
                                        .time_step_s = 0.0001,
                                        .exposure_delay = 2,
                                        .stamp = CAMERA_STAMP_END,
                                        .reports = true};

/* Every bit pattern a float can round to on the way. */
static struct calib example(void)
{
    struct calib c = {.delay_lo = 2,
                      .delay_hi = 5,
                      .time_min_s = 0.1 / 3,
                      .time_max_s = 0.3,
                      .has_crf = true,
                      .tolerance = 0.1234567890123,
                      .when_s = 1700000000};
    c.crf.error = 0.01f / 3;
    c.crf.known = true;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 256; k++)
            c.crf.log2x[i][k] = k == 255 ? 0.0f : -(float)(255 - k) * (0.03f + 0.001f * (float)i);
    return c;
}

static void round_trip(void **state)
{
    (void)state;
    struct calib c = example(), back;
    bool found = true;
    assert_int_equal(calib_load(tmpdir_path("none"), &info, &back, &found), OK);
    assert_false(found);
    assert_true(back.delay_lo == 2 && back.delay_hi == 2 && back.time_max_s == 0.5 &&
                back.tolerance == 0.30 && !back.has_crf);
    const char *dir = tmpdir_path("new");
    assert_int_equal(calib_save(dir, &info, &c), OK);
    assert_int_equal(calib_load(dir, &info, &back, &found), OK);
    assert_true(found);
    assert_true(back.delay_lo == 2 && back.delay_hi == 5 && back.time_min_s == c.time_min_s &&
                back.time_max_s == c.time_max_s && back.tolerance == c.tolerance &&
                back.when_s == c.when_s && back.has_crf && back.crf.known &&
                back.crf.error == c.crf.error);
    assert_memory_equal(back.crf.log2x, c.crf.log2x, sizeof c.crf.log2x);
    c.crf.known = false; // assumed: nothing that was measured
    c.delay_hi = 3;
    assert_int_equal(calib_save(dir, &info, &c), OK);
    assert_int_equal(calib_load(dir, &info, &back, &found), OK);
    assert_true(found && !back.has_crf && back.delay_hi == 3);
    DIR *d = opendir(dir);
    int n = 0;
    for (struct dirent *entry; (entry = readdir(d));)
        if (entry->d_name[0] != '.') {
            n++;
            assert_string_equal(entry->d_name, "usb-0000:00:14.0%2F2%25_1280x720_yuyv.conf");
        }
    closedir(d);
    assert_int_equal(n, 1); // no temporary file stays; a hidden one would be found below
    assert_int_not_equal(remove(dir), 0);
    assert_int_equal(remove(tmpdir_path("new/usb-0000:00:14.0%2F2%25_1280x720_yuyv.conf")), 0);
    assert_int_equal(remove(dir), 0);
}

static void one_file_per_mode(void **state)
{
    (void)state;
    struct calib c = example(), back;
    struct camera_info other = info;
    bool found;
    const char *dir = tmpdir_path("modes");
    assert_int_equal(calib_save(dir, &info, &c), OK);
    other.w = 640;
    assert_int_equal(calib_load(dir, &other, &back, &found), OK);
    assert_false(found);
    other = info;
    other.format = CAMERA_RGGB10P;
    assert_int_equal(calib_load(dir, &other, &back, &found), OK);
    assert_false(found);
    assert_true(back.tolerance == 0.10); // linear
    other = info;
    strcpy(other.unit, "usb-0000:00:14.0-2%");
    assert_int_equal(calib_load(dir, &other, &back, &found), OK);
    assert_false(found);
    memset(other.unit, '/', CAMERA_UNIT_CAP - 1);
    expect_err(calib_save(dir, &other, &c), ERR_ARG, "at most 255 are allowed");
    strcpy(other.unit, "..");
    assert_int_equal(calib_save(dir, &other, &c), OK);
    assert_int_equal(remove(tmpdir_path("modes/%2E._1280x720_yuyv.conf")), 0);
    other.unit[0] = 0;
    expect_err(calib_save(dir, &other, &c), ERR_ARG, "reports no unit name");
    expect_err(calib_save("/proc/none", &info, &c), ERR_IO, "/proc/none/");
}

#define HEAD "unit = usb-0000:00:14.0/2%\nsize=1280x720\n\t format =yuyv \r\n"
#define REST "when_s = 5\ndelay_lo = 0\ndelay_hi = 32\ntime_min_s = 1e-4\ntolerance = 0.1\n"

static void refuses(void **state)
{
    (void)state;
    static const struct {
        const char *text, *words;
    } bad[] = {
        {"", "x:1: ends without unit"},
        {HEAD REST, "x:9: ends without time_max_s"},
        {HEAD REST "time_max_s = 1\ncrf.error = 0.1\n", "x:11: ends without crf.red"},
        {HEAD REST "time_max_s = 1e-5\n", "x:9: delay 0..32 frames, time 0.0001..1e-05 s"},
        {HEAD "delay_lo = 33\n", "x:4: delay_lo: 33 is not a whole number in 0..32"},
        {HEAD "delay_lo = -1\n", "x:4: delay_lo: -1 is not"},
        {HEAD "delay_lo = 1.5\n", "x:4: delay_lo: 1.5 is not a whole"},
        {HEAD "tolerance = nan\n", "x:4: tolerance: nan is not in 0.01..1"},
        {HEAD "tolerance = 1.1\n", "x:4: tolerance: 1.1 is not"}, // the bracket machine says so
        {HEAD "tolerance = 0.009\n", "x:4: tolerance: 0.009 is not"},
        {HEAD "time_max_s = inf\n", "x:4: time_max_s: inf is not"},
        {HEAD "time_max_s = \n", "\"\" is not a number"},
        {HEAD "time_max_s = 1 2\n", "\"2\" after the number"},
        {HEAD "time_max = 1\n", "unknown key \"time_max\""},
        {HEAD "size = 1280x720\n", "x:4: size is given again, it is in line 2"},
        {HEAD "words\n", "x:4: the line is not \"key = value\""},
        {"unit = other\n", "x:1: unit is \"other\", but the camera has \"usb-"},
        {"\n# comment\nsize = 1280x721\n", "x:3: size is \"1280x721\""},
        {"format = rgb8\n", "but the camera has \"yuyv\""},
        {HEAD "crf.red = -1 0 1\n", "x:4: crf.red: 1 is not in -40..0"},
        {HEAD "crf.red = -1 -1\n", "number 2 of 256 does not rise"},
        {HEAD "crf.red = -1 -0.5 ;\n", "\" ;\" is not a number"},
    };
    struct calib out;
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        expect_err(calib_parse("x", bad[i].text, strlen(bad[i].text), &info, &out), ERR_FORMAT,
                   bad[i].words);
        assert_true(out.delay_hi == 2 && out.time_max_s == 0.5); // as if there were none
    }
    expect_err(calib_parse("x", "a\0b", 3, &info, &out), ERR_FORMAT, "a zero byte at 1");
    static char large[1 << 17];
    expect_err(calib_parse("x", large, sizeof large, &info, &out), ERR_FORMAT, "131072 bytes");
    const char *good = HEAD REST "time_max_s = 1";
    assert_int_equal(calib_parse("x", good, strlen(good), &info, &out), OK);
    assert_true(out.delay_lo == 0 && out.delay_hi == 32 && out.when_s == 5 && !out.has_crf);
}

static void refuses_bad_curves(void **state)
{
    (void)state;
    struct calib out, c = example();
    static const struct {
        int code;
        float value;
        const char *words;
    } bad[] = {{255, -0.001f, "last number is -0.001"},
               {100, 0.0f, "number 102 of 256 does not rise"},
               {0, -41.0f, "crf.green: -41 is not in -40..0"},
               {0, NAN, "crf.green: nan"}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        c = example();
        c.crf.log2x[1][bad[i].code] = bad[i].value;
        expect_err(calib_save(tmpdir_path("bad"), &info, &c), ERR_ARG, bad[i].words);
    }
    c = example();
    c.delay_lo = 6;
    expect_err(calib_save(tmpdir_path("bad"), &info, &c), ERR_ARG, "delay 6..5 frames");
    char text[8192] = HEAD REST "time_max_s = 1\ncrf.red =";
    size_t n = strlen(text);
    for (int k = 0; k < 257; k++)
        n += (size_t)sprintf(text + n, " %g", k < 255 ? (k - 255) / 8.0 : 0.0);
    expect_err(calib_parse("x", text, n, &info, &out), ERR_FORMAT,
               "crf.red: more than 256 numbers");
}

static void merges(void **state)
{
    (void)state;
    struct bracket_camera b;
    struct camera_info other = info;
    struct calib c = example();
    calib_camera(&info, NULL, &b);
    assert_true(b.delay_lo == 2 && b.delay_hi == 2 && b.time_min_s == 0.0001 &&
                b.time_max_s == 0.5 && b.time_step_s == 0.0001 && b.period_s == info.period_s &&
                b.stamp == CAMERA_STAMP_END && b.reports && b.tolerance == 0.30);
    other.exposure_delay = -1;
    other.format = CAMERA_GREY16;
    calib_camera(&other, NULL, &b);
    assert_true(b.delay_lo == 0 && b.delay_hi == 8 && b.tolerance == 0.10);
    other.exposure_delay = 1000;
    calib_camera(&other, NULL, &b);
    assert_true(b.delay_lo == 32 && b.delay_hi == 32);
    calib_camera(&info, &c, &b);
    assert_true(b.delay_lo == 2 && b.delay_hi == 5 && b.time_min_s == c.time_min_s &&
                b.time_max_s == 0.3 && b.tolerance == c.tolerance);
    c.time_max_s = 10; // more than the device has
    calib_camera(&info, &c, &b);
    assert_true(b.time_max_s == 0.5);
    c.time_min_s = 1; // nothing in common
    calib_camera(&info, &c, &b);
    assert_true(b.time_min_s == 0.0001 && b.time_max_s == 0.5);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(round_trip), cmocka_unit_test(one_file_per_mode),
        cmocka_unit_test(refuses), cmocka_unit_test(refuses_bad_curves), cmocka_unit_test(merges)};
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failed;
}
