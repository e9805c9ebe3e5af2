/* The V4L2 backend under a kernel of its own: what it asks for, what it makes of answers, and that
 * nothing leaks whatever fails. */
#include "drivers/camera_v4l2.h"

#include "drivers/v4l2_sensor.h"
#include "tests/unit/v4l2_fake.h"

#include <dirent.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct fake fake;
static void *state; // of the only camera

static const char webcam[] = "v4l2:/dev/fake";
static const char sensor[] = "v4l2:/dev/fake,subdev=/dev/fake-subdev0";

/* ---- helpers ---- */

static err_t open_cfg(const struct camera_cfg *cfg)
{
    free(state);
    state = malloc(camera_v4l2.state_bytes);
    assert_non_null(state);
    memset(state, 0xA5, camera_v4l2.state_bytes);
    return camera_v4l2_open_with(state, cfg, &fake.sys);
}

static err_t open_uri(const char *uri)
{
    return open_cfg(&(struct camera_cfg){.uri = uri});
}

static void open_ok(const char *uri)
{
    err_t e = open_uri(uri);
    if (e)
        print_message("%s\n", err_text());
    assert_int_equal(e, OK);
}

static void nothing_left(void)
{
    if (fake.breach[0])
        print_message("%s\n", fake.breach);
    assert_string_equal(fake.breach, "");
    assert_int_equal(fake.fds, 0);
    assert_int_equal(fake.maps, 0);
}

static void close_all(void)
{
    camera_v4l2.close(state);
    free(state);
    state = NULL;
    nothing_left();
}

static void refuses(err_t e, err_t code, const char *says)
{
    if (e != code || !strstr(err_text(), says))
        print_message("%s: %s\n", err_name(e), err_text());
    assert_int_equal(e, code);
    assert_non_null(strstr(err_text(), says));
}

/* Opening is refused, and leaves nothing behind. */
static void open_refused(const char *uri, err_t code, const char *says)
{
    refuses(open_uri(uri), code, says);
    nothing_left();
}

static struct camera_info get_info(void)
{
    struct camera_info info;
    camera_v4l2.info(state, &info);
    return info;
}

static struct frame take(void)
{
    struct frame f;
    assert_int_equal(camera_v4l2.next(state, &f), OK);
    return f;
}

static int code_of(const struct frame *f)
{
    int32_t code;
    memcpy(&code, f->data, sizeof code);
    return code;
}

static struct exposure ask(double time_s, double gain)
{
    struct exposure set = {0};
    assert_int_equal(camera_v4l2.request(state, &(struct exposure){time_s, gain}, &set), OK);
    return set;
}

static err_t ask_err(double time_s)
{
    struct exposure set = {7.0, 7.0};
    err_t e = camera_v4l2.request(state, &(struct exposure){time_s, 1.0}, &set);
    assert_true((e == OK) == (set.time_s != 7.0));
    return e;
}

static bool near(double a, double b)
{
    return fabs(a - b) <= 1e-9 + 1e-6 * fabs(b);
}

static int64_t control(uint32_t id)
{
    return fake_control(&fake, id)->value;
}

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
    assert_int_equal(i.stamp, CAMERA_STAMP_END); // whatever uvcvideo says
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
             {"v4l2:/dev/fake,longest_ms=34", 1 / 15.0, 0.0666},
             {"v4l2:/dev/fake,longest_ms=60000", 0.2, 0.2}};
    (void)st;
    for (size_t k = 0; k < sizeof c / sizeof c[0]; k++) {
        fake_uvc(&fake);
        open_ok(c[k].uri);
        struct camera_info i = get_info();
        assert_true(near(i.period_s, c[k].period_s) && near(i.time_max_s, c[k].longest_s));
        assert_true(near(ask(1e9, 1.0).time_s, c[k].longest_s));
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
    assert_true(near(ask(0.01, 4.0).time_s, 0.0098));
    assert_true(near(ask(0.0098, 1.0).time_s, 0.0098));
    assert_true(near(ask(1e-12, 1.0).time_s, 0.0003));
    struct exposure set = ask(1e12, 1e9);
    assert_true(near(set.time_s, 0.0333) && set.gain == 1.0);
    fake_control(&fake, V4L2_CID_EXPOSURE_ABSOLUTE)->stuck = true;
    assert_true(near(ask(0.001, 1.0).time_s, 0.0333)); // read back, not believed
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
        ask(0.001 * (i + 1), 1.0);
        fake_frame(&fake);
        f = take();
        assert_true(f.sequence == (uint32_t)i && f.flags == 0 && f.bytes == 136 * 48);
        assert_true(f.w == 64 && f.h == 48 && f.stride == 136 && f.format == CAMERA_YUYV);
        assert_true(f.timestamp_ns / 1000 == fake.now_ns / 1000 && !f.exposure_known);
        assert_int_equal(code_of(&f), i < 2 ? 0 : 10 * (i - 1));
        camera_v4l2.release(state, &f);
        assert_null(f.data);
        camera_v4l2.release(state, &f);
    }
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
    ask(0.01, 1.0);
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

    struct exposure set = ask(0.01, 2.1);
    assert_true(near(set.time_s, floor(0.01 / line_s) * line_s) && near(set.gain, 256.0 / 122));
    assert_int_equal(control(V4L2_CID_VBLANK), base); // frames stay as they are
    set = ask(0.5, 1.0);
    assert_true(near(set.time_s, floor(0.5 / line_s) * line_s) && set.gain == 1.0);
    assert_int_equal(control(V4L2_CID_VBLANK), (int)floor(0.5 / line_s) + 4 - 24);
    set = ask(1e-9, 99.0);
    assert_true(near(set.time_s, 4 * line_s) && near(set.gain, i.gain_max));
    assert_int_equal(control(V4L2_CID_VBLANK), base);
    assert_true(near(ask(60.0, 1.0).time_s, i.time_max_s));
    close_all();
}

