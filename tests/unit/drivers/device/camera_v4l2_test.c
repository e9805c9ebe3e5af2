/* The V4L2 backend under a kernel of its own: what it asks for, what it makes of the answers. */
#include "drivers/device/v4l2_sensor.h"
#include "tests/unit/drivers/device/v4l2_rig.h"

/* ---- what it is ---- */

static void test_webcam(void **st)
{
    (void)st;
    fake_uvc(&fake);
    open_ok(webcam);
    struct camera_info i = get_info();
    assert_string_equal(i.unit, "usb-0000:00:14.0-1_HD-Webcam:-HD");
    assert_true(i.w == 64 && i.h == 48 && i.format == CAMERA_YUYV && i.stride == 136);
    assert_true(i.bits == 8 && i.black == 0 && i.limited && !i.bt709 && i.buffers == 4);
    assert_true(near(i.period_s, 1 / 30.0) && near(i.time_min_s, 3e-4));
    assert_true(near(i.time_max_s, 0.0333) && near(i.time_step_s, 1e-4));
    assert_true(i.gain_max == 1.0 && i.exposure_delay == -1 && i.gain_delay == -1 && !i.reports);
    assert_int_equal(i.stamp, CAMERA_STAMP_END); // against the report of uvcvideo
    assert_int_equal(control(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
    assert_int_equal(control(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 0);
    assert_int_equal(control(V4L2_CID_GAIN), 64);
    assert_int_equal(control(V4L2_CID_AUTO_WHITE_BALANCE), 0);
    assert_int_equal(control(V4L2_CID_WHITE_BALANCE_TEMPERATURE), 4600);
    assert_int_equal(control(V4L2_CID_POWER_LINE_FREQUENCY), 0);
    assert_int_equal(control(V4L2_CID_BACKLIGHT_COMPENSATION), 0);
    assert_int_equal(control(V4L2_CID_FOCUS_AUTO), 0);
    assert_int_equal(control(V4L2_CID_FOCUS_ABSOLUTE), 250); // stays where it was
    assert_int_equal(control(V4L2_CID_CONTRAST), 32);
    assert_int_equal(control(V4L2_CID_EXPOSURE_ABSOLUTE), 250);
    close_all();
}

static void test_pace(void **st)
{
    static const struct {
        const char *uri;
        double period_s, longest_s;
    } c[] = {{"v4l2:/dev/fake,longest_ms=1", 1 / 60.0, 0.0166},
             {"v4l2:/dev/fake,longest_ms=33.333", 1 / 30.0, 0.0333},
             {"v4l2:/dev/fake,longest_ms=33.36", 1 / 30.0, 0.0333}, // 1/29.97 is meant
             {"v4l2:/dev/fake,longest_ms=34", 1 / 15.0, 0.0666},
             {"v4l2:/dev/fake,longest_ms=60000", 0.2, 0.2}};
    (void)st;
    for (size_t k = 0; k < sizeof c / sizeof c[0]; k++) {
        fake_uvc(&fake);
        open_ok(c[k].uri);
        struct camera_info i = get_info();
        assert_true(near(i.period_s, c[k].period_s) && near(i.time_max_s, c[k].longest_s));
        assert_true(near(request_exposure(1e9, 1.0).time_s, c[k].longest_s));
        close_all();
    }
    fake_uvc(&fake);
    fake.pace[0] = (struct v4l2_fract){0, 0}; // a device that knows no pace
    open_ok(webcam);
    assert_true(near(get_info().period_s, 1 / 30.0));
    close_all();
}

static void test_exposure(void **st)
{
    (void)st;
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->step = 5; // 3, 8, 13 ...
    open_ok(webcam);
    assert_true(near(request_exposure(0.01, 4.0).time_s, 0.0098));
    assert_true(near(request_exposure(0.0102, 1.0).time_s,
                     0.0098)); // down, where the driver takes the nearest
    assert_true(near(request_exposure(1e-12, 1.0).time_s, 0.0003));
    struct exposure set = request_exposure(1e12, 1e9);
    assert_true(near(set.time_s, 0.0333) && set.gain == 1.0);
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->stuck = true;
    assert_true(near(request_exposure(0.001, 1.0).time_s, 0.0333)); // read back, not believed
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->value = 0;
    refuses(ask_err(0.01), ERR_IO, "reads back as 0");
    close_all();
}

/* Exposures act as late as the device is, and frames come in order. */
static void test_frames(void **st)
{
    (void)st;
    fake_uvc(&fake);
    open_ok(webcam);
    struct frame f;
    assert_int_equal(camera_v4l2.next(state, &f), ERR_AGAIN);
    assert_null(f.data);
    for (int i = 0; i < 20; i++) {
        request_exposure(0.001 * (i + 1), 1.0);
        fake_frame(&fake);
        f = take();
        assert_true(f.sequence == (uint32_t)i && f.flags == 0 && f.bytes == 136 * 48);
        assert_true(f.w == 64 && f.h == 48 && f.stride == 136 && f.format == CAMERA_YUYV);
        assert_true(f.timestamp_ns / 1000 == fake.now_ns / 1000 && !f.exposure_known);
        assert_int_equal(code_of(&f), i < 2 ? 0 : 10 * (i - 1));
        struct frame copy = f;
        camera_v4l2.release(state, &f);
        assert_true(!f.data && fake.n_fifo == 4);
        camera_v4l2.release(state, &copy); // once is enough
    }
    do {
        fake_frame(&fake);
        f = take();
    } while (f.index > 0);
    int queued = fake.n_fifo;
    camera_v4l2.release(state, &(struct frame){0}); // no frame, not that of buffer 0
    assert_int_equal(fake.n_fifo, queued);
    close_all();
}

static void test_mplane(void **st)
{
    (void)st;
    fake_mplane(&fake);
    fake.stamp_flags |= V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    fake.colours = V4L2_COLORSPACE_REC709;
    fake.range = V4L2_QUANTIZATION_FULL_RANGE;
    open_ok(webcam);
    struct camera_info i = get_info();
    assert_true(i.format == CAMERA_NV12 && i.bt709 && !i.limited && i.stride == 72);
    assert_int_equal(i.stamp, CAMERA_STAMP_START);
    fake.offset = 16;
    request_exposure(0.01, 1.0);
    for (int k = 0; k < 4; k++)
        fake_frame(&fake);
    const uint8_t *base = fake.buf[0].p;
    struct frame f = take();
    assert_true(f.data == base + 16 && f.bytes == 72 * 72 && f.flags == 0);
    camera_v4l2.release(state, &f);
    for (int k = 0; k < 3; k++) {
        f = take();
        camera_v4l2.release(state, &f);
    }
    fake.offset = 1u << 31; // beyond what is used
    fake_frame(&fake);
    f = take();
    assert_true(f.flags == (FRAME_ERROR | FRAME_SHORT) && f.bytes == 0 && f.data);
    camera_v4l2.release(state, &f);
    fake.cut = 72 * 10; // part of the colours
    fake_frame(&fake);
    f = take();
    assert_int_equal(f.flags, FRAME_SHORT);
    camera_v4l2.release(state, &f);
    fake.offset = 16; // 8 bytes are used
    fake.cut = 72 * 72 + 8;
    fake_frame(&fake);
    f = take();
    assert_true(f.flags == (FRAME_ERROR | FRAME_SHORT) && f.bytes == 0 && f.data);
    close_all();
}

/* ---- a sensor ---- */

static const double line_s = 3448 / 182.4e6;

static void test_sensor(void **st)
{
    (void)st;
    fake_raw(&fake);
    open_ok(sensor);
    struct camera_info i = get_info();
    assert_string_equal(i.unit, "platform:fe801000.csi_unicam_imx219");
    assert_true(i.format == CAMERA_RGGB16 && i.bits == 10 && i.black == 64 && i.stride == 72);
    assert_true(i.exposure_delay == 2 && i.gain_delay == 1 && near(i.gain_max, 256.0 / 24));
    int base = (int)floor(0.033 / line_s) + 4 - 24;
    assert_int_equal(control(V4L2_CID_VBLANK), base);
    assert_int_equal(control(V4L2_CID_ANALOGUE_GAIN), 0);
    assert_int_equal(control(V4L2_CID_DIGITAL_GAIN), 256);
    assert_int_equal(control(V4L2_CID_EXPOSURE), 400);
    assert_true(near(i.period_s, (24 + base) * line_s) && near(i.time_step_s, line_s));
    assert_true(near(i.time_min_s, 4 * line_s));
    assert_true(near(i.time_max_s, (24 + 65511 - 4) * line_s));

    struct exposure set = request_exposure(0.01, 2.1);
    assert_true(near(set.time_s, floor(0.01 / line_s) * line_s) && near(set.gain, 256.0 / 122));
    assert_int_equal(control(V4L2_CID_VBLANK), base); // frames stay as they are
    set = request_exposure(0.5, 1.0);
    assert_true(near(set.time_s, floor(0.5 / line_s) * line_s) && set.gain == 1.0);
    assert_int_equal(control(V4L2_CID_VBLANK), (int)floor(0.5 / line_s) + 4 - 24);
    set = request_exposure(1e-9, 99.0);
    assert_true(near(set.time_s, 4 * line_s) && near(set.gain, i.gain_max));
    assert_int_equal(control(V4L2_CID_VBLANK), base);
    assert_true(near(request_exposure(60.0, 1.0).time_s, i.time_max_s));
    close_all();
}

/* One frame is longer: VBLANK is back with the next one, or with a request. */
static void test_shift(void **st)
{
    (void)st;
    double shift = 0;
    fake_raw(&fake);
    open_ok(sensor);
    request_exposure(0.01, 1.0);
    int64_t base = control(V4L2_CID_VBLANK);
    for (int k = 0; k < 2; k++) {
        assert_int_equal(camera_v4l2.shift(state, 0.005, &shift), OK);
        int64_t lines = llround(0.005 / line_s);
        assert_true(near(shift, (double)lines * line_s));
        assert_int_equal(control(V4L2_CID_VBLANK), base + lines);
        refuses(camera_v4l2.shift(state, 0.005, &shift), ERR_BUSY, "still");
        if (k == 1)
            request_exposure(0.02, 1.0);
        fake_frame(&fake);
        struct frame f = take();
        camera_v4l2.release(state, &f);
        assert_int_equal(control(V4L2_CID_VBLANK), base);
    }
    assert_int_equal(camera_v4l2.shift(state, 1e-9, &shift), OK);
    assert_true(shift == 0);
    fake_control(&fake, V4L2_CID_VBLANK)->refuse = EIO;
    refuses(camera_v4l2.shift(state, 0.005, &shift), ERR_IO, "vertical blanking");
    close_all();
    fake_uvc(&fake);
    open_ok(webcam);
    refuses(camera_v4l2.shift(state, 0.005, &shift), ERR_UNSUPPORTED, "fixed");
    close_all();
    char wired[128];
    fake_raw(&fake);
    snprintf(wired, sizeof wired, "%s,sync=wired", sensor);
    open_ok(wired);
    base = control(V4L2_CID_VBLANK);
    refuses(camera_v4l2.shift(state, 0.005, &shift), ERR_UNSUPPORTED, "locked to a line");
    assert_int_equal(control(V4L2_CID_VBLANK), base);
    close_all();
}

/* When the second of two controls is refused the first comes back, and the frame's length too. */
static void test_half_written(void **st)
{
    (void)st;
    fake_raw(&fake);
    open_ok(sensor);
    request_exposure(0.01, 1.5);
    int64_t vblank = control(V4L2_CID_VBLANK), exposure = control(V4L2_CID_EXPOSURE);
    fake_control(&fake, V4L2_CID_ANALOGUE_GAIN)->refuse = EIO;
    refuses(ask_err(0.3), ERR_IO, "set its exposure");
    assert_int_equal(control(V4L2_CID_VBLANK), vblank);
    assert_int_equal(control(V4L2_CID_EXPOSURE), exposure);
    fake_control(&fake, V4L2_CID_ANALOGUE_GAIN)->refuse = 0;
    assert_true(near(request_exposure(0.3, 1.0).time_s, floor(0.3 / line_s) * line_s));
    fake_control(&fake, V4L2_CID_VBLANK)->flags = V4L2_CTRL_FLAG_GRABBED;
    refuses(ask_err(0.6), ERR_BUSY, "length of frames");
    close_all();
}

static void test_other_sensors(void **st)
{
    (void)st;
    fake_raw(&fake); // one that nobody knows, with blanking that cannot be changed
    snprintf(fake.sensor, sizeof fake.sensor, "abc123 1-0001");
    fake_control(&fake, V4L2_CID_VBLANK)->flags = V4L2_CTRL_FLAG_READ_ONLY;
    fake_control(&fake, V4L2_CID_VBLANK)->value = 500;
    fake_control(&fake, V4L2_CID_EXPOSURE)->hi = 1000;
    open_ok(sensor);
    struct camera_info i = get_info();
    assert_true(i.exposure_delay == -1 && i.gain_max == 1.0 && i.black == 0);
    assert_string_equal(i.unit, "platform:fe801000.csi_unicam");
    assert_true(near(i.time_max_s, 1000 * line_s) && near(i.period_s, 524 * line_s));
    assert_int_equal(control(V4L2_CID_ANALOGUE_GAIN), 10); // its default
    request_exposure(0.001, 8.0);
    assert_int_equal(control(V4L2_CID_ANALOGUE_GAIN), 10);
    close_all();
    fake_raw(&fake);
    fake.margin = 0; // the range of EXPOSURE is always the same
    fake_control(&fake, V4L2_CID_EXPOSURE)->hi = 1000000;
    struct camera_cfg grey = {.uri = sensor, .format = CAMERA_GREY};
    assert_int_equal(open_cfg(&grey), OK);
    assert_true(near(get_info().time_max_s, (24 + 65511 - 4) * line_s));
    assert_true(get_info().bits == 8 && get_info().black == 0);
    close_all();
    fake_raw(&fake);
    fake_control(&fake, V4L2_CID_VBLANK)->step = 64; // frames are longer than they need be
    open_ok(sensor);
    assert_true(near(request_exposure(0.3, 1.0).time_s, floor(0.3 / line_s) * line_s));
    close_all();
    fake_raw(&fake);
    fake_control(&fake, V4L2_CID_PIXEL_RATE)->value = 0;
    open_refused(sensor, ERR_UNSUPPORTED, "make no time of a line");
    fake_raw(&fake);
    fake.bus_code = MEDIA_BUS_FMT_SBGGR8_1X8;
    open_refused(sensor, ERR_UNSUPPORTED, "bus code 0x3001");
    fake_raw(&fake);
    open_refused("v4l2:/dev/fake", ERR_UNSUPPORTED, "subdev=");
    fake_raw(&fake);
    fake.fail_request = VIDIOC_STREAMON;
    fake.fail_at = 1;
    fake.fail_errno = EPIPE;
    open_refused(sensor, ERR_UNSUPPORTED, "media-ctl");
}

static void test_gain_codes(void **st)
{
    static const struct {
        const char *name;
        int code;
        double gain;
    } c[] = {{"imx219 10-0010", 128, 2.0}, {"imx477 10-001a", 512, 2.0},
             {"imx708_wide", 768, 4.0},    {"m00_b_imx415 4-001a", 20, 1.9953},
             {"OV5647 10-0036", 32, 2.0},  {"imx296", 60, 1.9953},
             {"ov01a10", 512, 2.0},        {"vd55g1 1-0010", 16, 2.0}};
    (void)st;
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        const struct v4l2_sensor *s = v4l2_sensor_find(c[i].name);
        assert_true(fabs(v4l2_sensor_gain(s, c[i].code) / c[i].gain - 1.0) < 1e-4);
        for (int64_t k = 16; k < 31; k++) { // down, and exactly what it gives itself
            double g = v4l2_sensor_gain(s, k);
            assert_int_equal(v4l2_sensor_code(s, g, 0, 31), k);
            assert_int_equal(v4l2_sensor_code(s, g * (1.0 - 1e-6), 0, 31), k - 1);
        }
        assert_int_equal(v4l2_sensor_code(s, 1e12, 0, INT32_MAX) > 100, c[i].code != 16);
    }
    assert_string_equal(v4l2_sensor_find("imx2190")->name, "");
    assert_string_equal(v4l2_sensor_find("ximx219")->name, "");
    assert_string_equal(v4l2_sensor_find("")->name, "");
    assert_true(v4l2_sensor_gain(v4l2_sensor_find("imx219"), 256) == 0.0);
    assert_true(v4l2_sensor_gain(v4l2_sensor_find(""), 5) == 0.0);
}

/* ---- automatic modes ---- */

static void test_focus(void **st)
{
    (void)st;
    fake_uvc(&fake);
    open_ok("v4l2:/dev/fake,focus=120");
    assert_int_equal(control(V4L2_CID_FOCUS_AUTO), 0);
    assert_int_equal(control(V4L2_CID_FOCUS_ABSOLUTE), 120);
    close_all();
    open_refused("v4l2:/dev/fake,focus=251", ERR_ARG, "focus=251 is outside of its 0..250");
    open_refused("v4l2:/dev/fake,focus=near", ERR_ARG, "focus");
    fake_control(&fake, V4L2_CID_FOCUS_ABSOLUTE)->refuse = EIO;
    open_refused("v4l2:/dev/fake,focus=120", ERR_IO, "set its focus");
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_FOCUS_ABSOLUTE)->flags = V4L2_CTRL_FLAG_DISABLED;
    open_ok(webcam); // nobody asked
    close_all();
    open_refused("v4l2:/dev/fake,focus=120", ERR_UNSUPPORTED, "its focus is fixed");
    open_refused("v4l2:/dev/fake,focus=once", ERR_UNSUPPORTED, "its focus is fixed");
}

static double lens(void)
{
    fake_frame(&fake);
    struct frame f = take();
    double at = f.lens_known ? f.lens : NAN;
    camera_v4l2.release(state, &f);
    return at;
}

static err_t search(bool again)
{
    err_t e = camera_v4l2.focus(state, again);
    for (int i = 0; i < 100 && e == ERR_AGAIN; i++)
        e = camera_v4l2.focus(state, false);
    return e;
}

/* Frames say where the lens stands: as read last, or as somebody else has put it since. */
static void test_lens(void **st)
{
    (void)st;
    fake_uvc(&fake);
    open_ok(webcam);
    assert_true(lens() == 250);
    close_all();
    open_ok("v4l2:/dev/fake,focus=120");
    assert_true(lens() == 120);
    assert_int_equal(camera_v4l2.focus(state, true), OK); // it stands
    fake_control(&fake, V4L2_CID_FOCUS_ABSOLUTE)->value = 130;
    fake.lens_changed = true;
    assert_true(lens() == 130);
    close_all();
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_FOCUS_ABSOLUTE)->flags = V4L2_CTRL_FLAG_DISABLED;
    open_ok(webcam);
    assert_true(isnan(lens()));
    close_all();
}

