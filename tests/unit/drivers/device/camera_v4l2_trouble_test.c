/* The V4L2 backend when something fails: frames, buffers, every call in turn, the whole device. */
#include "tests/unit/drivers/device/v4l2_rig.h"

#include <dirent.h>

static void start_webcam(void)
{
    fake_uvc(&fake);
    open_ok(webcam);
}

static void fail_calls(unsigned long request, int number, bool on)
{
    fake.calls = 0;
    fake.fail_request = request;
    fake.fail_at = 1;
    fake.fail_on = on;
    fake.fail_errno = number;
}

static void test_bad_frames(void **st)
{
    struct frame f;
    (void)st;
    start_webcam();
    for (int i = 0; i < 12; i++) { // more than there are buffers
        fake.flags = V4L2_BUF_FLAG_ERROR;
        fake_frame(&fake);
        f = take();
        assert_int_equal(f.flags, FRAME_ERROR);
        camera_v4l2.release(state, &f);
        fake.cut = 8; // only the padding of the last row: whole
        fake_frame(&fake);
        f = take();
        assert_true(f.flags == 0 && f.bytes == 136 * 48 - 8);
        camera_v4l2.release(state, &f);
        fake.cut = 9;
        fake_frame(&fake);
        f = take();
        assert_int_equal(f.flags, FRAME_SHORT);
        camera_v4l2.release(state, &f);
        fake.overlong = true; // more bytes than the buffer has
        fake_frame(&fake);
        f = take();
        assert_true(f.flags == (FRAME_ERROR | FRAME_SHORT) && f.bytes == 0);
        camera_v4l2.release(state, &f);
    }
    close_all();
}

static void test_wrong_buffers(void **st)
{
    struct frame f;
    (void)st;
    start_webcam();
    fake.index_add = 4;
    fake_frame(&fake);
    refuses(camera_v4l2.next(state, &f), ERR_IO, "a buffer that it does not own");
    assert_null(f.data);
    fake_frame(&fake);
    f = take(); // once is forgotten
    fake.index_add = UINT32_MAX;
    fake_frame(&fake);
    struct frame g;
    fake.buf[2].b.index = 0;
    fake.index_add = (uint32_t)f.index - 2; // the one that the caller has
    refuses(camera_v4l2.next(state, &g), ERR_IO, "a buffer that it does not own");
    fake.index_add = 77;
    fake_frame(&fake);
    refuses(camera_v4l2.next(state, &g), ERR_IO, "was restarted"); // brings all back
    assert_int_equal(fake.offs, 1);
    assert_int_equal(fake.n_fifo, 3); // all but the one that is held
    camera_v4l2.release(state, &f);
    for (int i = 0; i < 8; i++) {
        fake_frame(&fake);
        f = take();
        camera_v4l2.release(state, &f);
    }
    close_all();
}

static void test_broken_stream(void **st)
{
    struct frame f, kept;
    (void)st;
    start_webcam();
    fake_frame(&fake);
    kept = take();
    uint8_t first = kept.data[0];
    fake.fatal = true;
    refuses(camera_v4l2.next(state, &f), ERR_IO, "Input/output error");
    refuses(camera_v4l2.next(state, &f), ERR_IO, "was restarted");
    assert_true(kept.data[0] == first);
    fake_frame(&fake);
    f = take();
    assert_int_equal(f.sequence, 0);
    camera_v4l2.release(state, &f);
    camera_v4l2.release(state, &kept);
    assert_int_equal(fake.n_fifo, 4);
    fail_calls(VIDIOC_DQBUF, EIO, true); // for good
    err_t e = OK;
    int n = 0;
    while (n++ < 10 && e != ERR_LOST)
        e = camera_v4l2.next(state, &f);
    refuses(e, ERR_LOST, "fails again after its stream was restarted");
    assert_int_equal(n, 5);
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "open it again");
    close_all();
    start_webcam();
    fail_calls(VIDIOC_STREAMON, EIO, true);
    fake.fatal = true;
    assert_int_equal(camera_v4l2.next(state, &f), ERR_IO);
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "cannot be restarted");
    close_all();
}

