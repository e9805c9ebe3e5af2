/* The simulated camera: light adds up, the same URI gives the same frames, drifts reach the
 * pixels. */
#include "sim/device/camera_sim.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

static void *open_sim(const char *options)
{
    char uri[2048];
    snprintf(uri, sizeof uri, "sim:size=%d,kind=room,seed=4,samples=1,shadow=1,fps=50,%s", SIZE,
             options);
    struct camera_cfg cfg = {.uri = uri};
    void *st = malloc(camera_sim.state_bytes);
    assert_non_null(st);
    err_t e = camera_sim.open(st, &cfg);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
    return st;
}

static void close_sim(void *st)
{
    camera_sim.close(st);
    free(st);
}

static void take(void *st, struct event *e)
{
    memset(e, 0, sizeof *e);
    e->code = camera_sim.next(st, &e->f);
    e->at = feed_now(st);
    if (e->code)
        return;
    e->truth = feed_truth(st, &e->f);
    memcpy(e->px, e->f.data, 3 * PX);
    for (int i = 0; i < 3 * PX; i++)
        e->mean[i % 3] += e->px[i] / (double)PX;
    struct frame f = e->f;
    camera_sim.release(st, &f);
}

static err_t request_exposure(void *st, double time_s, double gain, struct exposure *set)
{
    return camera_sim.request(st, &(struct exposure){time_s, gain}, set);
}

/* n calls of next, in virtual time. */
static void play(const char *options, int n, struct event *out)
{
    char text[1800];
    snprintf(text, sizeof text, "clock=virtual,%s", options);
    void *st = open_sim(text);
    for (int i = 0; i < n; i++)
        take(st, &out[i]);
    close_sim(st);
}

static bool near(double a, double b, double within)
{
    return fabs(a - b) <= within;
}

/* Brightness of b over that of a, of a colour's pixels that are grey in both. */
static double ratio(const struct event *a, const struct event *b, int c)
{
    double x = 0.0, y = 0.0;
    for (int i = c; i < 3 * PX; i += 3)
        if (a->px[i] > 10 && a->px[i] < 240 && b->px[i] > 10 && b->px[i] < 240) {
            x += a->px[i];
            y += b->px[i];
        }
    assert_true(x > 1000.0);
    return y / x;
}

static bool same_picture(const struct event *a, const struct event *b)
{
    double sum = 0.0;
    for (int i = 0; i < 3 * PX; i++)
        sum += abs(a->px[i] - b->px[i]);
    return sum < 3.0 * PX * 3.0; // noise
}

/* The file says where the camera stands; what is no view of the rig says nothing. */
static void test_moves(void **state)
{
    char text[400], path[200];
    (void)state;
    tmpdir_make();
    snprintf(path, sizeof path, "%s", tmpdir_path("at"));
    snprintf(text, sizeof text, "clock=virtual,views=3,spread=1,first=8000,at=%s", path);
    void *st = open_sim(text);
    take(st, &ev[0]);
    tmpdir_text("at", "2\n");
    take(st, &ev[1]);
    tmpdir_text("at", "0\n");
    take(st, &ev[2]);
    tmpdir_text("at", "3\n");
    take(st, &ev[3]);
    tmpdir_text("at", "2"); // not written to its end
    take(st, &ev[4]);
    assert_false(same_picture(&ev[0], &ev[1]));
    for (int i = 2; i < 5; i++)
        assert_true(same_picture(&ev[0], &ev[i]));
    close_sim(st);
    snprintf(text, sizeof text, "clock=virtual,views=3,view=2,spread=1,first=8000");
    st = open_sim(text);
    take(st, &ev[5]);
    assert_true(same_picture(&ev[1], &ev[5]));
    close_sim(st);
    tmpdir_remove();
}

/* Twice the time, twice the number, to a linear curve. */
static void test_light(void **state)
{
    void *st = open_sim("clock=virtual,curve=linear,first=1000,full=3000,delay=1,gaindelay=1");
    struct exposure set;
    (void)state;
    take(st, &ev[0]);
    for (int i = 1; i < 4; i++) {
        assert_int_equal(request_exposure(st, 0.001 * (1 << i), 1.0, &set), OK);
        take(st, &ev[i]);
        take(st, &ev[i]);
        assert_true(near(ratio(&ev[i - 1], &ev[i], 1), 2.0, 0.04));
    }
    assert_int_equal(request_exposure(st, 0.002, 4.0, &set), OK);
    take(st, &ev[4]);
    take(st, &ev[4]);
    assert_true(near(ratio(&ev[3], &ev[4], 1), 1.0, 0.06)); // 2 ms x 4 = 8 ms
    assert_true(ev[4].truth.exposure.gain == 4.0 && ev[4].f.exposure.gain == 4.0);
    close_sim(st);
}