static void test_focus_once(void **st)
{
    (void)st;
    fake_uvc(&fake);
    open_refused("v4l2:/dev/fake,focus=auto", ERR_ARG, "use focus=once");
    open_refused("v4l2:/dev/fake,focus=once", ERR_UNSUPPORTED,
                 "auto_focus_start and _status): give a position in 0..250");
    for (int own = 0; own < 2; own++) { // the lens is a device of its own
        const char *uri = own ? "v4l2:/dev/fake,focus=once,subdev=/dev/fake-subdev0,lens=/dev/lens"
                              : "v4l2:/dev/fake,focus=once";
        own ? fake_raw(&fake) : fake_uvc(&fake);
        fake.lens = own;
        fake_add_search(&fake);
        open_ok(uri);
        assert_true(fake.searches == 0 && lens() == 250);
        assert_int_equal(search(false), OK);
        assert_true(fake.searches == 1 && lens() == 77);
        assert_int_equal(camera_v4l2.focus(state, false), OK);
        assert_int_equal(fake.searches, 1);
        fake_control(&fake, V4L2_CID_FOCUS_ABSOLUTE)->value = 99;
        fake.lens_changed = true;
        assert_true(lens() == 99);
        assert_int_equal(search(true), OK);
        assert_true(fake.searches == 2 && lens() == 77);
        fake.in_vain = true;
        refuses(search(true), ERR_TIMEOUT, "found no focus");
        assert_true(lens() == 250); // where it ended
        fake.search = 0;
        assert_int_equal(camera_v4l2.focus(state, false), ERR_AGAIN); // anew
        assert_int_equal(fake.searches, 4);
        for (int i = 0; i < 4; i++)
            assert_int_equal(camera_v4l2.focus(state, false), ERR_AGAIN);
        fake.now_ns += INT64_C(5000000000);
        refuses(camera_v4l2.focus(state, false), ERR_TIMEOUT, "found no focus in time");
        fake_control(&fake, V4L2_CID_AUTO_FOCUS_START)->refuse = EIO;
        refuses(camera_v4l2.focus(state, true), ERR_IO, "search its focus");
        fake.lost = true;
        refuses(camera_v4l2.focus(state, true), ERR_LOST, "");
        refuses(camera_v4l2.focus(state, true), ERR_LOST, ": unplugged");
        close_all();
    }
}

