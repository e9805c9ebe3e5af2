/* v4l2_control.h - single controls of a V4L2 node, one system call each.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_CONTROL_H
#define DEVICE_V4L2_CONTROL_H

#include "drivers/device/v4l2_sys.h"

#include <stdbool.h>

struct v4l2_range {
    int64_t lo, hi, step, usual; // hi < lo: no such control
    bool fixed;                  // read only
};

/* 0, or errno. */
int v4l2_control_get(const struct v4l2_node *n, uint32_t id, int64_t *value);
int v4l2_control_set(const struct v4l2_node *n, uint32_t id, int64_t value);

/* A control that the device does not describe counts as missing.
 * err:  ERR_LOST */
MUST_USE err_t v4l2_control_query(const struct v4l2_node *n, uint32_t id, struct v4l2_range *out);
bool v4l2_control_there(const struct v4l2_range *r);

/* Round down to a value that the control can have. */
int64_t v4l2_control_fit(int64_t v, int64_t lo, int64_t hi, int64_t step);

#endif
