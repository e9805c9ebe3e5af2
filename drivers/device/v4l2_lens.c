/* The position is read when it is set or found and then follows the events of the control: reading
 * it for every frame would be a transfer over USB each. */
#include "drivers/device/v4l2_lens.h"

#include "drivers/device/v4l2_control.h"

#include <linux/videodev2.h>

static void read_position(struct v4l2_lens *l)
{
    l->known = v4l2_control_get(&l->node, V4L2_CID_FOCUS_ABSOLUTE, &l->position) == 0;
}

static err_t move_lens(struct v4l2_lens *l, const struct v4l2_range *r)
{
    const struct v4l2_node *n = &l->node;
    double to = l->want.position;
    if (to < (double)r->lo || to > (double)r->hi)
        return err_fail(ERR_ARG, "%s: focus=%g is outside of its %lld..%lld", n->path, to,
                        (long long)r->lo, (long long)r->hi);
    int64_t now, want = v4l2_control_fit((int64_t)to, r->lo, r->hi, r->step);
    int number = v4l2_control_set(n, V4L2_CID_FOCUS_ABSOLUTE, want);
    if (!number)
        number = v4l2_control_get(n, V4L2_CID_FOCUS_ABSOLUTE, &now);
    if (number)
        return v4l2_sys_fail(n, number, "set its focus");
    return now == want ? OK
                       : err_fail(ERR_IO, "%s: focus was set to %lld, but it reads %lld", n->path,
                                  (long long)want, (long long)now);
}

/* Refuse a request that this lens cannot do. */
static err_t check_abilities(const struct v4l2_lens *l, const struct v4l2_range *r)
{
    const char *path = l->node.path;
    struct v4l2_range start, status;
    bool moves = v4l2_control_there(r) && !r->fixed;
    err_t e = v4l2_control_query(&l->node, V4L2_CID_AUTO_FOCUS_START, &start);
    if (!e)
        e = v4l2_control_query(&l->node, V4L2_CID_AUTO_FOCUS_STATUS, &status);
    if (e)
        return e;
    bool searches = v4l2_control_there(&start) && v4l2_control_there(&status);
    if (l->want.once ? searches : moves)
        return OK;
    if (!moves)
        return err_fail(ERR_UNSUPPORTED, "%s: its focus is fixed: leave focus= out", path);
    return err_fail(ERR_UNSUPPORTED,
                    "%s: cannot search its focus (it has no auto_focus_start and _status): give a "
                    "position in %lld..%lld",
                    path, (long long)r->lo, (long long)r->hi);
}

err_t v4l2_lens_open(struct v4l2_lens *l, const struct focus *want)
{
    struct v4l2_event_subscription moves = {.type = V4L2_EVENT_CTRL, .id = V4L2_CID_FOCUS_ABSOLUTE};
    struct v4l2_range r;
    l->want = *want;
    err_t e = v4l2_control_query(&l->node, V4L2_CID_FOCUS_ABSOLUTE, &r);
    if (!e && (want->once || want->position >= 0.0))
        e = check_abilities(l, &r);
    if (!e && want->position >= 0.0)
        e = move_lens(l, &r);
    if (e || !v4l2_control_there(&r))
        return e;
    l->events = v4l2_sys_ioctl(&l->node, VIDIOC_SUBSCRIBE_EVENT, &moves) == 0;
    read_position(l);
    return OK;
}

static err_t search_fails(const struct v4l2_lens *l, int number)
{
    err_t e = v4l2_sys_fail(&l->node, number, "search its focus");
    return e == ERR_LOST || e == ERR_BUSY ? e : err_fail(ERR_IO, "%s", err_text());
}

static err_t begin_search(struct v4l2_lens *l)
{
    const struct v4l2_sys *sys = l->node.sys;
    int number = v4l2_control_set(&l->node, V4L2_CID_AUTO_FOCUS_START, 1);
    l->until_ns = 0;
    l->found = false;
    if (number)
        return search_fails(l, number);
    l->until_ns = sys->clock_ns(sys->ctx) + INT64_C(1000000000) * FOCUS_SEARCH_S;
    return ERR_AGAIN;
}

err_t v4l2_lens_focus(struct v4l2_lens *l, bool again)
{
    const struct v4l2_sys *sys = l->node.sys;
    int64_t status;
    if (!l->want.once || (l->found && !again))
        return OK;
    if (again || !l->until_ns)
        return begin_search(l);
    int number = v4l2_control_get(&l->node, V4L2_CID_AUTO_FOCUS_STATUS, &status);
    bool late = sys->clock_ns(sys->ctx) >= l->until_ns;
    bool over = number || late || (status & V4L2_AUTO_FOCUS_STATUS_FAILED);
    l->found = !number && !(status & V4L2_AUTO_FOCUS_STATUS_BUSY) &&
               (status & V4L2_AUTO_FOCUS_STATUS_REACHED);
    if (!l->found && !over)
        return ERR_AGAIN;
    l->until_ns = 0;
    read_position(l);
    if (number)
        return search_fails(l, number);
    return l->found ? OK
                    : err_fail(ERR_TIMEOUT, "%s: found no focus%s", l->node.path,
                               status & V4L2_AUTO_FOCUS_STATUS_FAILED ? "" : " in time");
}

void v4l2_lens_event(struct v4l2_lens *l, const struct v4l2_event *ev)
{
    bool value = ev->u.ctrl.changes & V4L2_EVENT_CTRL_CH_VALUE;
    if (ev->type == V4L2_EVENT_CTRL && ev->id == V4L2_CID_FOCUS_ABSOLUTE && value) {
        l->known = true;
        l->position = ev->u.ctrl.value;
    }
}