static void test_automatic(void **st)
{
    (void)st;
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_EXPOSURE_AUTO)->lo = V4L2_EXPOSURE_SHUTTER_PRIORITY;
    open_ok(webcam); // no manual mode, but one that leaves the time alone
    assert_int_equal(control(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_SHUTTER_PRIORITY);
    close_all();
    static const struct {
        uint32_t id;
        const char *says;
    } c[] = {{V4L2_CID_EXPOSURE_AUTO, "automatic exposure cannot be switched off"},
             {V4L2_CID_AUTO_WHITE_BALANCE, "automatic white balance cannot"},
             {V4L2_CID_FOCUS_AUTO, "automatic focus cannot"}};
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        fake_uvc(&fake);
        fake_control(&fake, c[i].id)->stuck = true;
        open_refused(webcam, ERR_UNSUPPORTED, c[i].says);
        fake_uvc(&fake);
        fake_control(&fake, c[i].id)->refuse = EIO;
        open_refused(webcam, ERR_IO, c[i].says);
        fake_uvc(&fake);
        fake_control(&fake, c[i].id)->flags = V4L2_CTRL_FLAG_READ_ONLY;
        open_refused(webcam, ERR_UNSUPPORTED, c[i].says);
    }
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_CONTRAST)->refuse = EIO; // others do not matter so much
    fake_control(&fake, V4L2_CID_AUTO_WHITE_BALANCE)->flags = V4L2_CTRL_FLAG_DISABLED;
    fake_control(&fake, V4L2_CID_AUTO_WHITE_BALANCE)->stuck = true;
    open_ok(webcam);
    fake_control(&fake, V4L2_CID_EXPOSURE_AUTO)->value = V4L2_EXPOSURE_APERTURE_PRIORITY;
    assert_true(
        near(request_exposure(0.02, 1.0).time_s, 0.02)); // somebody switched it on: off again
    assert_int_equal(control(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
    fake_control(&fake, V4L2_CID_EXPOSURE_AUTO)->value = V4L2_EXPOSURE_APERTURE_PRIORITY;
    fake_control(&fake, V4L2_CID_EXPOSURE_AUTO)->stuck = true;
    refuses(ask_err(0.02), ERR_UNSUPPORTED, "automatic exposure");
    close_all();
}

static void test_refused_requests(void **st)
{
    static const struct {
        int number;
        err_t code;
        const char *says;
    } c[] = {{EACCES, ERR_UNSUPPORTED, "automatic mode"},
             {EBUSY, ERR_BUSY, "takes no exposure now"},
             {EILSEQ, ERR_UNSUPPORTED, "automatic mode"},
             {EINVAL, ERR_ARG, "out of the device's range"},
             {ERANGE, ERR_ARG, "0.010000 s"},
             {EIO, ERR_IO, "cannot set its exposure"},
             {ETIMEDOUT, ERR_IO, "timed out"}};
    static const double bad[] = {0.0, -1.0, NAN, INFINITY};
    (void)st;
    fake_uvc(&fake);
    open_ok(webcam);
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->refuse = c[i].number;
        refuses(ask_err(0.01), c[i].code, c[i].says);
    }
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->refuse = 0;
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        assert_int_equal(ask_err(bad[i]), ERR_ARG);
    fake.lost = true;
    refuses(ask_err(0.01), ERR_LOST, "unplugged");
    refuses(ask_err(0.01), ERR_LOST, ": unplugged");
    close_all();
    fake_uvc(&fake); // a camera without exposure streams all the same
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->id = V4L2_CID_EXPOSURE;
    open_ok(webcam);
    struct camera_info i = get_info();
    assert_true(near(i.time_min_s, i.time_max_s) && i.time_step_s == 0.0);
    refuses(ask_err(0.01), ERR_UNSUPPORTED, "no exposure control");
    fake_frame(&fake);
    struct frame f = take();
    assert_int_equal(f.flags, 0);
    close_all();
}