/* A buffer that the driver does not take back is offered again. */
static void test_refused_buffers(void **st)
{
    struct frame f;
    (void)st;
    start_webcam();
    fake_frame(&fake);
    f = take();
    fail_calls(VIDIOC_QBUF, EINVAL, false);
    camera_v4l2.release(state, &f);
    assert_int_equal(fake.n_fifo, 3);
    assert_int_equal(camera_v4l2.next(state, &f), ERR_AGAIN);
    assert_int_equal(fake.n_fifo, 4);
    fake_frame(&fake);
    f = take();
    fail_calls(VIDIOC_QBUF, EINVAL, true);
    camera_v4l2.release(state, &f);
    refuses(camera_v4l2.next(state, &f), ERR_IO, "does not take its buffers back");
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "cannot be restarted");
    close_all();
}

static void test_gone(void **st)
{
    struct frame f, kept;
    (void)st;
    start_webcam();
    fake_frame(&fake);
    kept = take();
    fake.lost = true;
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "unplugged");
    assert_null(f.data);
    camera_v4l2.release(state, &kept);
    close_all();
    start_webcam();
    fake.source_changed = true;
    fake_frame(&fake);
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "source changed");
    close_all();
    start_webcam(); // noticed by giving back: told by the next call
    fake_frame(&fake);
    kept = take();
    fail_calls(VIDIOC_QBUF, ENODEV, false);
    camera_v4l2.release(state, &kept);
    refuses(camera_v4l2.next(state, &f), ERR_LOST, "unplugged");
    close_all();
}

static void test_stamps(void **st)
{
    static const struct {
        uint32_t flags, then; // for the first buffer; for frames
        enum camera_stamp stamp;
        bool by_clock, known;
    } c[] = {{V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC,
              CAMERA_STAMP_END, false, true},
             {V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE,
              V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE, CAMERA_STAMP_START,
              false, true},
             {V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN, V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN, CAMERA_STAMP_END,
              true, true},
             {V4L2_BUF_FLAG_TIMESTAMP_COPY | V4L2_BUF_FLAG_TSTAMP_SRC_SOE,
              V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, CAMERA_STAMP_END, true, true},
             {V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE,
              V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, CAMERA_STAMP_START, false, false},
             {V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, V4L2_BUF_FLAG_TIMESTAMP_COPY, CAMERA_STAMP_END,
              false, false}};
    (void)st;
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        fake_uvc(&fake);
        memset(fake.driver, 0, sizeof fake.driver);
        fake.stamp_flags = c[i].flags;
        open_ok(webcam);
        assert_int_equal(get_info().stamp, c[i].stamp);
        fake.stamp_flags = c[i].then;
        fake_frame(&fake);
        int64_t then = fake.now_ns;
        fake.now_ns += 12345678;
        struct frame f = take();
        int64_t want = c[i].by_clock ? fake.now_ns : then / 1000 * 1000;
        assert_int_equal(f.timestamp_ns, c[i].known ? want : 0);
        close_all();
    }
    start_webcam();
    fake_frame(&fake);
    fake.buf[0].b.timestamp.tv_sec = INT64_MAX; // would overflow
    struct frame f = take();
    assert_int_equal(f.timestamp_ns, 0);
    close_all();
}

/* ---- everything fails in turn ---- */

/* With a lens of its own that searches. */
static void fake_search_raw(struct fake *f)
{
    fake_raw(f);
    fake_add_search(f);
    f->lens = true;
}

enum { KINDS = 4 };
static void (*const kinds[KINDS])(struct fake *) = {fake_uvc, fake_mplane, fake_raw,
                                                    fake_search_raw};

static const char *uri_of(int kind)
{
    static const char *const uris[KINDS] = {
        webcam, webcam, sensor,
        "v4l2:/dev/fake,subdev=/dev/fake-subdev0,lens=/dev/lens,focus=once"};
    return uris[kind];
}

