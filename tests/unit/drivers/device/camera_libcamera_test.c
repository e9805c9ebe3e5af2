/* The backend of libcamera over two releases of it that are played (fakecamera): what a program
 * sees of it, and that libcamera sees no call that it forbids. */
#include "drivers/device/camera.h"

#include "tests/unit/drivers/device/fakecamera/fakecamera.h"
#include "tests/unit/tmpdir.h"

#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <math.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

enum { OLD, NEW, RELEASES }; // 0.0.3, 0.7.2

static struct fakecamera *fake;
static void (*put)(int *field, int value);
static char module_path[RELEASES][512];

static const struct fakecamera usual = {
    .n_cameras = 2,
    .id = {"/base/i2c/imx477@1a", "/base/i2c/imx219@10", "usb-0:1.0-c45:6a14"},
    .model = {"imx477", "imx219", "HD webcam"},
    .delay = 2,
};

/* A release with that behaviour. */
static void play(int release, const struct fakecamera *how)
{
    void *lib = dlopen(module_path[release], RTLD_NOW);
    if (!lib)
        print_message("%s\n", dlerror());
    assert_non_null(lib);
    fake = dlsym(lib, FAKECAMERA_SYMBOL);
    *(void **)&put = dlsym(lib, FAKECAMERA_PUT);
    assert_true(fake && put);
    *fake = *how;
}

static err_t try_open(int release, const char *rest, const struct camera_cfg *wanted, void **st)
{
    char uri[1024];
    struct camera_cfg cfg = *wanted;
    snprintf(uri, sizeof uri, "libcamera:%s,module=%s", rest, module_path[release]);
    cfg.uri = uri;
    *st = malloc(camera_libcamera.state_bytes);
    assert_non_null(*st);
    memset(*st, 0xA5, camera_libcamera.state_bytes);
    err_t e = camera_libcamera.open(*st, &cfg);
    if (e)
        free(*st);
    return e;
}

static void *open_camera(int release, const char *rest, enum camera_format format)
{
    void *st;
    err_t e = try_open(release, rest, &(struct camera_cfg){.format = format}, &st);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
    return st;
}

/* Nothing is left, and nothing was forbidden. */
static void check_clean(void)
{
    if (fake->wrong)
        print_message("libcamera: %s\n", fake->what);
    assert_int_equal(fake->wrong, 0);
    assert_int_equal(fake->managers, 0);
    assert_int_equal(fake->acquired, 0);
    assert_int_equal(fake->buffers, 0);
    assert_int_equal(fake->running, 0);
}

static void close_camera(void *st)
{
    camera_libcamera.close(st);
    free(st);
}

static void refuse(int release, const char *rest, const struct camera_cfg *wanted, err_t code,
                   const char *says)
{
    void *st;
    err_t e = try_open(release, rest, wanted, &st);
    if (e != code || !strstr(err_text(), says))
        print_message("%d: %s\n", e, err_text());
    assert_int_equal(e, code);
    assert_non_null(strstr(err_text(), says));
    check_clean();
}

static bool readable(const void *st, int ms)
{
    struct pollfd p = {.fd = camera_libcamera.fd(st), .events = POLLIN};
    return poll(&p, 1, ms) == 1;
}

static err_t wait_frame(void *st, struct frame *f)
{
    err_t e = ERR_AGAIN;
    for (int i = 0; e == ERR_AGAIN && i < 100; i++)
        e = readable(st, 2000) ? camera_libcamera.next(st, f) : ERR_TIMEOUT;
    return e;
}

