/* The common part of simulated cameras: metadata and read-back lie exactly as told, every fault
 * does what its line says, and truth is on record whatever the frame claims. */
#include "sim/device/feed.h"

#include "sim/sensor/sensor.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { SIZE = 16, PX = SIZE * SIZE, MOST = 24 };

/* What came of one call of next. */
struct event {
    err_t code;
    struct frame f; // without data
    struct feed_truth truth;
    int64_t at; // camera's clock afterwards
    double mean[3];
    uint8_t px[3 * PX];
};

static struct event ev[MOST], other[MOST];

/* Brighter with exposure, red and blue gain, with noise by number. */
static err_t expose(void *ctx, const struct feed_shot *f, uint8_t *px)
{
    const double gain[3] = {f->red, 1.0, f->blue};
    (void)ctx;
    for (int i = 0; i < 3 * PX; i++) {
        double v = 4000.0 * f->exposure.time_s * f->exposure.gain * f->digital * gain[i % 3] +
                   8.0 * sensor_uniform((uint64_t)f->number, (uint64_t)i);
        px[i] = (uint8_t)fmin(v, 255.0);
    }
    return OK;
}

static void *open_fake(const char *options)
{
    static const struct feed_source source = {.w = SIZE,
                                              .h = SIZE,
                                              .bytes_per_px = 3,
                                              .bits = 8,
                                              .format = CAMERA_RGB8,
                                              .expose = expose};
    struct camera_cfg cfg = {.uri = "fake:"};
    struct feed_options o = feed_defaults;
    const struct uri_table table = {feed_keys, feed_n_keys, &o};
    struct feed *st = malloc(sizeof *st);
    assert_non_null(st);
    o.fps = 50.0;
    assert_int_equal(uri_parse("fake", options, &table, 1), OK);
    err_t e = feed_open(st, &cfg, &o, &source);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
    feed_start(st);
    return st;
}

static void close_fake(void *st)
{
    feed_close(st);
    free(st);
}

static void take(void *st, struct event *e)
{
    memset(e, 0, sizeof *e);
    e->code = feed_next(st, &e->f);
    e->at = feed_now(st);
    if (e->code)
        return;
    e->truth = feed_truth(st, &e->f);
    memcpy(e->px, e->f.data, 3 * PX);
    for (int i = 0; i < 3 * PX; i++)
        e->mean[i % 3] += e->px[i] / (double)PX;
    struct frame f = e->f;
    feed_release(st, &f);
}

static err_t ask(void *st, double time_s, double gain, struct exposure *set)
{
    return feed_request(st, &(struct exposure){time_s, gain}, set);
}

/* n calls of next, in virtual time. */
static void play(const char *options, int n, struct event *out)
{
    char text[1800];
    snprintf(text, sizeof text, "clock=virtual,%s", options);
    void *st = open_fake(text);
    for (int i = 0; i < n; i++)
        take(st, &out[i]);
    close_fake(st);
}

static bool near(double a, double b, double within)
{
    return fabs(a - b) <= within;
}

/* ---- what the camera tells ---- */

static void test_metadata(void **state)
{
    static const char *const mode[] = {"metadata=correct", "metadata=absent", "metadata=late"};
    (void)state;
    for (int m = 0; m < 3; m++) {
        char options[64];
        struct exposure set;
        snprintf(options, sizeof options, "clock=virtual,%s", mode[m]);
        void *st = open_fake(options);
        struct camera_info info;
        feed_info(st, &info);
        assert_int_equal(info.reports, m != FEED_ABSENT);
        for (int i = 0; i < 12; i++) {
            assert_int_equal(ask(st, 0.001 * (i + 1), 1.0, &set), OK);
            take(st, &ev[i]);
            double want = i < 2 ? 0.01 : 0.001 * (i - 1); // two frames after the write
            assert_true(near(ev[i].truth.exposure.time_s, want, 1e-9));
            assert_int_equal(ev[i].f.exposure_known, m != FEED_ABSENT);
            assert_int_equal(ev[i].f.gains_known, m != FEED_ABSENT);
            const struct event *told = m == FEED_LATE && i > 0 ? &ev[i - 1] : &ev[i];
            assert_true(m == FEED_ABSENT ||
                        near(ev[i].f.exposure.time_s, told->truth.exposure.time_s, 1e-9));
        }
        close_fake(st);
    }
}

