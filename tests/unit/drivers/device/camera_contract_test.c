/* What drivers/device/camera.h promises, on every backend that needs no hardware. */
#include "drivers/device/camera_v4l2.h"

#include "drivers/format/img.h"
#include "tests/unit/drivers/device/v4l2_fake_kinds.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <time.h>

#include <cmocka.h>

enum { SIZE = 16, VIEWS = 2, TIMES = 3, BACKENDS = 3 };

struct backend {
    const struct camera_ops *ops;
    char uri[512];       // without options
    double times[TIMES]; // that it can do exactly
    bool kernel;         // under a fake one, which has the options; frames do not report
};

static struct backend backends[BACKENDS];
static struct fake fake;

/* A driver of small pictures at 200 frames/s, with what the options of the other backends say. */
static err_t kernel_open(void *st, const struct camera_cfg *cfg)
{
    const char *o = strchr(cfg->uri, ','), *at;
    char uri[64];
    fake_uvc(&fake);
    fake.w[0] = fake.h[0] = SIZE;
    fake.fourcc[0] = V4L2_PIX_FMT_RGB24;
    fake.fourcc[1] = 0;
    fake.pace[0] = (struct v4l2_fract){1, 200};
    fake_put_format(&fake, SIZE, SIZE, V4L2_PIX_FMT_RGB24);
    o = o ? o : "";
    fake.clock = strstr(o, "clock=virtual") ? FAKE_VIRTUAL : FAKE_REAL;
    fake.late = (at = strstr(o, "delay=")) ? atoi(at + 6) : 2;
    fake.stall_at = (at = strstr(o, "stall")) ? 2 : 0;
    fake.lost_at = (at = strstr(o, "unplug")) ? 2 : 0;
    if ((at = strstr(o, "node=")))
        snprintf(fake.node, sizeof fake.node, "%.*s", (int)strcspn(at + 5, ","), at + 5);
    snprintf(uri, sizeof uri, "%.*s,longest_ms=5", (int)strcspn(cfg->uri, ","), cfg->uri);
    struct camera_cfg own = *cfg;
    own.uri = uri;
    return camera_v4l2_open_with(st, &own, &fake.sys);
}

static struct camera_ops kernel_ops; // camera_v4l2 with that open

static void make_folder(void)
{
    char json[1024] = "{";
    tmpdir_make();
    for (int i = 0; i < VIEWS * TIMES; i++) {
        uint8_t px[SIZE * SIZE * 3];
        char name[64];
        memset(px, 10 * i + 1, sizeof px);
        struct image8 im = {SIZE, SIZE, 3, px};
        snprintf(name, sizeof name, "train_ldr_%03d_%d.png", i / TIMES, i % TIMES);
        assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
        snprintf(json + strlen(json), 128, "%s\"%s\": %g", i ? ", " : "", name,
                 0.001 * pow(4.0, i % TIMES));
    }
    tmpdir_text("exposure.json", strcat(json, "}"));
}

static int set_up(void **state)
{
    (void)state;
    make_folder();
    static const struct camera_ops *const ops[] = {&camera_sim, &camera_replay, &kernel_ops};
    kernel_ops = camera_v4l2;
    kernel_ops.open = kernel_open;
    for (int b = 0; b < BACKENDS; b++) {
        backends[b].ops = ops[b];
        backends[b].kernel = b == 2;
        for (int i = 0; i < TIMES; i++)
            backends[b].times[i] = 0.001 * pow(b == 2 ? 2.0 : 4.0, i);
    }
    snprintf(backends[2].uri, sizeof backends[2].uri, "v4l2:/dev/fake");
    snprintf(backends[0].uri, sizeof backends[0].uri, "sim:size=%d,kind=plain,samples=1", SIZE);
    snprintf(backends[1].uri, sizeof backends[1].uri, "replay:%s", tmpdir_root);
    return 0;
}

static err_t try_open(const struct backend *b, const char *options, void **st)
{
    char uri[1024];
    snprintf(uri, sizeof uri, "%s%s", b->uri, options);
    struct camera_cfg cfg = {.uri = uri};
    *st = malloc(b->ops->state_bytes);
    assert_non_null(*st);
    memset(*st, 0xA5, b->ops->state_bytes); // any content
    err_t e = b->ops->open(*st, &cfg);
    if (e)
        free(*st);
    return e;
}

static void *open_camera(const struct backend *b, const char *options)
{
    char fast[700];
    void *st;
    snprintf(fast, sizeof fast, "%s,fps=200", options);
    assert_int_equal(try_open(b, fast, &st), OK);
    return st;
}