/* ---- formats ---- */

static void test_formats(void **st)
{
    static const struct {
        uint32_t fourcc;
        enum camera_format format;
        int bits, stride;
    } c[] = {{V4L2_PIX_FMT_RGB24, CAMERA_RGB8, 8, 104},
             {V4L2_PIX_FMT_BGR24, CAMERA_BGR8, 8, 104},
             {V4L2_PIX_FMT_YUYV, CAMERA_YUYV, 8, 72},
             {V4L2_PIX_FMT_NV12, CAMERA_NV12, 8, 40},
             {V4L2_PIX_FMT_MJPEG, CAMERA_MJPG, 8, 0},
             {V4L2_PIX_FMT_GREY, CAMERA_GREY, 8, 40},
             {V4L2_PIX_FMT_Y10, CAMERA_GREY16, 10, 72},
             {V4L2_PIX_FMT_Y12, CAMERA_GREY16, 12, 72},
             {V4L2_PIX_FMT_Y16, CAMERA_GREY16, 16, 72},
             {V4L2_PIX_FMT_SRGGB10, CAMERA_RGGB16, 10, 72},
             {V4L2_PIX_FMT_SBGGR12, CAMERA_BGGR16, 12, 72},
             {V4L2_PIX_FMT_SGRBG14, CAMERA_GRBG16, 14, 72},
             {V4L2_PIX_FMT_SGBRG16, CAMERA_GBRG16, 16, 72},
             {V4L2_PIX_FMT_SRGGB10P, CAMERA_RGGB10P, 10, 48},
             {V4L2_PIX_FMT_SRGGB12P, CAMERA_RGGB12P, 12, 56}};
    (void)st;
    for (size_t k = 0; k < sizeof c / sizeof c[0]; k++) {
        struct camera_cfg cfg = {.uri = webcam, .w = 32, .h = 24, .format = c[k].format};
        fake_uvc(&fake);
        fake.fourcc[0] = v4l2_fourcc('P', 'C', '1', 'R'); // compressed raw
        fake.fourcc[2] = c[k].fourcc;
        fake.fourcc[1] = c[k].format == CAMERA_YUYV ? V4L2_PIX_FMT_RGB24 : V4L2_PIX_FMT_YUYV;
        assert_int_equal(open_cfg(&cfg), OK);
        struct camera_info i = get_info();
        assert_true(i.format == c[k].format && i.bits == c[k].bits && i.stride == c[k].stride);
        assert_true(i.w == 32 && i.h == 24);
        close_all();
    }
    fake_uvc(&fake); // the best of these
    fake.fourcc[2] = V4L2_PIX_FMT_SRGGB10;
    fake.fourcc[3] = V4L2_PIX_FMT_SRGGB12;
    open_ok(webcam);
    assert_true(get_info().format == CAMERA_RGGB16 && get_info().bits == 12);
    close_all();
}