static void test_readback(void **state)
{
    static const char *const mode[] = {"readback=honest", "readback=cached", "readback=lagged"};
    static const double want[3][2] = {{0.0012, 0.0033}, {0.00129, 0.0034}, {0.01, 0.0012}};
    (void)state;
    for (int m = 0; m < 3; m++) {
        char options[64];
        struct exposure set;
        snprintf(options, sizeof options, "clock=virtual,quantum=300,first=10000,%s", mode[m]);
        void *st = open_fake(options);
        assert_int_equal(ask(st, 0.00129, 1.0, &set), OK);
        assert_true(near(set.time_s, m == FEED_LAGGED ? 0.0099 : want[m][0], 1e-9));
        assert_int_equal(ask(st, 0.0034, 1.0, &set), OK);
        assert_true(near(set.time_s, want[m][1], 1e-9));
        close_fake(st);
    }
}

static void test_claim_stamp_skew(void **state)
{
    struct camera_info info;
    struct exposure set;
    (void)state;
    void *st = open_fake("clock=virtual,claim=-1,stamp=end,skew=700,first=4000");
    feed_info(st, &info);
    assert_true(info.exposure_delay == -1 && info.stamp == CAMERA_STAMP_END);
    int64_t opened = feed_now(st);
    take(st, &ev[0]);
    assert_true(ev[0].f.timestamp_ns - opened == 4700000 && ev[0].at - opened == 20700000);
    close_fake(st);
    st = open_fake("clock=virtual,length=limit,longest=1e6");
    feed_info(st, &info);
    assert_true(near(info.time_max_s, 0.02, 1e-9));
    assert_int_equal(ask(st, 0.5, 1.0, &set), OK);
    assert_true(near(set.time_s, 0.02, 1e-9));
    close_fake(st);
}

/* The truth of the first frames is not what the camera says. */
static void test_startup(void **state)
{
    (void)state;
    play("startup=3,first=10000", 5, ev);
    for (int i = 0; i < 5; i++) {
        assert_true(near(ev[i].f.exposure.time_s, 0.01, 1e-9));
        assert_true(near(ev[i].truth.exposure.time_s, i < 3 ? 0.003 : 0.01, 1e-9));
    }
    assert_true(ev[2].mean[1] < ev[3].mean[1] - 10.0);
}

static void test_truth_file(void **state)
{
    char options[256];
    (void)state;
    tmpdir_make();
    snprintf(options, sizeof options, "truth=%s,faults=at frame 2 drop 1", tmpdir_path("t"));
    play(options, 5, ev);
    FILE *f = fopen(tmpdir_path("t"), "r");
    assert_non_null(f);
    for (int i = 0; i < 5; i++) {
        unsigned sequence;
        long long stamp, number, start;
        double time_s, gain, torn;
        if (ev[i].code)
            continue;
        assert_int_equal(fscanf(f, "%u %lld %lld %lf %lf %lf %lld", &sequence, &stamp, &number,
                                &time_s, &gain, &torn, &start),
                         7);
        assert_true(sequence == ev[i].f.sequence && stamp == ev[i].f.timestamp_ns);
        assert_true(number == ev[i].truth.number && gain == 1.0 && torn == 0.0);
        assert_true(start == stamp && start == ev[i].truth.start_ns);
        assert_true(near(time_s, ev[i].truth.exposure.time_s, 1e-9));
    }
    assert_int_equal(fgetc(f), '\n');
    assert_int_equal(fgetc(f), EOF);
    fclose(f);
    tmpdir_remove();
}

/* ---- faults ---- */

