/* v4l2_format.h - pixel format, size and pace of a V4L2 capture node: the request is met, or
 * the error names what the driver offers instead.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_FORMAT_H
#define DEVICE_V4L2_FORMAT_H

#include "drivers/device/camera.h"
#include "drivers/device/v4l2_sys.h"

struct v4l2_layout {
    bool mplane;
    enum camera_format format;
    uint32_t fourcc;
    uint32_t bus;        // the same on the wires from a sensor: a MEDIA_BUS_FMT; 0: not known
    int w, h, stride;    // px, bytes
    int bits;            // per sample
    size_t least;        // bytes that a whole frame has; 0: varies (JPEG)
    bool limited, bt709; // as camera_info
};

/* Set pixel format and size: those of cfg, else the best format and the driver's size.
 * `out->mplane` is an input.
 * err:  ERR_UNSUPPORTED names what there is; ERR_BUSY, ERR_LOST, ERR_IO */
MUST_USE err_t v4l2_format_set(const struct v4l2_node *n, const struct camera_cfg *cfg,
                               struct v4l2_layout *out);

/* The fastest pace whose frames are at least longest_s apart, else the slowest.
 * out:  *period_s, as the driver reports it; 0 if it does not.
 * err:  ERR_BUSY, ERR_LOST */
MUST_USE err_t v4l2_format_pace(const struct v4l2_node *n, const struct v4l2_layout *l,
                                double longest_s, double *period_s);

/* Make the source pad of a sensor's sub-device agree with the layout.
 * err:  ERR_UNSUPPORTED (it stays different: says how), ERR_BUSY, ERR_LOST, ERR_IO */
MUST_USE err_t v4l2_format_pad(const struct v4l2_node *sub, const struct v4l2_layout *l);

#endif