static void test_refused_formats(void **st)
{
    struct camera_cfg cfg = {.uri = webcam, .w = 33};
    (void)st;
    fake_uvc(&fake);
    refuses(open_cfg(&cfg), ERR_UNSUPPORTED,
            "asked for 33x48 px in YUYV, the driver came back with 32x24 px in YUYV; sizes it "
            "names: 32x24 64x48");
    cfg = (struct camera_cfg){.uri = webcam, .format = CAMERA_GREY};
    refuses(open_cfg(&cfg), ERR_UNSUPPORTED, "no pictures in GREY; it offers MJPG YUYV");
    cfg = (struct camera_cfg){.uri = webcam, .w = -1};
    refuses(open_cfg(&cfg), ERR_ARG, "-1 x 0 px");
    cfg = (struct camera_cfg){.uri = webcam, .format = (enum camera_format)99};
    refuses(open_cfg(&cfg), ERR_ARG, "no pixel format 99");
    cfg = (struct camera_cfg){.uri = webcam, .buffers = 33};
    refuses(open_cfg(&cfg), ERR_ARG, "33 buffers, not 1..32");
    cfg = (struct camera_cfg){.uri = webcam, .buffers = -1};
    refuses(open_cfg(&cfg), ERR_ARG, "-1 buffers");
    fake.fourcc[0] = fake.fourcc[1] = v4l2_fourcc('P', 'C', '1', 'R');
    open_refused(webcam, ERR_UNSUPPORTED, "no pictures in a known format; it offers PC1R PC1R");
    fake.fourcc[0] = 0;
    open_refused(webcam, ERR_UNSUPPORTED, "it offers nothing");
    nothing_left();
}