static void test_lost_frames(void **state)
{
    (void)state;
    play("faults=at frame 2 drop 2;at frame 6 drop 1 nogap;at frame 8 eio", 10, ev);
    static const int code[10] = {OK, OK, ERR_AGAIN, ERR_AGAIN, OK, OK, ERR_AGAIN, OK, ERR_IO, OK};
    static const int sequence[10] = {0, 1, 0, 0, 4, 5, 0, 6, 0, 8};
    for (int i = 0; i < 10; i++) {
        assert_int_equal(ev[i].code, code[i]);
        if (code[i] == OK) {
            assert_int_equal(ev[i].f.sequence, sequence[i]);
            assert_int_equal(ev[i].truth.number, i);
        }
    }
}

static void test_lossy(void **state)
{
    void *st = open_fake("clock=virtual,faults=at frame 100 lose 0.05;at frame 2100 lose 0");
    int lost[3] = {0};
    uint32_t next = 0;
    (void)state;
    for (int i = 0; i < 2200; i++) {
        take(st, &ev[0]);
        lost[(i >= 100) + (i >= 2100)] += ev[0].code == ERR_AGAIN;
        if (ev[0].code == OK)
            next = ev[0].f.sequence + 1;
    }
    assert_true(lost[0] == 0 && lost[1] > 70 && lost[1] < 130 && lost[2] == 0);
    assert_int_equal(next, 2200);
    close_fake(st);
}

static void test_stall(void **state)
{
    (void)state;
    play("faults=at frame 2 stall 5;at time 0.3 stall 0", 16, ev);
    assert_true(ev[2].code == ERR_AGAIN && ev[3].code == OK && ev[3].f.sequence == 2);
    assert_true(near((double)(ev[3].f.timestamp_ns - ev[1].f.timestamp_ns), 6 * 20e6, 10));
    int good = 0;
    for (int i = 0; i < 16; i++)
        good += ev[i].code == OK;
    assert_int_equal(good, 9); // ends at 20, 40, 160, 180 .. 280 ms
    assert_int_equal(ev[15].code, ERR_AGAIN);
    assert_true(ev[15].at > ev[14].at); // time goes on
}

static void test_twice(void **state)
{
    (void)state;
    play("faults=at frame 2 duplicate;at frame 4 repeat", 7, ev);
    assert_true(ev[3].f.sequence == 2 && ev[3].f.timestamp_ns == ev[2].f.timestamp_ns);
    assert_memory_equal(ev[3].px, ev[2].px, sizeof ev[2].px);
    assert_true(ev[5].f.sequence == 4 && ev[5].truth.number == 3); // pixels of 3
    assert_memory_equal(ev[5].px, ev[4].px, sizeof ev[4].px);
    assert_true(ev[6].truth.number == 5);
}

/* A repeated frame claims the new exposure and has the old one. */
static void test_repeat_lies(void **state)
{
    struct exposure set;
    void *st = open_fake("clock=virtual,delay=1,first=1000,faults=at frame 1 repeat");
    (void)state;
    assert_int_equal(ask(st, 0.016, 1.0, &set), OK);
    take(st, &ev[0]);
    take(st, &ev[1]);
    assert_true(near(ev[1].f.exposure.time_s, 0.016, 1e-9));
    assert_true(near(ev[1].truth.exposure.time_s, 0.001, 1e-9));
    assert_true(near(ev[1].mean[1], ev[0].mean[1], 1e-9));
    close_fake(st);
}

static void test_damage(void **state)
{
    (void)state;
    play("faults=at frame 1 error;at frame 2 short 100;at frame 3 corrupt 96;"
         "at frame 4 short 99999;at frame 5 corrupt 99999",
         7, ev);
    play("delay=2", 7, other);
    assert_int_equal(ev[0].f.flags, 0);
    assert_int_equal(ev[1].f.flags, FRAME_ERROR);
    assert_memory_not_equal(ev[1].px, other[1].px, sizeof ev[1].px);
    assert_int_equal(ev[2].f.flags, FRAME_SHORT);
    assert_int_equal(ev[2].f.bytes, 3 * PX - 100);
    assert_int_equal(ev[3].f.flags, 0); // nobody says so
    assert_memory_equal(ev[3].px, other[3].px, sizeof ev[3].px - 96);
    assert_memory_not_equal(ev[3].px + 3 * PX - 96, other[3].px + 3 * PX - 96, 96);
    assert_true(ev[4].f.bytes == 0 && ev[4].f.flags == FRAME_SHORT);
    assert_memory_not_equal(ev[5].px, other[5].px, 96);
    assert_memory_equal(ev[6].px, other[6].px, sizeof ev[6].px); // once
}