/* Open, a search, frames, requests, close. Every result must be one that the contract names. */
static err_t scenario(int kind)
{
    err_t e = open_uri(uri_of(kind));
    if (e) {
        assert_true(e == ERR_UNSUPPORTED || e == ERR_LOST || e == ERR_BUSY || e == ERR_IO ||
                    e == ERR_NOMEM);
        return e;
    }
    struct frame f, kept = {0};
    do
        e = camera_v4l2.focus(state, false);
    while (e == ERR_AGAIN);
    assert_true(e == OK || e == ERR_TIMEOUT || e == ERR_LOST || e == ERR_BUSY || e == ERR_IO);
    for (int i = 0; i < 6; i++) {
        struct exposure set = {7.0, 7.0};
        struct fake_control *vblank = fake_control(&fake, V4L2_CID_VBLANK);
        int64_t code = fake_code(&fake), lines = vblank ? vblank->value : 0;
        err_t r =
            camera_v4l2.request(state, &(struct exposure){i % 2 ? 0.001 : 0.2, 1.0 + i}, &set);
        assert_true(r == OK ? set.time_s > 0.0 && set.gain >= 1.0 && set.time_s < 2.0
                            : set.time_s == 7.0 && r != ERR_AGAIN && r != ERR_NOMEM);
        if (r && !fake.fail_on && !fake.lost) // coming frames are as before
            assert_true(fake_code(&fake) == code && (!vblank || vblank->value == lines));
        fake_frame(&fake);
        err_t n = camera_v4l2.next(state, &f);
        assert_true(n == OK || n == ERR_AGAIN || n == ERR_IO || n == ERR_LOST);
        assert_true((n == OK) == (f.data != NULL));
        e = r ? r : n ? n : e;
        if (i == 2)
            kept = f;
        else
            camera_v4l2.release(state, &f);
    }
    camera_v4l2.release(state, &kept);
    camera_v4l2.close(state);
    return e;
}

/* Call `at` of the scenario fails: once, or from then on. */
static bool disturbed(int kind, long at, int number, bool on)
{
    kinds[kind](&fake);
    fake.fail_at = at;
    fake.fail_errno = number;
    fake.fail_on = on;
    err_t e = scenario(kind);
    assert_true(number != EINTR || on || e == OK);
    nothing_left();
    return e != OK;
}

static void test_every_call_fails(void **st)
{
    static const int numbers[] = {EIO,   ENODEV, EINVAL, EBUSY,  EACCES, ENOMEM,
                                  EINTR, EAGAIN, ENOTTY, ERANGE, ENOSPC, EPIPE};
    size_t n = sizeof numbers / sizeof numbers[0];
    int runs = 0, refused = 0;
    (void)st;
    for (int kind = 0; kind < KINDS; kind++) {
        kinds[kind](&fake);
        assert_int_equal(scenario(kind), OK);
        long calls = fake.calls;
        for (long at = 1; at <= calls; at++)
            for (size_t k = 0; k < 2 * n; k++, runs++)
                refused += disturbed(kind, at, numbers[k / 2], k % 2);
    }
    print_message("%d runs, %d of them refused or disturbed\n", runs, refused);
    assert_true(runs > 3000 && refused > runs / 2);
}

/* A kernel whose answers have wrong bytes may be refused or obeyed; memory stays as it is. */
static void test_lies(void **st)
{
    int opened = 0, runs = 6000;
    uint32_t sum = 0;
    (void)st;
    for (int i = 0; i < runs; i++) {
        struct frame f = {0};
        kinds[i % KINDS](&fake);
        fake.dice = (uint32_t)i;
        fake.liar = 2u << i % 9;
        fake.clock = FAKE_VIRTUAL;
        if (open_uri(uri_of(i % KINDS)) == OK) {
            opened++;
            for (int k = 0; k < 8; k++) {
                (void)!camera_v4l2.focus(state, false);
                (void)!ask_err(0.001 * (k + 1));
                err_t e = camera_v4l2.next(state, &f);
                sum += !e && f.bytes > 0 ? f.data[0] + (uint32_t)f.data[f.bytes - 1] : 0;
                camera_v4l2.release(state, &f);
            }
            camera_v4l2.close(state);
        }
        assert_true(fake.fds == 0 && fake.maps == 0);
    }
    print_message("%d of %d opened (%u)\n", opened, runs, sum);
    assert_true(opened > runs / 10 && opened < runs);
}

/* ---- any order ---- */

static uint32_t dice;

static uint32_t roll(uint32_t n)
{
    dice = dice * 1664525 + 1013904223;
    return (dice >> 8) % n;
}

