/* v4l2_lens.h - the lens of a V4L2 device: move it, search focus, read its position.
 * Positions are those of V4L2_CID_FOCUS_ABSOLUTE; most devices count from far to near.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_LENS_H
#define DEVICE_V4L2_LENS_H

#include "drivers/device/focus.h"
#include "drivers/device/v4l2_sys.h"

#include <stdint.h>

struct v4l2_event;

struct v4l2_lens {
    struct v4l2_node node; // that has the controls; not owned
    struct focus want;
    bool found;       // a search has, since open
    int64_t until_ns; // when the running search ends; 0: none runs
    bool events;      // come when another program moves it
    bool known;       // the position, as read back
    int64_t position;
};

/* l: with node. After v4l2_shutter_freeze.
 * err:  ERR_UNSUPPORTED (no control that does it), ERR_ARG (names the range), ERR_LOST, ERR_IO */
MUST_USE err_t v4l2_lens_open(struct v4l2_lens *l, const struct focus *want);

/* See camera_ops.focus. */
MUST_USE err_t v4l2_lens_focus(struct v4l2_lens *l, bool again);

/* Handle an event of the node: another program has moved the lens. */
void v4l2_lens_event(struct v4l2_lens *l, const struct v4l2_event *ev);

#endif