/* Rows of the frame before, at one end, where the two have another exposure. */
static void test_torn(void **state)
{
    struct exposure set;
    (void)state;
    void *st = open_fake("clock=virtual,delay=1,first=1000,faults=at frame 0 tear 1");
    take(st, &ev[0]);
    assert_true(ev[0].truth.torn == 0.0);
    for (int i = 1; i < 40; i++) {
        assert_int_equal(ask(st, i % 2 ? 0.016 : 0.001, 1.0, &set), OK);
        take(st, &ev[1 - i % 2]);
    }
    assert_true(ev[0].truth.torn >= 0.03 && ev[0].truth.torn <= 0.45);
    close_fake(st);
    play("faults=at frame 0 tear 1", 7, ev); // one exposure: nobody can tell
    for (int i = 0; i < 7; i++)
        assert_true(ev[i].truth.torn == 0.0);
}

static void test_late(void **state)
{
    (void)state;
    play("faults=at frame 2 late 0.05", 7, ev);
    for (int i = 0; i < 7; i++) {
        assert_int_equal(ev[i].code, OK);
        assert_int_equal(ev[i].f.sequence, i); // still in order
        assert_true(i == 0 || ev[i].at >= ev[i - 1].at);
    }
    assert_true(ev[2].at - ev[2].f.timestamp_ns == 70000000);
    assert_true(ev[6].at - ev[6].f.timestamp_ns == 20000000);
}

/* A buffer that is lost with its frame is missing from then on. */
static void test_index(void **state)
{
    struct frame f[4];
    void *st = open_fake("clock=virtual,faults=at frame 0 index");
    (void)state;
    assert_int_equal(feed_next(st, &f[0]), ERR_IO);
    for (int i = 0; i < 3; i++)
        assert_int_equal(feed_next(st, &f[i]), OK);
    assert_int_equal(feed_next(st, &f[3]), ERR_AGAIN);
    close_fake(st);
}

static void test_sequence(void **state)
{
    (void)state;
    play("faults=at frame 2 sequence wrap;at frame 6 sequence stuck", 9, ev);
    static const uint32_t want[9] = {0, 1, 4294967294u, 4294967295u, 0, 1, 1, 1, 1};
    for (int i = 0; i < 9; i++)
        assert_true(ev[i].f.sequence == want[i]);
}

static void test_stamps(void **state)
{
    (void)state;
    play("faults=at frame 1 stamp back 5;at frame 2 stamp jump 7;at frame 3 stamp realtime;"
         "at frame 4 stamp zero",
         5, ev);
    int64_t first = ev[0].f.timestamp_ns;
    assert_true(ev[1].f.timestamp_ns - first == 20000000 - 5000000000);
    assert_true(ev[2].f.timestamp_ns - first == 40000000 + 2000000000);
    assert_true(ev[3].f.timestamp_ns - first > 1000000000000000000 / 4); // years
    assert_true(ev[4].f.timestamp_ns == 0);
}