/* When the second of two controls is refused the first comes back, and the frame's length too. */
static void test_half_written(void **st)
{
    (void)st;
    fake_raw(&fake);
    open_ok(sensor);
    ask(0.01, 1.5);
    int64_t vblank = control(V4L2_CID_VBLANK), exposure = control(V4L2_CID_EXPOSURE);
    fake_control(&fake, V4L2_CID_ANALOGUE_GAIN)->refuse = EIO;
    refuses(ask_err(0.3), ERR_IO, "set its exposure");
    assert_int_equal(control(V4L2_CID_VBLANK), vblank);
    assert_int_equal(control(V4L2_CID_EXPOSURE), exposure);
    fake_control(&fake, V4L2_CID_ANALOGUE_GAIN)->refuse = 0;
    assert_true(near(ask(0.3, 1.0).time_s, floor(0.3 / line_s) * line_s));
    fake_control(&fake, V4L2_CID_VBLANK)->flags = V4L2_CTRL_FLAG_GRABBED;
    refuses(ask_err(0.6), ERR_BUSY, "vertical blanking");
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
    ask(0.001, 8.0);
    assert_int_equal(control(V4L2_CID_ANALOGUE_GAIN), 10);
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
        open_refused(webcam, ERR_UNSUPPORTED, c[i].says);
    }
    fake_uvc(&fake);
    fake_control(&fake, V4L2_CID_CONTRAST)->refuse = EIO; // others do not matter so much
    fake_control(&fake, V4L2_CID_AUTO_WHITE_BALANCE)->flags = V4L2_CTRL_FLAG_DISABLED;
    open_ok(webcam);
    fake_control(&fake, V4L2_CID_EXPOSURE_AUTO)->value = V4L2_EXPOSURE_APERTURE_PRIORITY;
    assert_true(near(ask(0.02, 1.0).time_s, 0.02)); // somebody switched it on: off again
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
    } c[] = {{EACCES, ERR_UNSUPPORTED, "automatic mode"},    {EBUSY, ERR_BUSY, "in use"},
             {EINVAL, ERR_ARG, "out of the device's range"}, {ERANGE, ERR_ARG, "0.010000 s"},
             {EIO, ERR_IO, "cannot set its exposure"},       {ETIMEDOUT, ERR_IO, "timed out"}};
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
    refuses(ask_err(0.01), ERR_LOST, "open it again");
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
    fake_uvc(&fake);
    fake.w[0] = 40000;
    fake.w[1] = 0;
    fake_put_format(&fake, 40000, 24, V4L2_PIX_FMT_YUYV);
    fake.h[0] = 24;
    open_refused(webcam, ERR_UNSUPPORTED, "40000x24 px, sides must be in 1..32768");
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

/* ---- trouble while it streams ---- */

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
    refuses(camera_v4l2.next(state, &f), ERR_IO, "a buffer that it does not have");
    assert_null(f.data);
    fake_frame(&fake);
    f = take(); // once is forgotten
    fake.index_add = UINT32_MAX;
    fake_frame(&fake);
    struct frame g;
    fake.buf[2].b.index = 0;
    fake.index_add = (uint32_t)f.index - 2; // the one that the caller has
    refuses(camera_v4l2.next(state, &g), ERR_IO, "a buffer that it does not have");
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
        uint32_t flags, then; // of the first buffer, and of frames
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