static void close_camera(const struct backend *b, void *st)
{
    b->ops->close(st);
    free(st);
    assert_true(!b->kernel || (fake.fds == 0 && fake.maps == 0 && !fake.breach[0]));
}

static bool readable(const struct backend *b, const void *st, int ms)
{
    struct pollfd p = {.fd = b->ops->fd(st), .events = POLLIN};
    return poll(&p, 1, ms) == 1;
}

/* The next frame, waited for as a daemon does. */
static err_t wait_frame(const struct backend *b, void *st, struct frame *f)
{
    err_t e = ERR_AGAIN;
    for (int i = 0; e == ERR_AGAIN && i < 100; i++)
        e = readable(b, st, 1000) ? b->ops->next(st, f) : ERR_TIMEOUT;
    return e;
}

static void test_open_close_twice(const struct backend *b)
{
    char unit[CAMERA_UNIT_CAP];
    for (int i = 0; i < 2; i++) {
        struct camera_info info;
        struct frame f;
        void *st = open_camera(b, "");
        b->ops->info(st, &info);
        assert_true(info.w == SIZE && info.h == SIZE);
        assert_int_equal(info.stride, 3 * SIZE + (b->kernel ? 8 : 0));
        assert_int_equal(info.format, CAMERA_RGB8);
        assert_true(info.buffers == 4 && info.period_s > 0.0);
        assert_true(b->kernel ? info.exposure_delay == -1 : info.exposure_delay >= 1);
        assert_true(info.time_min_s > 0.0 && info.time_max_s >= info.time_min_s);
        assert_true(info.unit[0] && !strpbrk(info.unit, " \t\n"));
        assert_true(b->kernel || strncmp(info.unit, b->ops->name, strlen(b->ops->name)) == 0);
        if (i == 0)
            memcpy(unit, info.unit, sizeof unit);
        assert_string_equal(info.unit, unit); // the same after reopening
        assert_int_equal(wait_frame(b, st, &f), OK);
        assert_true(f.w == SIZE && f.h == SIZE && f.bytes == (size_t)(SIZE * info.stride) &&
                    f.data);
        assert_true(f.format == CAMERA_RGB8 && f.flags == 0 && f.stride == info.stride);
        if (i == 0)
            b->ops->release(st, &f); // the second time it is closed with a frame out
        close_camera(b, st);
    }
}

/* What made the frame, as it says, or as the fake kernel writes into it. */
static double time_of(const struct backend *b, const struct frame *f)
{
    int32_t code;
    memcpy(&code, f->data, sizeof code);
    assert_true(f->exposure_known == !b->kernel);
    return b->kernel ? code * 1e-4 : f->exposure.time_s;
}

/* Without focus=once nothing is searched. */
static void test_focus(const struct backend *b)
{
    void *st = open_camera(b, "");
    for (int again = 0; again < 2; again++)
        assert_true(!b->ops->focus || b->ops->focus(st, again) == OK);
    close_camera(b, st);
}

/* Frames show a request from the promised one on, and say so. */
static void test_request(const struct backend *b)
{
    struct camera_info info;
    struct frame f;
    void *st = open_camera(b, ",clock=virtual,delay=3");
    b->ops->info(st, &info);
    assert_int_equal(info.exposure_delay, b->kernel ? -1 : 3);
    assert_int_equal(wait_frame(b, st, &f), OK);
    for (int i = 0; i < 3 * TIMES; i++) {
        struct exposure requested = {b->times[(i + 2) % TIMES], 1.0}, set = {0};
        uint32_t runs = f.sequence + 1;
        b->ops->release(st, &f);
        assert_true(f.data == NULL && f.bytes == 0);
        assert_int_equal(b->ops->request(st, &requested, &set), OK);
        assert_true(fabs(set.time_s / requested.time_s - 1.0) < 1e-6 && set.gain == 1.0);
        for (int k = 0; k <= 3; k++) {
            if (k > 0)
                b->ops->release(st, &f);
            assert_int_equal(wait_frame(b, st, &f), OK);
            assert_int_equal(f.sequence, runs + (uint32_t)k);
            bool shows = fabs(time_of(b, &f) / requested.time_s - 1.0) < 1e-6;
            assert_true(shows == (k == 3));
        }
    }
    close_camera(b, st);
}

