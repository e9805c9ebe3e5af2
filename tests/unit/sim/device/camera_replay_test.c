/* Replay: a request gives the picture of the view that is nearest in exposure, frames name it, and
 * views follow each other as told. */
#include "sim/device/camera_replay.h"

#include "drivers/format/img.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { W = 6, H = 4, VIEWS = 3, TIMES = 3 };

/* Picture t of view v is all value(v, t); view v has the exposures (v + 1) 4^t / 100 s. */
static uint8_t value(int v, int t)
{
    return (uint8_t)(100 * v + 10 * t + 5);
}

static double time_of(int v, int t)
{
    return (v + 1) * pow(4.0, t) / 100.0;
}

static void make_folder(const char *pattern)
{
    char json[2048] = "{\"unused.png\": 1";
    tmpdir_make();
    for (int i = 0; i < VIEWS * TIMES; i++) {
        uint8_t px[W * H * 3];
        char name[64];
        int v = i / TIMES, t = i % TIMES;
        memset(px, value(v, t), sizeof px);
        struct image8 im = {W, H, 3, px};
        snprintf(name, sizeof name, pattern, v, t);
        assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
        snprintf(json + strlen(json), 128, ", \"%s\": %.9g", name, time_of(v, t));
    }
    tmpdir_text("exposure.json", strcat(json, "}"));
}

static err_t try_open(const char *options, void **st)
{
    char uri[512];
    snprintf(uri, sizeof uri, "replay:%s,clock=virtual%s", tmpdir_root, options);
    struct camera_cfg cfg = {.uri = uri};
    *st = malloc(camera_replay.state_bytes);
    assert_non_null(*st);
    err_t e = camera_replay.open(*st, &cfg);
    if (e)
        free(*st);
    return e;
}

static void *open_replay(const char *options)
{
    void *st;
    err_t e = try_open(options, &st);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
    return st;
}

static void close_replay(void *st)
{
    camera_replay.close(st);
    free(st);
}

static void check_frame(void *st, int v, int t)
{
    struct frame f;
    assert_int_equal(camera_replay.next(st, &f), OK);
    assert_true(f.w == W && f.h == H && f.bytes == W * H * 3);
    for (size_t i = 0; i < f.bytes; i++)
        assert_int_equal(f.data[i], value(v, t));
    assert_true(fabs(f.exposure.time_s / time_of(v, t) - 1.0) < 1e-6 && f.exposure.gain == 1.0);
    assert_true(f.exposure_known && feed_truth(st, &f).exposure.time_s == f.exposure.time_s);
    camera_replay.release(st, &f);
}

static double request_exposure(void *st, double time_s, double gain)
{
    struct exposure set;
    assert_int_equal(camera_replay.request(st, &(struct exposure){time_s, gain}, &set), OK);
    assert_true(set.gain == 1.0);
    return set.time_s;
}

static void test_nearest(void **state)
{
    static const struct {
        double time_s, gain;
        int t;
    } wanted[] = {{1e-9, 1, 0},  {0.0199, 1, 0}, {0.0201, 1, 1}, {0.0201, 3, 1},
                  {0.079, 1, 1}, {0.081, 1, 2},  {1e9, 1, 2}};
    struct camera_info info;
    (void)state;
    make_folder("train_ldr_%03d_%d.png");
    void *st = open_replay("");
    camera_replay.info(st, &info);
    assert_true(fabs(info.time_min_s - 0.01) < 1e-9 && fabs(info.time_max_s - 0.48) < 1e-9);
    assert_true(info.gain_max == 1.0 && info.w == W && info.h == H && info.exposure_delay == 1);
    assert_int_equal(camera_replay_views(st), VIEWS);
    for (size_t i = 0; i < sizeof wanted / sizeof wanted[0]; i++) {
        double set = request_exposure(st, wanted[i].time_s, wanted[i].gain);
        assert_true(fabs(set / time_of(0, wanted[i].t) - 1.0) < 1e-6);
        struct frame f;
        assert_int_equal(camera_replay.next(st, &f), OK); // ran during the request
        camera_replay.release(st, &f);
        check_frame(st, 0, wanted[i].t);
    }
    close_replay(st);
    tmpdir_remove();
}