static void (*const kinds[])(struct fake *) = {fake_uvc, fake_mplane, fake_raw};

static const char *uri_of(int kind)
{
    return kind == 2 ? sensor : webcam;
}

/* Open, frames, requests, close. Every result must be one that the contract names. */
static err_t scenario(int kind)
{
    err_t e = open_uri(uri_of(kind));
    if (e) {
        assert_true(e == ERR_UNSUPPORTED || e == ERR_LOST || e == ERR_BUSY || e == ERR_IO ||
                    e == ERR_NOMEM);
        return e;
    }
    struct frame f, kept = {0};
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

static void test_every_call_fails(void **st)
{
    static const int numbers[] = {EIO,   ENODEV, EINVAL, EBUSY,  EACCES, ENOMEM,
                                  EINTR, EAGAIN, ENOTTY, ERANGE, ENOSPC, EPIPE};
    int runs = 0, refused = 0;
    (void)st;
    for (int kind = 0; kind < 3; kind++) {
        kinds[kind](&fake);
        assert_int_equal(scenario(kind), OK);
        long calls = fake.calls;
        for (long at = 1; at <= calls; at++)
            for (size_t k = 0; k < 2 * sizeof numbers / sizeof numbers[0]; k++) {
                kinds[kind](&fake);
                fake.fail_at = at;
                fake.fail_errno = numbers[k / 2];
                fake.fail_on = k % 2;
                err_t e = scenario(kind);
                refused += e != OK;
                runs++;
                if (fake.fail_errno == EINTR && !fake.fail_on)
                    assert_int_equal(e, OK);
                nothing_left();
            }
    }
    print_message("%d runs, %d of them refused or disturbed\n", runs, refused);
    assert_true(runs > 3000 && refused > runs / 2);
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

/* Frames that are held stay the caller's and are told apart, whatever happens. */
static void test_any_order(void **st)
{
    int taken = 0, lost = 0;
    (void)st;
    for (uint32_t seed = 0; seed < 300; seed++) {
        struct frame held[CAMERA_BUFFERS_MAX] = {{0}}, f;
        int kind = (int)(seed % 3), n = 0;
        dice = seed;
        kinds[kind](&fake);
        struct camera_cfg cfg = {.uri = uri_of(kind), .buffers = (int)roll(9)};
        assert_int_equal(open_cfg(&cfg), OK);
        for (int step = 0; step < 300; step++) {
            uint32_t op = roll(8);
            if (op < 3)
                fake_frame(&fake);
            else if (op < 5 && camera_v4l2.next(state, &f) == OK) {
                for (int i = 0; i < n; i++)
                    assert_true(held[i].index != f.index && held[i].data != f.data);
                assert_true(f.index < get_info().buffers && f.bytes <= fake_length(&fake));
                held[n++] = f;
                taken++;
            } else if (op == 5 && n > 0) {
                uint32_t i = roll((uint32_t)n);
                camera_v4l2.release(state, &held[i]);
                held[i] = held[--n];
            } else if (op == 6)
                (void)!ask_err(0.0001 * (1 + roll(1000)));
            else if (op == 7 && roll(4) == 0)
                spoil();
        }
        lost += camera_v4l2.next(state, &f) == ERR_LOST;
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
        cmocka_unit_test(test_webcam),           cmocka_unit_test(test_pace),
        cmocka_unit_test(test_exposure),         cmocka_unit_test(test_frames),
        cmocka_unit_test(test_mplane),           cmocka_unit_test(test_sensor),
        cmocka_unit_test(test_half_written),     cmocka_unit_test(test_other_sensors),
        cmocka_unit_test(test_gain_codes),       cmocka_unit_test(test_automatic),
        cmocka_unit_test(test_refused_requests), cmocka_unit_test(test_formats),
        cmocka_unit_test(test_refused_formats),  cmocka_unit_test(test_hostile),
        cmocka_unit_test(test_refused_open),     cmocka_unit_test(test_bad_frames),
        cmocka_unit_test(test_wrong_buffers),    cmocka_unit_test(test_broken_stream),
        cmocka_unit_test(test_refused_buffers),  cmocka_unit_test(test_gone),
        cmocka_unit_test(test_stamps),           cmocka_unit_test(test_every_call_fails),
        cmocka_unit_test(test_any_order),        cmocka_unit_test(test_replug),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
