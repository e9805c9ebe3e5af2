#include "drivers/device/v4l2_control.h"

#include <errno.h>
#include <linux/videodev2.h>

int v4l2_control_get(const struct v4l2_node *n, uint32_t id, int64_t *value)
{
    struct v4l2_ext_control c = {.id = id};
    struct v4l2_ext_controls all = {.which = V4L2_CTRL_WHICH_CUR_VAL, .count = 1, .controls = &c};
    int number = v4l2_sys_ioctl(n, VIDIOC_G_EXT_CTRLS, &all);
    *value = number ? 0 : id == V4L2_CID_PIXEL_RATE ? c.value64 : c.value;
    return number;
}

int v4l2_control_set(const struct v4l2_node *n, uint32_t id, int64_t value)
{
    struct v4l2_ext_control c = {.id = id, .value = (int32_t)value};
    struct v4l2_ext_controls all = {.which = V4L2_CTRL_WHICH_CUR_VAL, .count = 1, .controls = &c};
    return v4l2_sys_ioctl(n, VIDIOC_S_EXT_CTRLS, &all);
}

err_t v4l2_control_query(const struct v4l2_node *n, uint32_t id, struct v4l2_range *out)
{
    struct v4l2_query_ext_ctrl q = {.id = id};
    *out = (struct v4l2_range){.lo = 0, .hi = -1, .step = 1};
    int number = v4l2_sys_ioctl(n, VIDIOC_QUERY_EXT_CTRL, &q);
    if (number == ENODEV)
        return v4l2_sys_fail(n, number, "describe its controls");
    bool whole = id == V4L2_CID_PIXEL_RATE || (q.minimum >= INT32_MIN && q.maximum <= INT32_MAX);
    if (number || (q.flags & V4L2_CTRL_FLAG_DISABLED) || !whole)
        return OK;
    out->lo = q.minimum;
    out->hi = q.maximum;
    out->step = q.step > 0 && q.step <= INT32_MAX ? (int64_t)q.step : 1;
    out->usual = q.default_value < q.minimum   ? q.minimum
                 : q.default_value > q.maximum ? q.maximum
                                               : q.default_value;
    out->fixed = (q.flags & V4L2_CTRL_FLAG_READ_ONLY) != 0;
    return OK;
}

bool v4l2_control_there(const struct v4l2_range *r)
{
    return r->lo <= r->hi;
}

int64_t v4l2_control_fit(int64_t v, int64_t lo, int64_t hi, int64_t step)
{
    v = v > hi ? hi : v;
    return v < lo ? lo : lo + (v - lo) / step * step;
}