/* Values that a driver should never tell. */
static void test_hostile(void **st)
{
    struct hostile {
        size_t field; // uint32_t in struct fake
        uint32_t value;
        const char *says;
    };
#define F(field) offsetof(struct fake, field)
    static const struct hostile c[] = {
        {F(wrong_stride), 127, "127 bytes from row to row, a row of 64 px has 128"},
        {F(wrong_stride), UINT32_MAX, "4294967295 bytes from row to row"},
        {F(wrong_image), 136 * 47 + 127, "pictures of 6519 bytes, 64x48 px need 6520"},
        {F(wrong_w), 63, "came back with 63x48 px"},
        {F(wrong_fourcc), V4L2_PIX_FMT_UYVY, "came back with 64x48 px in UYVY"},
        {F(wrong_field), V4L2_FIELD_INTERLACED, "interlaced"},
        {F(wrong_length), 6519, "buffers of 6519 bytes, pictures need 6520"},
        {F(wrong_length), 0x40000001, "buffers of 1073741825 bytes"},
    };
    (void)st;
    for (size_t k = 0; k < sizeof c / sizeof c[0]; k++) {
        fake_uvc(&fake);
        *(uint32_t *)((char *)&fake + c[k].field) = c[k].value;
        open_refused(webcam, ERR_UNSUPPORTED, c[k].says);
    }
    fake_uvc(&fake);
    fake.no_stride = true;
    open_refused(webcam, ERR_UNSUPPORTED, "0 bytes from row to row");
    fake_mplane(&fake);
    fake.wrong_planes = 2;
    open_refused(webcam, ERR_UNSUPPORTED, "in 2 planes");
    fake_uvc(&fake);
    fake.wrong_count = 2;
    open_refused(webcam, ERR_NOMEM, "2 buffers of 4 asked for, at least 3");
    fake.wrong_count = FAKE_BUFFERS; // more than asked for, and than can be used
    open_ok(webcam);
    assert_int_equal(get_info().buffers, CAMERA_BUFFERS_MAX);
    close_all();
}