static void spoil(void)
{
    switch (roll(12)) {
    case 0:
        fake.flags = V4L2_BUF_FLAG_ERROR;
        break;
    case 1:
        fake.cut = 100;
        break;
    case 2:
        fake.index_add = CAMERA_BUFFERS_MAX + roll(50);
        break;
    case 3:
        fake.fatal = true;
        break;
    case 4:
        fake.overlong = true;
        break;
    case 5:
        fail_calls(roll(2) ? VIDIOC_QBUF : VIDIOC_S_EXT_CTRLS, roll(2) ? EINVAL : EIO, false);
        break;
    case 6:
        fake.lost = roll(8) == 0;
        break;
    default:
        fake.fail_at = 0;
    }
}

struct hands {
    struct frame held[CAMERA_BUFFERS_MAX];
    int n, taken;
};

static void take_more(struct hands *h)
{
    struct frame f;
    if (camera_v4l2.next(state, &f) != OK)
        return;
    for (int i = 0; i < h->n; i++)
        assert_true(h->held[i].index != f.index && h->held[i].data != f.data);
    assert_true(f.index < get_info().buffers && f.bytes <= fake_length(&fake));
    h->held[h->n++] = f;
    h->taken++;
}

static void give_some(struct hands *h)
{
    uint32_t i = roll((uint32_t)h->n);
    camera_v4l2.release(state, &h->held[i]);
    h->held[i] = h->held[--h->n];
}

static void any_step(struct hands *h)
{
    uint32_t op = roll(8);
    if (op < 3)
        fake_frame(&fake);
    else if (op < 5)
        take_more(h);
    else if (op == 5 && h->n > 0)
        give_some(h);
    else if (op == 6)
        (void)!ask_err(0.0001 * (1 + roll(1000)));
    else if (op == 7 && roll(4) == 0)
        spoil();
}

/* Frames that are held stay the caller's and are told apart, whatever happens. */
static void test_any_order(void **st)
{
    int taken = 0, lost = 0;
    (void)st;
    for (uint32_t seed = 0; seed < 300; seed++) {
        struct hands hands = {.n = 0};
        struct frame f;
        int kind = (int)(seed % 3);
        dice = seed;
        kinds[kind](&fake);
        struct camera_cfg cfg = {.uri = uri_of(kind), .buffers = (int)roll(9)};
        assert_int_equal(open_cfg(&cfg), OK);
        for (int step = 0; step < 300; step++)
            any_step(&hands);
        lost += camera_v4l2.next(state, &f) == ERR_LOST;
        taken += hands.taken;
        close_all();
    }
    print_message("%d frames, %d of 300 cameras were lost\n", taken, lost);
    assert_true(taken > 8000 && lost > 30 && lost < 280);
}

static int open_files(void)
{
    int n = 0;
    DIR *d = opendir("/proc/self/fd");
    assert_non_null(d);
    while (readdir(d))
        n++;
    closedir(d);
    return n;
}

/* Unplugged at any moment and plugged in again, a thousand times. */
static void test_replug(void **st)
{
    (void)st;
    int before = open_files(), frames = 0;
    struct frame f, kept;
    for (int i = 0; i < 1000; i++) {
        kinds[i % 3](&fake);
        fake.clock = FAKE_VIRTUAL;
        fake.lost_at = 1 + i % 7;
        open_ok(uri_of(i % 3));
        memset(&kept, 0, sizeof kept);
        err_t e = OK;
        for (int k = 0; k < 20 && e != ERR_LOST; k++) {
            e = camera_v4l2.next(state, &f);
            frames += e == OK;
            if (k == 1)
                kept = f;
            else
                camera_v4l2.release(state, &f);
        }
        assert_int_equal(e, ERR_LOST);
        if (i % 2)
            camera_v4l2.release(state, &kept);
        close_all();
    }
    assert_int_equal(open_files(), before);
    assert_true(frames > 3000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_bad_frames),
        cmocka_unit_test(test_wrong_buffers),
        cmocka_unit_test(test_broken_stream),
        cmocka_unit_test(test_refused_buffers),
        cmocka_unit_test(test_gone),
        cmocka_unit_test(test_stamps),
        cmocka_unit_test(test_every_call_fails),
        cmocka_unit_test(test_lies),
        cmocka_unit_test(test_any_order),
        cmocka_unit_test(test_replug),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