static void test_same_uri_same_frames(void **state)
{
    (void)state;
    play("delay=3", 4, ev);
    play("delay=3", 4, other);
    for (int i = 0; i < 4; i++) {
        assert_memory_equal(ev[i].px, other[i].px, sizeof ev[i].px);
        assert_true(ev[i].f.timestamp_ns == other[i].f.timestamp_ns);
    }
    assert_memory_not_equal(ev[0].px, ev[1].px, sizeof ev[0].px); // noise
    play("views=3,view=2,delay=3", 1, other);
    play("views=3,view=0,delay=3", 1, ev);
    double apart = 0.0;
    for (int i = 0; i < 3 * PX; i++)
        apart += abs(ev[0].px[i] - other[0].px[i]) / (3.0 * PX);
    assert_true(apart > 8.0);
}

static void test_mosaic(void **state)
{
    struct camera_info info;
    struct frame f;
    void *st = open_sim("clock=virtual,format=bggr");
    (void)state;
    camera_sim.info(st, &info);
    assert_true(info.format == CAMERA_BGGR16 && info.bits == 12 && info.black == 256);
    assert_true(info.stride == 2 * SIZE);
    assert_int_equal(camera_sim.next(st, &f), OK);
    assert_true(f.bytes == 2 * PX && f.format == CAMERA_BGGR16);
    int bright = 0;
    for (int i = 0; i < PX; i++) {
        int v = f.data[2 * i] | f.data[2 * i + 1] << 8;
        assert_true(v < 4096 && v > 200);
        bright += v > 400;
    }
    assert_true(bright > PX / 4);
    close_sim(st);
}

static void test_drifts(void **state)
{
    (void)state;
    play("curve=linear,full=5000,first=4000,faults=at frame 1 gain 0.8;at frame 5 gain 1", 7, ev);
    assert_true(near(ev[4].truth.exposure.gain, pow(0.8, 4), 1e-9));
    assert_true(near(ratio(&ev[0], &ev[4], 1), pow(0.8, 4), 0.02));
    assert_true(near(ev[6].mean[1], ev[4].mean[1], 1.0) && ev[6].f.exposure.gain == 1.0);
    play("curve=linear,full=5000,first=4000,faults=at frame 1 gain 1.2", 4, ev);
    assert_true(near(ratio(&ev[0], &ev[3], 1), pow(1.2, 3), 0.03));
    play("curve=linear,full=5000,first=2000,faults=at frame 1 balance 1.1", 4, ev);
    assert_true(near(ratio(&ev[0], &ev[3], 0), pow(1.1, 3), 0.04));
    assert_true(near(ratio(&ev[0], &ev[3], 1), 1.0, 0.02));
    assert_true(near(ratio(&ev[0], &ev[3], 2), pow(1.1, -3), 0.04));
    assert_true(near(ev[3].f.red_gain * ev[3].f.blue_gain, 1.0, 1e-9));
    assert_true(near(ev[3].f.red_gain, pow(1.1, 3), 1e-9) && ev[3].truth.exposure.gain == 1.0);
    play("curve=linear,full=5000,first=2000,faults=at frame 1 digital 2", 3, ev);
    assert_true(near(ratio(&ev[0], &ev[1], 1), 2.0, 0.06));
    assert_true(ev[0].f.digital_gain == 1.0 && ev[1].f.digital_gain == 2.0);
    assert_true(ev[1].truth.exposure.gain == 2.0);
}

static void test_refused_uris(void **state)
{
    static const struct {
        const char *uri, *says;
    } bad[] = {
        {"sim:view=1", "view is 1, must be 0..0 (views is 1)"},
        {"sim:kind=moon", "kind is \"moon\", not one of any|room|yard|dark|plain|mirror|park"},
        {"sim:size=13", "size is \"13\", not a whole number in 14..2048"},
        {"sim:size=15,format=rggb", "size is 15 px, must be even for a Bayer format"},
        {"sim:seed=-1", "seed is \"-1\""},
        {"sim:curve=", "curve is \"\", not one of"},
        {"sim", "does not begin with \"sim:\""},
        {"", "does not begin with"},
    };
    void *st = malloc(camera_sim.state_bytes);
    (void)state;
    assert_non_null(st);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        struct camera_cfg cfg = {.uri = bad[i].uri};
        assert_int_equal(camera_sim.open(st, &cfg), ERR_ARG);
        if (!strstr(err_text(), bad[i].says))
            print_message("%s: %s\n", bad[i].uri, err_text());
        assert_non_null(strstr(err_text(), bad[i].says));
    }
    free(st);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_light),        cmocka_unit_test(test_same_uri_same_frames),
        cmocka_unit_test(test_mosaic),       cmocka_unit_test(test_drifts),
        cmocka_unit_test(test_refused_uris), cmocka_unit_test(test_moves),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