static void test_wrong_requests(const struct backend *b)
{
    static const struct exposure bad[] = {{0.0, 1.0},  {-1.0, 1.0},     {NAN, 1.0},
                                          {0.01, 0.0}, {INFINITY, 1.0}, {0.01, NAN}};
    struct exposure set = {7.0, 7.0};
    void *st = open_camera(b, "");
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        assert_int_equal(b->ops->request(st, &bad[i], &set), ERR_ARG);
    assert_true(set.time_s == 7.0 && set.gain == 7.0);
    struct camera_info info;
    b->ops->info(st, &info);
    assert_int_equal(b->ops->request(st, &(struct exposure){1e-12, 0.1}, &set), OK);
    assert_true(set.time_s >= info.time_min_s * 0.999 && set.gain >= 1.0);
    assert_int_equal(b->ops->request(st, &(struct exposure){1e12, 1e9}, &set), OK);
    assert_true(set.time_s <= info.time_max_s * 1.001 && set.gain <= info.gain_max);
    close_camera(b, st);
}

/* A stalled camera says nothing, and next does not wait. */
static void test_timeout(const struct backend *b)
{
    struct frame f;
    void *st = open_camera(b, ",faults=at frame 2 stall 0");
    for (int i = 0; i < 2; i++) {
        assert_int_equal(wait_frame(b, st, &f), OK);
        b->ops->release(st, &f);
    }
    while (readable(b, st, 20)) // may be in vain, but not for ever
        assert_int_equal(b->ops->next(st, &f), ERR_AGAIN);
    assert_int_equal(b->ops->next(st, &f), ERR_AGAIN);
    assert_true(f.data == NULL);
    close_camera(b, st);
}

static void test_unplug(const struct backend *b)
{
    struct frame f, kept;
    struct exposure requested = {0.01, 1.0}, set;
    void *st = open_camera(b, ",clock=virtual,faults=at frame 2 unplug");
    assert_int_equal(wait_frame(b, st, &kept), OK);
    assert_int_equal(wait_frame(b, st, &f), OK);
    b->ops->release(st, &f);
    assert_int_equal(wait_frame(b, st, &f), ERR_LOST);
    assert_true(readable(b, st, 0) && f.data == NULL);
    assert_int_equal(b->ops->next(st, &f), ERR_LOST);
    assert_int_equal(b->ops->request(st, &requested, &set), ERR_LOST);
    b->ops->release(st, &kept); // still the caller's
    close_camera(b, st);
    st = open_camera(b, "");
    assert_int_equal(wait_frame(b, st, &f), OK);
    close_camera(b, st);
}

/* The device node goes and comes back. */
static void test_node(const struct backend *b)
{
    struct frame f;
    char options[600];
    void *st;
    snprintf(options, sizeof options, ",node=%s", tmpdir_path("node"));
    assert_int_equal(try_open(b, options, &st), ERR_LOST);
    tmpdir_text("node", "");
    st = open_camera(b, options);
    assert_int_equal(wait_frame(b, st, &f), OK);
    remove(tmpdir_path("node"));
    assert_int_equal(wait_frame(b, st, &f), ERR_LOST);
    close_camera(b, st);
}

/* Who holds all buffers gets no frame, and sees later what was lost. */
static void test_no_buffers(const struct backend *b)
{
    for (int virtual = 0; virtual < 2; virtual ++) {
        struct frame f[4], more;
        void *st = open_camera(b, virtual ? ",clock=virtual" : "");
        for (int i = 0; i < 4; i++) {
            assert_int_equal(wait_frame(b, st, &f[i]), OK);
            for (int k = 0; k < i; k++)
                assert_true(f[k].data != f[i].data && f[k].sequence < f[i].sequence);
        }
        for (int i = 0; i < 3; i++) {
            readable(b, st, 6);
            assert_int_equal(b->ops->next(st, &more), ERR_AGAIN);
        }
        b->ops->release(st, &f[1]);
        assert_int_equal(wait_frame(b, st, &more), OK);
        assert_true(more.sequence > f[3].sequence + 1);
        b->ops->release(st, &more);
        b->ops->release(st, &more); // a zeroed one
        close_camera(b, st);
    }
}

/* Who comes late finds the oldest frames and a gap behind them: nothing is dropped in silence. */
static void test_slow_reader(const struct backend *b)
{
    struct frame f;
    void *st = open_camera(b, "");
    nanosleep(&(struct timespec){.tv_nsec = 100000000}, NULL);
    for (uint32_t i = 0; i < 5; i++) {
        assert_int_equal(wait_frame(b, st, &f), OK);
        assert_true(i < 4 ? f.sequence == i : f.sequence > 6);
        b->ops->release(st, &f);
    }
    close_camera(b, st);
}