static void test_odd_values(void **st)
{
    (void)st;
    fake_uvc(&fake);
    fake.w[0] = 40000;
    fake.w[1] = 0;
    fake_put_format(&fake, 40000, 24, V4L2_PIX_FMT_YUYV);
    fake.h[0] = 24;
    open_refused(webcam, ERR_UNSUPPORTED, "40000x24 px, sides must be in 1..32768");
    fake_uvc(&fake);
    fake.w[1] = 33;
    fake_put_format(&fake, 33, 48, V4L2_PIX_FMT_YUYV);
    open_refused(webcam, ERR_UNSUPPORTED, "33x48 px have odd sides");
    fake_uvc(&fake);
    memset(fake.card, 0xFF, sizeof fake.card); // no end, not printable
    memset(fake.bus, '/', sizeof fake.bus);
    memset(fake.driver, 'u', sizeof fake.driver);
    open_ok(webcam);
    for (const char *p = get_info().unit; *p; p++)
        assert_true(*p > ' ' && *p < 0x7F && *p != '/');
    assert_int_equal(strlen(get_info().unit), 65);
    close_all();
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->lo = INT32_MIN;
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->hi = INT32_MAX;
    open_ok(webcam);
    assert_true(near(get_info().time_min_s, 1e-4) && near(get_info().time_max_s, 0.0333));
    close_all();
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->lo = 400; // longer than a frame
    open_refused(webcam, ERR_UNSUPPORTED, "400..333");
}

