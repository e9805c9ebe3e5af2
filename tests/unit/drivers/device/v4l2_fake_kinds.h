/* v4l2_fake_kinds.h - the devices that v4l2_fake.h plays: a webcam, a pipeline, a bare sensor.
 * thread: one. */
#ifndef DEVICE_V4L2_FAKE_KINDS_H
#define DEVICE_V4L2_FAKE_KINDS_H

#include "tests/unit/drivers/device/v4l2_fake.h"

static inline void fake_basis(struct fake *f)
{
    static const struct v4l2_fract paces[] = {{1, 60}, {1, 30}, {1, 15}, {1, 5}};
    memset(f, 0, sizeof *f);
    f->sys = (struct v4l2_sys){.ctx = f,
                               .open = fake_open,
                               .close = fake_close,
                               .ioctl = fake_ioctl,
                               .mmap = fake_mmap,
                               .munmap = fake_munmap,
                               .name = fake_name,
                               .clock_ns = fake_clock_ns};
    f->fd = f->sub_fd = f->lens_fd = -1;
    f->now_ns = 1000000000;
    f->late = 2;
    f->w[0] = 32;
    f->h[0] = 24;
    f->w[1] = 64;
    f->h[1] = 48;
    f->stamp_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    f->colours = V4L2_COLORSPACE_SRGB;
    memcpy(f->pace, paces, sizeof paces);
    f->now_pace = f->pace[1];
    snprintf(f->bus, sizeof f->bus, "usb-0000:00:14.0-1");
}

/* A lens that searches by itself. */
static inline void fake_add_search(struct fake *f)
{
    if (!fake_control(f, V4L2_CID_FOCUS_ABSOLUTE))
        fake_add(f, V4L2_CID_FOCUS_ABSOLUTE, 0, 250, 0);
    fake_add(f, V4L2_CID_AUTO_FOCUS_START, 0, 0, 0);
    fake_add(f, V4L2_CID_AUTO_FOCUS_STATUS, 0, 7, 0);
    f->search = 5;
}

/* A webcam as uvcvideo shows it. */
static inline void fake_uvc(struct fake *f)
{
    fake_basis(f);
    snprintf(f->driver, sizeof f->driver, "uvcvideo");
    snprintf(f->card, sizeof f->card, "HD Webcam: HD");
    f->caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    f->stamp_flags |= V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    f->fourcc[0] = V4L2_PIX_FMT_MJPEG;
    f->fourcc[1] = V4L2_PIX_FMT_YUYV;
    fake_add(f, V4L2_CID_EXPOSURE_AUTO, 0, 3, 3);
    fake_add(f, V4L2_CID_EXPOSURE_ABSOLUTE, 3, 2047, 250);
    fake_add(f, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0, 1, 0);
    fake_add(f, V4L2_CID_GAIN, 0, 255, 64);
    fake_add(f, V4L2_CID_AUTO_WHITE_BALANCE, 0, 1, 1);
    fake_add(f, V4L2_CID_WHITE_BALANCE_TEMPERATURE, 2800, 6500, 4600);
    fake_add(f, V4L2_CID_POWER_LINE_FREQUENCY, 0, 2, 2);
    fake_add(f, V4L2_CID_BACKLIGHT_COMPENSATION, 0, 2, 1);
    fake_add(f, V4L2_CID_FOCUS_AUTO, 0, 1, 1);
    fake_add(f, V4L2_CID_FOCUS_ABSOLUTE, 0, 250, 0);
    fake_add(f, V4L2_CID_CONTRAST, 0, 255, 32);
    fake_put_format(f, 64, 48, V4L2_PIX_FMT_MJPEG);
}

/* The same behind the multi-planar interface. */
static inline void fake_mplane(struct fake *f)
{
    fake_uvc(f);
    f->mplane = true;
    f->caps = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
    snprintf(f->driver, sizeof f->driver, "isp");
    f->fourcc[0] = V4L2_PIX_FMT_NV12;
    f->fourcc[1] = V4L2_PIX_FMT_NV12M;
    fake_put_format(f, 64, 48, V4L2_PIX_FMT_NV12);
}

/* An IMX219 on its own sub-device: lines of 3448 px at 182.4 Mpx/s. */
static inline void fake_raw(struct fake *f)
{
    fake_basis(f);
    snprintf(f->driver, sizeof f->driver, "unicam");
    snprintf(f->card, sizeof f->card, "unicam");
    snprintf(f->bus, sizeof f->bus, "platform:fe801000.csi");
    snprintf(f->sensor, sizeof f->sensor, "imx219 10-0010");
    f->caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING | V4L2_CAP_IO_MC;
    f->sub = true;
    f->margin = 4;
    f->fourcc[0] = V4L2_PIX_FMT_GREY;
    f->fourcc[1] = V4L2_PIX_FMT_SRGGB10P;
    f->fourcc[2] = V4L2_PIX_FMT_SRGGB10;
    fake_add(f, V4L2_CID_EXPOSURE, 4, 24 + 65511 - 4, 400);
    fake_add(f, V4L2_CID_ANALOGUE_GAIN, 0, 232, 10);
    fake_add(f, V4L2_CID_DIGITAL_GAIN, 256, 4095, 256);
    fake_add(f, V4L2_CID_VBLANK, 4, 65511, 1000);
    fake_add(f, V4L2_CID_HBLANK, 3448 - 32, 3448 - 32, 3448 - 32);
    fake_add(f, V4L2_CID_PIXEL_RATE, 182400000, 182400000, 182400000);
    fake_control(f, V4L2_CID_PIXEL_RATE)->flags = V4L2_CTRL_FLAG_READ_ONLY;
    fake_put_format(f, 32, 24, V4L2_PIX_FMT_GREY);
}

#endif