/* Shutter times gain, as the picture itself has it, s. */
static double light(const struct frame *f)
{
    double us;
    memcpy(&us, f->data, sizeof us);
    return us * 1e-6;
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void test_info(int release)
{
    struct camera_info info;
    play(release, &usual);
    void *st = open_camera(release, "imx477", CAMERA_NV12);
    camera_libcamera.info(st, &info);
    assert_string_equal(info.unit, "imx477:/base/i2c/imx477@1a");
    assert_true(info.w == 8 && info.h == 4 && info.format == CAMERA_NV12 && info.stride == 8);
    assert_true(info.bits == 8 && info.black == 0 && info.buffers == 4 && info.reports);
    assert_true(fabs(info.time_min_s - 75e-6) < 1e-12 && fabs(info.time_max_s - 1.5) < 1e-9);
    assert_true(info.gain_max == 16.0 && fabs(info.period_s - 0.02) < 1e-9);
    assert_true(info.exposure_delay == -1 && info.gain_delay == -1 && info.time_step_s == 0.0);
    assert_true(info.limited && info.bt709 && info.stamp == CAMERA_STAMP_END);
    assert_int_equal(fake->frozen, release == OLD ? 2 : 4); // AfMode has no manual here
    assert_true(fake->frame_us[0] == 20000 && fake->frame_us[1] == 1500000);
    close_camera(st);
    st = open_camera(release, "imx219,stamp=start", CAMERA_RGGB16);
    camera_libcamera.info(st, &info);
    assert_true(info.format == CAMERA_RGGB16 && info.bits == 12 && info.black == 256);
    assert_true(info.stride == 16 && info.stamp == CAMERA_STAMP_START);
    struct frame f;
    assert_int_equal(wait_frame(st, &f), OK);
    assert_true(f.exposure_known && f.gains_known && f.gains_later); // the ISP is behind them
    assert_true(f.digital_gain == 1.25 && f.red_gain == 2.0 && f.blue_gain == 1.5);
    close_camera(st);
    st = open_camera(release, "imx477", CAMERA_ANY); // colour in full first
    camera_libcamera.info(st, &info);
    assert_true(info.format == CAMERA_RGB8 && info.stride == 24);
    close_camera(st);
    check_clean();
}

/* Every frame says what its picture was exposed with; a request arrives. */
static void test_request(int release)
{
    static const double times[] = {0.001, 0.1, 0.0123456789, 1e-9, 10.0};
    static const double sets[] = {0.001, 0.1, 0.012345, 75e-6, 1.5};
    struct frame f;
    struct exposure set;
    int64_t last = 0;
    play(release, &usual);
    void *st = open_camera(release, "imx477", CAMERA_NV12);
    for (int i = 0; i < 5; i++) {
        double gain = i % 2 ? 100.0 : 2.0;
        struct exposure requested = {times[i], gain};
        assert_int_equal(camera_libcamera.request(st, &requested, &set), OK);
        assert_true(fabs(set.time_s - sets[i]) < 1e-9 && set.gain == fmin(gain, 16.0));
        int n = 0;
        for (bool shows = false; !shows; n++) {
            assert_true(n < 20);
            assert_int_equal(wait_frame(st, &f), OK);
            assert_true(f.exposure_known && f.gains_known && !f.gains_later && f.flags == 0);
            assert_true(fabs(f.exposure.time_s * f.exposure.gain - light(&f)) < 1e-9);
            assert_true(f.digital_gain == 1.25 && f.red_gain == 2.0 && f.blue_gain == 1.5);
            assert_true(f.bytes == 48 && f.w == 8 && f.h == 4 && f.stride == 8);
            assert_true(f.timestamp_ns > last && f.timestamp_ns <= now_ns());
            last = f.timestamp_ns;
            shows = fabs(light(&f) - set.time_s * set.gain) < 1e-9;
            camera_libcamera.release(st, &f);
            assert_true(f.data == NULL && f.bytes == 0);
        }
    }
    set.time_s = 7.0;
    static const struct exposure bad[] = {{0, 1}, {-1, 1}, {NAN, 1}, {INFINITY, 1}, {1, 0}};
    for (int i = 0; i < 5; i++)
        assert_int_equal(camera_libcamera.request(st, &bad[i], &set), ERR_ARG);
    assert_true(set.time_s == 7.0);
    close_camera(st);
    check_clean();
}

/* A webcam says nothing of its frames and cuts exposures to 100 us; its gain is no factor. */
static void test_usb(int release)
{
    struct fakecamera how = usual;
    struct camera_info info;
    struct exposure set;
    struct frame f;
    how.usb = true;
    play(release, &how);
    void *st = open_camera(release, "imx219", CAMERA_ANY);
    camera_libcamera.info(st, &info);
    assert_true(!info.reports && info.gain_max == 1.0 && fabs(info.time_step_s - 1e-4) < 1e-12);
    assert_true(info.format == CAMERA_YUYV && info.period_s > 5e-4 && info.period_s < 1.0);
    assert_int_equal(camera_libcamera.request(st, &(struct exposure){0.01239, 8.0}, &set), OK);
    assert_true(fabs(set.time_s - 0.0123) < 1e-12 && set.gain == 1.0);
    for (int i = 0; i < 10; i++) {
        assert_int_equal(wait_frame(st, &f), OK);
        assert_true(!f.exposure_known && !f.gains_known);
        if (i < 9)
            camera_libcamera.release(st, &f);
    }
    assert_true(fabs(light(&f) - 0.0123) < 1e-9);
    close_camera(st); // with a frame out
    check_clean();
    refuse(release, "imx219", &(struct camera_cfg){.format = CAMERA_RGGB16}, ERR_UNSUPPORTED,
           "no stream of the kind");
    how.uncontrolled = true;
    play(release, &how);
    st = open_camera(release, "imx219", CAMERA_MJPG);
    camera_libcamera.info(st, &info);
    assert_true(info.stride == 0 && info.time_min_s > 5e-4 && info.time_max_s == info.period_s);
    assert_int_equal(camera_libcamera.request(st, &set, &set), ERR_UNSUPPORTED);
    close_camera(st);
    check_clean();
}

/* Frames in a stream are bad, short, cancelled; the stream goes on. */
static void test_bad_frames(int release)
{
    struct frame f;
    play(release, &usual);
    void *st = open_camera(release, "imx477", CAMERA_ANY);
    int errors = 0, shorts = 0, cancelled = 0, good = 0;
    put(&fake->bad, 1);
    put(&fake->cut, 2);
    for (int i = 0; i < 30; i++) {
        if (i == 15 || i == 22)
            put(&fake->cancel, 3); // never more than there are buffers in a row
        err_t e = wait_frame(st, &f);
        if (e) {
            assert_int_equal(e, ERR_IO);
            assert_non_null(strstr(err_text(), "a frame was cancelled"));
            assert_null(f.data);
            cancelled++;
            continue;
        }
        errors += f.flags & FRAME_ERROR ? 1 : 0;
        shorts += f.flags & FRAME_SHORT ? 1 : 0;
        good += f.flags == 0;
        camera_libcamera.release(st, &f);
    }
    assert_true(errors == 1 && shorts == 2 && cancelled == 6 && good >= 20);
    put(&fake->cancel, 100); // a stream that has stalled
    err_t e = OK;
    for (int i = 0; i < 20 && e != ERR_LOST; i++) {
        e = wait_frame(st, &f);
        camera_libcamera.release(st, &f);
    }
    assert_int_equal(e, ERR_LOST);
    assert_non_null(strstr(err_text(), "has stalled"));
    close_camera(st);
    check_clean();
}

/* Unplugged with frames in the caller's hands. */
static void test_unplug(int release)
{
    struct frame f, kept;
    struct exposure requested = {0.01, 1.0};
    play(release, &usual);
    for (int i = 0; i < 20; i++) {
        void *st = open_camera(release, "imx477", CAMERA_ANY);
        assert_int_equal(wait_frame(st, &kept), OK);
        put(&fake->unplug, 1);
        err_t e;
        while ((e = wait_frame(st, &f)) == OK || e == ERR_IO)
            camera_libcamera.release(st, &f);
        assert_int_equal(e, ERR_LOST);
        assert_non_null(strstr(err_text(), "/base/i2c/imx477@1a: the camera has gone"));
        assert_true(f.data == NULL && readable(st, 0));
        assert_int_equal(camera_libcamera.next(st, &f), ERR_LOST);
        assert_int_equal(camera_libcamera.request(st, &requested, &requested), ERR_LOST);
        assert_true(light(&kept) > 0.0); // still there
        camera_libcamera.release(st, &kept);
        assert_true(readable(st, 0)); // for ever
        close_camera(st);
        check_clean();
        put(&fake->unplug, 0);
    }
    void *st = open_camera(release, "imx477", CAMERA_ANY);
    for (int i = 0; i < 4; i++)
        assert_int_equal(wait_frame(st, &f), OK);
    assert_int_equal(camera_libcamera.next(st, &kept), ERR_AGAIN);
    assert_false(readable(st, 0));
    put(&fake->fail_queue, EINVAL);
    camera_libcamera.release(st, &f); // cannot say it
    assert_true(readable(st, 0));
    assert_int_equal(camera_libcamera.next(st, &f), ERR_LOST);
    assert_non_null(strstr(err_text(), strerror(EINVAL)));
    close_camera(st);
    check_clean();
}

static void test_all_held(int release)
{
    struct frame f[4], more;
    play(release, &usual);
    void *st = open_camera(release, "imx477", CAMERA_ANY);
    for (int i = 0; i < 4; i++) {
        assert_int_equal(wait_frame(st, &f[i]), OK);
        for (int k = 0; k < i; k++)
            assert_true(f[k].data != f[i].data && f[k].sequence < f[i].sequence);
    }
    for (int i = 0; i < 3; i++) {
        readable(st, 5);
        assert_int_equal(camera_libcamera.next(st, &more), ERR_AGAIN);
    }
    assert_false(readable(st, 5));
    camera_libcamera.release(st, &f[2]);
    assert_int_equal(wait_frame(st, &more), OK);
    assert_true(more.index == 2 || more.data != f[0].data);
    camera_libcamera.release(st, &more);
    camera_libcamera.release(st, &more); // a zeroed one
    close_camera(st);
    check_clean();
}

/* One manager for the whole rig. */
static void test_rig(int release)
{
    struct fakecamera how = usual;
    struct frame f;
    void *st[3];
    how.n_cameras = 3;
    play(release, &how);
    for (int round = 0; round < 2; round++) {
        for (int i = 0; i < 3; i++)
            st[i] = open_camera(release, usual.id[i], CAMERA_ANY);
        assert_int_equal(fake->managers, 1);
        for (int i = 0; i < 30; i++) {
            assert_int_equal(wait_frame(st[i % 3], &f), OK);
            camera_libcamera.release(st[i % 3], &f);
        }
        void *second;
        struct camera_cfg wanted = {0};
        assert_int_equal(try_open(release, "imx477", &wanted, &second), ERR_BUSY);
        for (int i = 0; i < 3; i++)
            close_camera(st[i]);
        check_clean();
    }
}

static void test_refusals(int release)
{
    static const struct camera_cfg any = {0};
    struct fakecamera how = usual;
    play(release, &how);
    refuse(release, "imx", &any, ERR_ARG, "\"imx\" means 2 cameras of: /base/i2c/imx477@1a, /base");
    refuse(release, "", &any, ERR_ARG, "means 2 cameras");
    refuse(release, "ov5647", &any, ERR_LOST, "no camera is called \"ov5647\"; there are: /base");
    refuse(release, "imx477,stamp=middle", &any, ERR_ARG, "not one of start|end");
    refuse(release, "imx477", &(struct camera_cfg){.buffers = 33}, ERR_ARG, "33 buffers");
    refuse(release, "imx477", &(struct camera_cfg){.format = CAMERA_YUYV}, ERR_UNSUPPORTED,
           "which is not the request");
    how.n_cameras = 0;
    play(release, &how);
    refuse(release, "imx477", &any, ERR_LOST, "libcamera-ipa");
    how = usual;
    how.smaller = true;
    play(release, &how);
    refuse(release, "imx477", &(struct camera_cfg){.w = 8, .h = 4}, ERR_UNSUPPORTED, "gives 4x4");
    how = usual;
    how.unknown_format = true;
    play(release, &how);
    refuse(release, "imx477", &any, ERR_UNSUPPORTED, "nor a format that this program reads");
    how = usual;
    how.invalid = true;
    play(release, &how);
    refuse(release, "imx477", &any, ERR_UNSUPPORTED, "refuses the size or format");
    how = usual;
    how.apart = true;
    play(release, &how);
    refuse(release, "imx477", &(struct camera_cfg){.format = CAMERA_NV12}, ERR_UNSUPPORTED,
           "plane 1 of a buffer lies apart");
}

static void test_focus(int release)
{
    static const struct camera_cfg any = {0};
    struct fakecamera how = usual;
    play(release, &how);
    refuse(release, "imx477,focus=2", &any, ERR_UNSUPPORTED, "imx477@1a: its focus is fixed");
    refuse(release, "imx477,focus=once", &any, ERR_UNSUPPORTED, "imx477@1a: its focus is fixed");
    refuse(release, "imx477,focus=auto", &any, ERR_ARG, "one geometry: use focus=once");
    refuse(release, "imx477,focus=near", &any, ERR_ARG, "neither once nor a number in 0..1000");
    how.lens = true;
    play(release, &how);
    refuse(release, "imx477,focus=once", &any, ERR_UNSUPPORTED,
           "imx477@1a: cannot search its focus: give a position in 0..10");
    refuse(release, "imx477,focus=10.5", &any, ERR_ARG, "focus=10.5 is outside of its 0..10");
    void *st = open_camera(release, "imx477,focus=2.5", CAMERA_ANY);
    assert_true(fake->focus == 2.5);
    assert_int_equal(camera_libcamera.focus(st, true), OK); // it stands
    close_camera(st);
    st = open_camera(release, "imx477", CAMERA_ANY); // stays where it stands
    assert_true(fake->focus < 0.0);
    close_camera(st);
    check_clean();
}

/* Frames that begin with those of others have one length, so exposures fit into it. */
static void test_sync(int release)
{
    static const struct camera_cfg any = {0};
    static const char *const words[] = {"off", "server", "client", "wired"};
    struct fakecamera how = usual;
    play(release, &how);
    refuse(release, "imx477,sync=server", &any, ERR_UNSUPPORTED,
           "imx477@1a has no control SyncMode");
    refuse(release, "imx477,sync=both", &any, ERR_ARG, "sync");
    how.syncs = true;
    play(release, &how);
    for (int k = 0; k < 4; k++) {
        struct camera_info info;
        char rest[64];
        if (release == OLD && (k == 1 || k == 2))
            continue;
        snprintf(rest, sizeof rest, "imx477,sync=%s", words[k]);
        void *st = open_camera(release, rest, CAMERA_ANY);
        camera_libcamera.info(st, &info);
        assert_int_equal(fake->sync, k % 3);
        assert_int_equal(fake->frame_us[1], k ? 20000 : 1500000);
        assert_true(fabs(info.time_max_s - (k ? 0.02 : 1.5)) < 1e-6);
        close_camera(st);
    }
    check_clean();
}

/* Searches to its end; frames come meanwhile. */
static err_t search(void *st, bool again)
{
    struct frame f;
    err_t e = camera_libcamera.focus(st, again);
    while (e == ERR_AGAIN) {
        if (wait_frame(st, &f) == OK)
            camera_libcamera.release(st, &f);
        e = camera_libcamera.focus(st, false);
    }
    return e;
}

static double lens_of_frames(void *st, int skip)
{
    struct frame f = {0};
    for (int i = 0; i <= skip; i++) {
        camera_libcamera.release(st, &f);
        assert_int_equal(wait_frame(st, &f), OK);
    }
    double lens = f.lens_known ? f.lens : NAN;
    camera_libcamera.release(st, &f);
    return lens;
}

/* Searched when asked to, and then the lens is frozen. */
static void test_focus_once(int release)
{
    struct fakecamera how = usual;
    how.lens = true;
    how.search = 12;
    play(release, &how);
    void *st = open_camera(release, "imx477,focus=once", CAMERA_ANY);
    assert_true(fake->searches == 0 && fake->focus < 0.0 && lens_of_frames(st, 0) == 1.0);
    assert_int_equal(search(st, false), OK);
    assert_true(lens_of_frames(st, 9) == 3.25 && fake->focus == 3.25);
    assert_int_equal(camera_libcamera.focus(st, false), OK);
    assert_int_equal(fake->searches, 1);
    put(&fake->nudge, -2);
    assert_true(fabs(lens_of_frames(st, 9) - 3.05) < 1e-6); // what the device says
    put(&fake->nudge, 0);
    put(&fake->cancel, 3); // perhaps the frame of the trigger
    assert_int_equal(search(st, true), OK);
    assert_true(fake->searches >= 2 && lens_of_frames(st, 9) == 3.25);
    close_camera(st);
    how.in_vain = true;
    play(release, &how);
    st = open_camera(release, "imx477,focus=once", CAMERA_ANY);
    for (int i = 1; i <= 2; i++) {
        assert_int_equal(search(st, false), ERR_TIMEOUT);
        assert_non_null(strstr(err_text(), "imx477@1a: found no focus"));
        assert_int_equal(fake->searches, i); // each time anew
    }
    put(&fake->unplug, 1);
    struct frame f;
    while (wait_frame(st, &f) != ERR_LOST)
        camera_libcamera.release(st, &f);
    assert_int_equal(camera_libcamera.focus(st, true), ERR_LOST);
    close_camera(st);
    how = usual;
    how.lens = true;
    how.search = 1 << 30; // for ever
    play(release, &how);
    st = open_camera(release, "imx477,focus=once", CAMERA_ANY);
    assert_int_equal(camera_libcamera.focus(st, false), ERR_AGAIN);
    put(&fake->silent, 1);
    err_t e = ERR_AGAIN;
    for (int i = 0; i < 10 && e == ERR_AGAIN; i++)
        e = camera_libcamera.focus(st, false);
    assert_int_equal(e, ERR_TIMEOUT);
    assert_non_null(strstr(err_text(), "found no focus in 5 s"));
    close_camera(st);
    check_clean();
}

/* Each step of an opening fails. */
static void test_failures(int release)
{
    static const struct {
        size_t at;
        int why;
        err_t code;
        const char *says;
    } fault[] = {
        {offsetof(struct fakecamera, fail_manager), EIO, ERR_IO, "does not start"},
        {offsetof(struct fakecamera, fail_acquire), EBUSY, ERR_BUSY, "used by another program"},
        {offsetof(struct fakecamera, fail_acquire), ENODEV, ERR_LOST, "cannot be had"},
        {offsetof(struct fakecamera, fail_configure), EINVAL, ERR_IO, "cannot be configured"},
        {offsetof(struct fakecamera, fail_allocate), ENOMEM, ERR_NOMEM, "no buffers"},
        {offsetof(struct fakecamera, fail_start), EIO, ERR_IO, "does not start"},
        {offsetof(struct fakecamera, fail_queue), ENODEV, ERR_LOST, "the camera has gone"},
    };
    for (size_t i = 0; i < sizeof fault / sizeof fault[0]; i++) {
        struct fakecamera how = usual;
        memcpy((char *)&how + fault[i].at, &fault[i].why, sizeof(int));
        play(release, &how);
        refuse(release, "imx477", &(struct camera_cfg){0}, fault[i].code, fault[i].says);
    }
    struct fakecamera how = usual;
    how.unplug = 1;
    play(release, &how);
    refuse(release, "imx477", &(struct camera_cfg){0}, ERR_LOST, "the camera has gone");
}

/* Stamps by the book are turned into those of the other devices. */
static void test_clock(int release)
{
    struct fakecamera how = usual;
    struct frame f;
    how.boottime = true;
    play(release, &how);
    void *st = open_camera(release, "imx477", CAMERA_ANY);
    for (int i = 0; i < 10; i++) {
        assert_int_equal(wait_frame(st, &f), OK);
        int64_t age = now_ns() - f.timestamp_ns;
        assert_true(age > -1000000 && age < 10000000000);
        camera_libcamera.release(st, &f);
    }
    close_camera(st);
    check_clean();
}

static int count_lines(const char *path)
{
    int n = 0;
    FILE *f = fopen(path, "r");
    assert_non_null(f);
    for (int c; (c = fgetc(f)) != EOF;)
        n += c == '\n';
    fclose(f);
    return n;
}

static int count_fds(void)
{
    int n = 0;
    DIR *d = opendir("/proc/self/fd");
    while (readdir(d))
        n++;
    closedir(d);
    return n;
}

static void test_no_leak(int release)
{
    play(release, &usual);
    for (int i = 0; i < 10; i++) // what the C library keeps
        close_camera(open_camera(release, "imx477", CAMERA_ANY));
    int fds = count_fds(), maps = count_lines("/proc/self/maps");
    for (int i = 0; i < 60; i++)
        close_camera(open_camera(release, "imx477", CAMERA_ANY));
    assert_int_equal(count_fds(), fds);
    assert_true(count_lines("/proc/self/maps") < maps + 60);
    check_clean();
}

/* Frames that are not to be used are not seen, where libcamera can tell. */
static void test_startup(void **state)
{
    struct fakecamera how = usual;
    struct frame f;
    (void)state;
    how.startup = 7;
    play(NEW, &how);
    void *st = open_camera(NEW, "imx477", CAMERA_ANY);
    assert_int_equal(wait_frame(st, &f), OK);
    assert_true(f.sequence >= 8);
    close_camera(st);
    check_clean();
}

/* No frame within the time of an opening. */
static void test_silent(void **state)
{
    struct fakecamera how = usual;
    (void)state;
    how.silent = true;
    play(OLD, &how);
    refuse(OLD, "imx477", &(struct camera_cfg){0}, ERR_IO, "gave no frame in 5 s");
}

static void test_module(void **state)
{
    void *st = malloc(camera_libcamera.state_bytes);
    char uri[1024];
    (void)state;
    assert_non_null(st);
    struct camera_cfg cfg = {.uri = "libcamera:"};
    assert_int_equal(camera_libcamera.open(st, &cfg), ERR_UNSUPPORTED); // none beside this test
    assert_non_null(strstr(err_text(), "there is no /"));
    assert_non_null(strstr(err_text(), "libcamera-dev"));
    cfg.uri = "libcamera:,module=/nowhere/x.so";
    assert_int_equal(camera_libcamera.open(st, &cfg), ERR_UNSUPPORTED);
    assert_non_null(strstr(err_text(), "/nowhere/x.so"));
    assert_non_null(strstr(err_text(), "libcamera-ipa"));
    cfg.uri = "libcamera:,module=libm.so.6"; // a library, but not ours
    assert_int_equal(camera_libcamera.open(st, &cfg), ERR_UNSUPPORTED);
    assert_non_null(strstr(err_text(), "is no module of this program"));
    snprintf(uri, sizeof uri, "v4l2:,module=%s", module_path[OLD]);
    cfg.uri = uri;
    assert_int_equal(camera_libcamera.open(st, &cfg), ERR_ARG);
    free(st);
}

static int find_modules(void **state)
{
    char self[400];
    ssize_t n = readlink("/proc/self/exe", self, sizeof self - 1);
    (void)state;
    assert_true(n > 0);
    self[n] = '\0';
    *strrchr(self, '/') = '\0';
    snprintf(module_path[OLD], sizeof module_path[OLD], "%s/fakecamera_3.so", self);
    snprintf(module_path[NEW], sizeof module_path[NEW], "%s/fakecamera_72.so", self);
    return 0;
}

#define BOTH(test)                                                                                 \
    static void test##_both(void **state)                                                          \
    {                                                                                              \
        (void)state;                                                                               \
        test(OLD);                                                                                 \
        test(NEW);                                                                                 \
    }
BOTH(test_info)
BOTH(test_request)
BOTH(test_usb)
BOTH(test_bad_frames)
BOTH(test_unplug)
BOTH(test_all_held)
BOTH(test_rig)
BOTH(test_refusals)
BOTH(test_focus)
BOTH(test_sync)
BOTH(test_focus_once)
BOTH(test_failures)
BOTH(test_clock)
BOTH(test_no_leak)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_info_both),     cmocka_unit_test(test_request_both),
        cmocka_unit_test(test_usb_both),      cmocka_unit_test(test_bad_frames_both),
        cmocka_unit_test(test_unplug_both),   cmocka_unit_test(test_all_held_both),
        cmocka_unit_test(test_rig_both),      cmocka_unit_test(test_refusals_both),
        cmocka_unit_test(test_failures_both), cmocka_unit_test(test_clock_both),
        cmocka_unit_test(test_focus_both),    cmocka_unit_test(test_no_leak_both),
        cmocka_unit_test(test_startup),       cmocka_unit_test(test_silent),
        cmocka_unit_test(test_module),        cmocka_unit_test(test_focus_once_both),
        cmocka_unit_test(test_sync_both),
    };
    return cmocka_run_group_tests(tests, find_modules, NULL);
}