static void test_refused_open(void **st)
{
    static const struct {
        const char *uri;
        err_t code;
        const char *says;
    } c[] = {
        {"sim:x", ERR_ARG, "does not begin with \"v4l2:\""},
        {"v4l2:", ERR_ARG, "a device path of 0 bytes"},
        {"v4l2:,longest_ms=5", ERR_ARG, "a device path of 0 bytes"},
        {"v4l2:/dev/v,longest_ms=0", ERR_ARG, "longest_ms is \"0\", not a number in 0.1..60000"},
        {"v4l2:/dev/v,fps=3", ERR_ARG, "no option is called \"fps\""},
        {"v4l2:/dev/v,subdev=", ERR_ARG, "subdev has 0 bytes"}};
    static const struct {
        int number;
        err_t code;
        const char *says;
    } o[] = {{EACCES, ERR_IO, "group video"},
             {EPERM, ERR_IO, "60-hdrig.rules"},
             {ENOENT, ERR_LOST, "/dev/fake: no such camera now"},
             {ENODEV, ERR_LOST, "unplugged"},
             {ENXIO, ERR_LOST, "unplugged"},
             {EBUSY, ERR_BUSY, "in use"},
             {EMFILE, ERR_IO, "Too many open files"},
             {ENOMEM, ERR_NOMEM, "no memory"}};
    static const struct {
        unsigned long request;
        int number;
        err_t code;
        const char *says;
    } r[] = {{VIDIOC_QUERYCAP, ENOTTY, ERR_UNSUPPORTED, "not a V4L2 device"},
             {VIDIOC_S_FMT, EBUSY, ERR_BUSY, "in use by another program"},
             {VIDIOC_S_PARM, EBUSY, ERR_BUSY, "in use by another program"},
             {VIDIOC_REQBUFS, EBUSY, ERR_BUSY, "in use by another program"},
             {VIDIOC_REQBUFS, ENOMEM, ERR_NOMEM, "no memory to get buffers"},
             {VIDIOC_STREAMON, ENOSPC, ERR_BUSY, "bandwidth"},
             {VIDIOC_STREAMON, EINVAL, ERR_UNSUPPORTED, "start its stream"}};
    (void)st;
    for (size_t i = 0; i < sizeof c / sizeof c[0]; i++) {
        fake_uvc(&fake);
        open_refused(c[i].uri, c[i].code, c[i].says);
    }
    for (size_t i = 0; i < sizeof o / sizeof o[0]; i++) {
        fake_uvc(&fake);
        fake.open_errno = o[i].number;
        open_refused(webcam, o[i].code, o[i].says);
    }
    for (size_t i = 0; i < sizeof r / sizeof r[0]; i++) {
        fake_uvc(&fake);
        fake.fail_request = r[i].request;
        fake.fail_at = 1;
        fake.fail_errno = r[i].number;
        open_refused(webcam, r[i].code, r[i].says);
    }
}

static void test_other_nodes(void **st)
{
    (void)st;
    fake_uvc(&fake);
    fake.caps = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
    open_refused(webcam, ERR_UNSUPPORTED, "but metadata");
    fake.caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_READWRITE;
    open_refused(webcam, ERR_UNSUPPORTED, "cannot stream");
    struct camera_cfg cfg = {.uri = "v4l2:/nowhere/video0"};
    refuses(camera_v4l2.open(state, &cfg), ERR_LOST, "/nowhere/video0: no such camera now");
    cfg.uri = "v4l2:/dev/null";
    refuses(camera_v4l2.open(state, &cfg), ERR_UNSUPPORTED, "not a V4L2 device");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_webcam),
        cmocka_unit_test(test_pace),
        cmocka_unit_test(test_exposure),
        cmocka_unit_test(test_frames),
        cmocka_unit_test(test_mplane),
        cmocka_unit_test(test_sensor),
        cmocka_unit_test(test_shift),
        cmocka_unit_test(test_half_written),
        cmocka_unit_test(test_other_sensors),
        cmocka_unit_test(test_gain_codes),
        cmocka_unit_test(test_focus),
        cmocka_unit_test(test_lens),
        cmocka_unit_test(test_focus_once),
        cmocka_unit_test(test_automatic),
        cmocka_unit_test(test_refused_requests),
        cmocka_unit_test(test_formats),
        cmocka_unit_test(test_refused_formats),
        cmocka_unit_test(test_hostile),
        cmocka_unit_test(test_odd_values),
        cmocka_unit_test(test_refused_open),
        cmocka_unit_test(test_other_nodes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