/* Real time: frames come at the rate that info tells, stamped with CLOCK_MONOTONIC. */
static void test_rate(const struct backend *b)
{
    struct frame f;
    struct camera_info info;
    struct exposure set;
    struct timespec t;
    void *st = open_camera(b, "");
    int64_t last = 0;
    uint32_t sequence = 0;
    b->ops->info(st, &info);
    assert_int_equal(b->ops->request(st, &(struct exposure){b->times[0], 1.0}, &set), OK);
    for (int i = 0; i < 4; i++) { // the first ones may be longer
        assert_int_equal(wait_frame(b, st, &f), OK);
        last = f.timestamp_ns;
        sequence = f.sequence;
        b->ops->release(st, &f);
    }
    for (int i = 0; i < 20; i++) {
        assert_int_equal(wait_frame(b, st, &f), OK);
        double step = (double)(f.timestamp_ns - last) * 1e-9 / (f.sequence - sequence);
        assert_true(fabs(step - info.period_s) < 1e-3);
        last = f.timestamp_ns;
        sequence = f.sequence;
        b->ops->release(st, &f);
    }
    clock_gettime(CLOCK_MONOTONIC, &t);
    double late = (double)t.tv_sec + 1e-9 * (double)t.tv_nsec - (double)last * 1e-9;
    assert_true(late > 0.0 && late < 60.0); // a busy machine is late, no camera is early
    close_camera(b, st);
}

static void test_refused_wishes(const struct backend *b)
{
    static const struct {
        const char *options, *says;
        err_t code;
    } bad[] = {
        {",fps=0", "fps is \"0\", not a number in 0.01..1000", ERR_ARG},
        {",fps=", "fps is \"\"", ERR_ARG},
        {",fps=1e400", "fps is", ERR_ARG},
        {",fps=10x", "fps is \"10x\"", ERR_ARG},
        {",delay=1.5", "delay is \"1.5\", not a whole number in 1..32", ERR_ARG},
        {",delay=2,delay=2", "delay is given twice", ERR_ARG},
        {",clock=slow", "clock is \"slow\", not one of real|virtual", ERR_ARG},
        {",clock=rea", "clock is \"rea\"", ERR_ARG},
        {",colour=red", "no option is called \"colour\"", ERR_ARG},
        {",delay", "\"delay\" is not name=value", ERR_ARG},
        {",=3", "no option is called \"\"", ERR_ARG},
        {",faults=at frame 1 melt", "line 1: no fault is called \"melt\"", ERR_FORMAT},
        {",faults=/nowhere/x", "/nowhere/x", ERR_IO},
        {",truth=/nowhere/x", "/nowhere/x", ERR_IO},
    };
    void *st;
    for (size_t i = 0; i < sizeof bad / sizeof bad[0] && !b->kernel; i++) {
        assert_int_equal(try_open(b, bad[i].options, &st), bad[i].code);
        if (!strstr(err_text(), bad[i].says))
            print_message("%s: %s\n", bad[i].options, err_text());
        assert_non_null(strstr(err_text(), bad[i].says));
    }
    struct camera_cfg cfg = {.uri = b->uri, .w = SIZE + 1};
    st = malloc(b->ops->state_bytes);
    assert_non_null(st);
    assert_int_equal(b->ops->open(st, &cfg), ERR_UNSUPPORTED);
    cfg = (struct camera_cfg){.uri = b->uri, .format = CAMERA_NV12};
    assert_int_equal(b->ops->open(st, &cfg), ERR_UNSUPPORTED);
    cfg = (struct camera_cfg){.uri = b->uri, .buffers = CAMERA_BUFFERS_MAX + 1};
    assert_int_equal(b->ops->open(st, &cfg), ERR_ARG);
    cfg = (struct camera_cfg){.uri = "other:/dev/video0"};
    assert_int_equal(b->ops->open(st, &cfg), ERR_ARG);
    free(st);
}

#define EACH(test)                                                                                 \
    static void test##_each(void **state)                                                          \
    {                                                                                              \
        (void)state;                                                                               \
        for (int b = 0; b < BACKENDS; b++)                                                         \
            test(&backends[b]);                                                                    \
    }
EACH(test_open_close_twice)
EACH(test_focus)
EACH(test_request)
EACH(test_wrong_requests)
EACH(test_timeout)
EACH(test_unplug)
EACH(test_node)
EACH(test_no_buffers)
EACH(test_slow_reader)
EACH(test_rate)
EACH(test_refused_wishes)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open_close_twice_each),
        cmocka_unit_test(test_focus_each),
        cmocka_unit_test(test_request_each),
        cmocka_unit_test(test_wrong_requests_each),
        cmocka_unit_test(test_timeout_each),
        cmocka_unit_test(test_unplug_each),
        cmocka_unit_test(test_node_each),
        cmocka_unit_test(test_no_buffers_each),
        cmocka_unit_test(test_slow_reader_each),
        cmocka_unit_test(test_rate_each),
        cmocka_unit_test(test_refused_wishes_each),
    };
    return cmocka_run_group_tests(tests, set_up, tmpdir_teardown);
}