/* A daemon that knows nothing of views walks through all of them. */
static void test_step(void **state)
{
    (void)state;
    make_folder("train_ldr_%03d_%d.png");
    void *st = open_replay(",step=3,view=1");
    for (int v = 1; v < 1 + 2 * VIEWS; v++)
        for (int t = 0; t < TIMES; t++) {
            struct frame f;
            request_exposure(st, time_of(v % VIEWS, t), 1.0);
            assert_int_equal(camera_replay_view(st), v % VIEWS);
            assert_int_equal(camera_replay.next(st, &f), OK);
            camera_replay.release(st, &f);
            check_frame(st, v % VIEWS, t);
        }
    close_replay(st);
    st = open_replay("");
    for (int v = 0; v < 2 * VIEWS; v++) {
        request_exposure(st, time_of(v % VIEWS, 2), 1.0);
        struct frame f;
        assert_int_equal(camera_replay.next(st, &f), OK);
        camera_replay.release(st, &f);
        check_frame(st, v % VIEWS, 2);
        camera_replay_step(st);
    }
    close_replay(st);
    tmpdir_remove();
}

/* What is told of a frame holds also between two views with other exposures. */
static void test_between_views(void **state)
{
    (void)state;
    make_folder("train_ldr_%03d_%d.png");
    void *st = open_replay("");
    request_exposure(st, time_of(0, 2), 1.0);
    struct frame f;
    assert_int_equal(camera_replay.next(st, &f), OK);
    camera_replay.release(st, &f);
    check_frame(st, 0, 2); // 0.16 s in force
    camera_replay_step(st);
    camera_replay_step(st);
    check_frame(st, 2, 1); // 0.12 s is what this view has nearest
    close_replay(st);
    tmpdir_remove();
}

static void test_groups(void **state)
{
    void *st;
    (void)state;
    make_folder("place_%d_%d.png"); // not the released layout, the same rule of names
    st = open_replay("");
    assert_int_equal(camera_replay_views(st), VIEWS);
    close_replay(st);
    tmpdir_remove();
    make_folder("IMG%d%d.png");
    st = open_replay("");
    assert_int_equal(camera_replay_views(st), VIEWS * TIMES);
    close_replay(st);
    st = open_replay(",bracket=3,view=2");
    assert_int_equal(camera_replay_views(st), VIEWS);
    request_exposure(st, time_of(2, 1), 1.0);
    struct frame f;
    assert_int_equal(camera_replay.next(st, &f), OK);
    camera_replay.release(st, &f);
    check_frame(st, 2, 1);
    close_replay(st);
    assert_int_equal(try_open(",bracket=4", &st), ERR_ARG);
    assert_non_null(strstr(err_text(), "9 pictures cannot be divided into brackets of 4"));
    assert_int_equal(try_open(",bracket=3,view=3", &st), ERR_ARG);
    assert_non_null(strstr(err_text(), "view is 3"));
    tmpdir_remove();
}

static void test_refusals(void **state)
{
    void *st;
    (void)state;
    make_folder("train_ldr_%03d_%d.png");
    assert_int_equal(try_open(",which=test", &st), ERR_FORMAT);
    assert_int_equal(try_open(",quantum=10", &st), ERR_ARG); // for sensors only
    assert_non_null(strstr(err_text(), "no option is called \"quantum\""));
    tmpdir_text("train_ldr_000_1.png", "no picture");
    assert_int_equal(try_open("", &st), ERR_FORMAT);
    struct camera_cfg cfg = {.uri = "replay:,view=1"};
    st = malloc(camera_replay.state_bytes);
    assert_non_null(st);
    assert_int_equal(camera_replay.open(st, &cfg), ERR_ARG);
    cfg.uri = "replay:/nowhere";
    assert_int_equal(camera_replay.open(st, &cfg), ERR_IO);
    free(st);
    tmpdir_remove();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_nearest),       cmocka_unit_test(test_step),
        cmocka_unit_test(test_between_views), cmocka_unit_test(test_groups),
        cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