/* The device does not know: it reports what was programmed. */
static void test_untrue_exposures(void **state)
{
    static const struct {
        const char *fault;
        double want[4]; // frames 2..5, asked for 1.00, 2.02, 3, 4 ms before
    } lie[] = {
        {"ignore 0", {0.01, 0.01, 0.01, 0.01}},
        {"ignore 3", {0.01, 0.01, 0.00302, 0.00402}},
        {"rollover 120", {0.001, 0.00202, 0.00062, 0.00162}},
        {"quantum 0.001", {0.001, 0.002, 0.003, 0.004}},
        {"quantum 0.1", {0.1, 0.1, 0.1, 0.1}},
    };
    static const double asked[4] = {0.001, 0.00202, 0.00302, 0.00402};
    (void)state;
    for (size_t k = 0; k < sizeof lie / sizeof lie[0]; k++) {
        char options[128];
        struct exposure set;
        snprintf(options, sizeof options, "clock=virtual,faults=at frame 1 %s", lie[k].fault);
        void *st = open_fake(options);
        for (int i = 0; i < 6; i++) {
            if (i < 4)
                assert_int_equal(ask(st, asked[i], 1.0, &set), OK);
            take(st, &ev[i]);
            if (i < 2)
                continue;
            assert_true(near(ev[i].f.exposure.time_s, asked[i - 2], 1e-9));
            assert_true(near(ev[i].truth.exposure.time_s, lie[k].want[i - 2], 1e-9));
        }
        close_fake(st);
    }
}

/* What is ignored leaves the exposure that was true before. */
static void test_ignore_later(void **state)
{
    struct exposure set;
    void *st = open_fake("clock=virtual,delay=1,faults=at frame 2 ignore 2");
    (void)state;
    for (int i = 0; i < 5; i++) {
        assert_int_equal(ask(st, 0.001 * (i + 1), 1.0, &set), OK);
        take(st, &ev[i]);
    }
    static const double want[5] = {0.01, 0.001, 0.001, 0.001, 0.004};
    for (int i = 0; i < 5; i++)
        assert_true(near(ev[i].truth.exposure.time_s, want[i], 1e-9));
    close_fake(st);
}

static void test_refusals(void **state)
{
    static const struct {
        const char *how;
        err_t code;
    } refuse[] = {{"access", ERR_UNSUPPORTED}, {"busy", ERR_BUSY}, {"range", ERR_ARG}};
    (void)state;
    for (int k = 0; k < 3; k++)
        for (int count = 0; count < 3; count += 2) {
            char options[128];
            struct exposure set = {0};
            snprintf(options, sizeof options, "clock=virtual,faults=at frame 0 refuse %s %d",
                     refuse[k].how, count);
            void *st = open_fake(options);
            take(st, &ev[0]);
            for (int i = 0; i < 4; i++)
                assert_int_equal(ask(st, 0.001, 1.0, &set),
                                 count == 0 || i < count ? refuse[k].code : OK);
            for (int i = 0; i < 4; i++)
                take(st, &ev[i]);
            assert_true(near(ev[3].truth.exposure.time_s, count ? 0.001 : 0.01, 1e-9));
            close_fake(st);
        }
}

static void test_format_changes(void **state)
{
    (void)state;
    play("faults=at frame 1 format", 2, ev);
    assert_true(ev[0].f.w == SIZE && ev[1].f.w == SIZE / 2 && ev[1].f.h == SIZE / 2);
    assert_true(ev[1].f.stride == 3 * SIZE / 2 && ev[1].f.bytes == 3 * PX / 4);
    assert_int_equal(ev[1].f.flags, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_metadata),
        cmocka_unit_test(test_readback),
        cmocka_unit_test(test_claim_stamp_skew),
        cmocka_unit_test(test_startup),
        cmocka_unit_test(test_truth_file),
        cmocka_unit_test(test_lost_frames),
        cmocka_unit_test(test_lossy),
        cmocka_unit_test(test_stall),
        cmocka_unit_test(test_twice),
        cmocka_unit_test(test_repeat_lies),
        cmocka_unit_test(test_damage),
        cmocka_unit_test(test_torn),
        cmocka_unit_test(test_late),
        cmocka_unit_test(test_index),
        cmocka_unit_test(test_sequence),
        cmocka_unit_test(test_stamps),
        cmocka_unit_test(test_untrue_exposures),
        cmocka_unit_test(test_ignore_later),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_format_changes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
