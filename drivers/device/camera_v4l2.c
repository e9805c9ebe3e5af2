/* open runs in the order that drivers need: node, capabilities, format (and the sensor's),
 * automatic modes off, pace, exposure, buffers, events, stream.
 * Stamps: by the buffer flags, but for uvcvideo, which says "start of exposure" and stamps the
 * arrival of the first packet (uvc_video.c, uvc_video_decode_start): the sensor reads out by then,
 * so that is the end of the first row's exposure. Other clocks than CLOCK_MONOTONIC are replaced
 * by it when the frame is taken, which is the end as well.
 * Sequence numbers and stamps are passed on unchanged; the caller judges them. */
#include "drivers/device/camera_v4l2.h"

#include "drivers/device/unpack.h"
#include "drivers/device/uri.h"
#include "drivers/device/v4l2_format.h"
#include "drivers/device/v4l2_lens.h"
#include "drivers/device/v4l2_queue.h"
#include "drivers/device/v4l2_shutter.h"

#include <errno.h>
#include <linux/videodev2.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { EVENTS_MAX = 16, NAME_MAX_BYTES = 64 };

struct options {
    char subdev[URI_TEXT], lens[URI_TEXT], focus[URI_TEXT];
    double longest_ms;
    int sync;
};

#define AT(field) offsetof(struct options, field)
static const struct uri_key keys[] = {
    {"subdev", AT(subdev), URI_STRING, 0, 0, NULL},
    {"longest_ms", AT(longest_ms), URI_REAL, 0.1, 60000, NULL},
    {"focus", AT(focus), URI_STRING, 0, 0, NULL},
    {"sync", AT(sync), URI_WORD, 0, 0, "off|wired"},
    {"lens", AT(lens), URI_STRING, 0, 0, NULL},
};

#define LENS_MOST 1e6 // any device's units

struct state {
    char path[URI_TEXT];
    struct options opt;
    struct focus focus;
    struct v4l2_node video, sub, motor; // motor: of the lens, if it is a device of its own
    struct v4l2_capability cap;
    struct v4l2_layout layout;
    struct v4l2_shutter shutter;
    struct v4l2_lens lens;
    struct v4l2_queue queue;
    struct camera_info info;
    bool events;
};

/* ---- identity ---- */

static err_t read_uri(struct state *s, const char *uri)
{
    static const char prefix[] = "v4l2:";
    const struct uri_table table = {keys, sizeof keys / sizeof keys[0], &s->opt};
    size_t skip = sizeof prefix - 1;
    if (strncmp(uri, prefix, skip) != 0)
        return err_fail(ERR_ARG, "%.64s: does not begin with \"%s\"", uri, prefix);
    size_t n = strcspn(uri + skip, ",");
    if (n == 0 || n >= sizeof s->path)
        return err_fail(ERR_ARG, "v4l2: a device path of %zu bytes, not 1..%zu", n,
                        sizeof s->path - 1);
    memcpy(s->path, uri + skip, n);
    s->opt.longest_ms = 33.0;
    err_t e = uri_parse("v4l2", uri + skip + n + (uri[skip + n] == ','), &table, 1);
    return e ? e : focus_parse("v4l2", s->opt.focus, LENS_MOST, &s->focus);
}

static err_t check_request(const struct camera_cfg *cfg)
{
    if (cfg->w < 0 || cfg->h < 0)
        return err_fail(ERR_ARG, "%s: pictures of %d x %d px", cfg->uri, cfg->w, cfg->h);
    if ((unsigned)cfg->format >= CAMERA_FORMATS)
        return err_fail(ERR_ARG, "%s: there is no pixel format %d", cfg->uri, (int)cfg->format);
    if (cfg->buffers < 0 || cfg->buffers > CAMERA_BUFFERS_MAX)
        return err_fail(ERR_ARG, "%s: %d buffers, not 1..%d", cfg->uri, cfg->buffers,
                        CAMERA_BUFFERS_MAX);
    return OK;
}

static err_t read_capabilities(struct state *s)
{
    int number = v4l2_sys_ioctl(&s->video, VIDIOC_QUERYCAP, &s->cap);
    if (number)
        return number == ENODEV ? v4l2_sys_fail(&s->video, number, "tell what it is")
                                : err_fail(ERR_UNSUPPORTED, "%s: not a V4L2 device: %s",
                                           s->video.path, strerror(number));
    uint32_t caps = s->cap.capabilities;
    if (caps & V4L2_CAP_DEVICE_CAPS)
        caps = s->cap.device_caps;
    s->layout.mplane = !(caps & V4L2_CAP_VIDEO_CAPTURE);
    if (!(caps & (V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE)))
        return err_fail(ERR_UNSUPPORTED,
                        "%s: does not capture pictures%s; use the node that ends in -video-index0",
                        s->video.path, caps & V4L2_CAP_META_CAPTURE ? " but metadata" : "");
    if (!(caps & V4L2_CAP_STREAMING))
        return err_fail(ERR_UNSUPPORTED, "%s: cannot stream into mapped buffers", s->video.path);
    if ((caps & V4L2_CAP_IO_MC) && !s->opt.subdev[0])
        return err_fail(ERR_UNSUPPORTED,
                        "%s: its sensor is a device of its own: name it (subdev=/dev/v4l-subdevN), "
                        "or use libcamera",
                        s->video.path);
    return OK;
}

/* Printable, without spaces, and fit for the name of a file. */
static void add_word(char unit[CAMERA_UNIT_CAP], const char *text, size_t cap)
{
    size_t n = strlen(unit);
    if (n > 0 && n < CAMERA_UNIT_CAP - 1)
        unit[n++] = '_';
    for (size_t i = 0; i < cap && text[i] && n < CAMERA_UNIT_CAP - 1; i++) {
        char c = text[i];
        unit[n++] = c > ' ' && c < 0x7F && c != '/' ? c : '-';
    }
    unit[n] = '\0';
}

static void name_unit(struct state *s)
{
    add_word(s->info.unit, (const char *)s->cap.bus_info, sizeof s->cap.bus_info);
    add_word(s->info.unit, (const char *)s->cap.card, sizeof s->cap.card);
    if (s->shutter.sensor->name[0])
        add_word(s->info.unit, s->shutter.sensor->name, NAME_MAX_BYTES);
}

/* ---- open and close ---- */

static void v4l2_close(void *st)
{
    struct state *s = st;
    v4l2_queue_close(&s->queue);
    v4l2_sys_close(&s->motor);
    v4l2_sys_close(&s->sub);
    v4l2_sys_close(&s->video);
}

static err_t open_nodes(struct state *s)
{
    err_t e = v4l2_sys_open(&s->video);
    if (!e)
        e = read_capabilities(s);
    if (!e && s->opt.subdev[0])
        e = v4l2_sys_open(&s->sub);
    if (!e && s->opt.lens[0])
        e = v4l2_sys_open(&s->motor);
    return e;
}

static err_t set_format(struct state *s, const struct camera_cfg *cfg)
{
    err_t e = v4l2_format_set(&s->video, cfg, &s->layout);
    if (!e && s->opt.subdev[0])
        e = v4l2_format_pad(&s->sub, &s->layout);
    const struct v4l2_layout *l = &s->layout;
    struct camera_info info = {.w = l->w, .h = l->h, .stride = l->stride, .format = l->format};
    info.bits = l->bits;
    if (!e && unpack_count(&info) == 0)
        e = err_fail(ERR_UNSUPPORTED, "%s: pictures of %dx%d px have odd sides or too many pixels",
                     s->video.path, l->w, l->h);
    return e;
}

static err_t set_controls(struct state *s)
{
    char name[NAME_MAX_BYTES] = "";
    double period_s;
    const struct v4l2_node *node = s->opt.subdev[0] ? &s->sub : &s->video;
    if (node->sys->name(node->sys->ctx, node->fd, name, sizeof name) != 0)
        name[0] = '\0';
    s->shutter.node = *node;
    s->shutter.sensor = v4l2_sensor_find(name);
    err_t e = v4l2_shutter_freeze(&s->video);
    if (!e && s->opt.subdev[0])
        e = v4l2_shutter_freeze(&s->sub);
    s->lens.node = s->opt.lens[0] ? s->motor : s->video;
    if (!e && s->opt.lens[0])
        e = v4l2_shutter_freeze(&s->motor);
    if (!e)
        e = v4l2_lens_open(&s->lens, &s->focus);
    if (!e)
        e = v4l2_format_pace(&s->video, &s->layout, s->opt.longest_ms * 1e-3, &period_s);
    return e ? e : v4l2_shutter_open(&s->shutter, &s->layout, s->opt.longest_ms * 1e-3, period_s);
}

static err_t start_stream(struct state *s, int buffers)
{
    struct v4l2_event_subscription source = {.type = V4L2_EVENT_SOURCE_CHANGE};
    s->queue.node = s->video;
    s->queue.mplane = s->layout.mplane;
    err_t e = v4l2_queue_open(&s->queue, buffers ? buffers : 4, s->layout.least);
    if (e)
        return e;
    s->events = v4l2_sys_ioctl(&s->video, VIDIOC_SUBSCRIBE_EVENT, &source) == 0;
    return v4l2_queue_start(&s->queue);
}

static void fill_info(struct state *s)
{
    const struct v4l2_layout *l = &s->layout;
    struct camera_info *o = &s->info;
    int black = s->shutter.sensor->black;
    bool stamps_start = s->queue.start &&
                        strncmp((const char *)s->cap.driver, "uvcvideo", sizeof s->cap.driver) != 0;
    name_unit(s);
    o->w = l->w;
    o->h = l->h;
    o->stride = l->stride;
    o->format = l->format;
    o->bits = l->bits;
    o->black = l->bits > 8 && black > 0 ? black >> (16 - l->bits) : 0;
    o->buffers = s->queue.n;
    o->stamp = stamps_start ? CAMERA_STAMP_START : CAMERA_STAMP_END;
    o->ends_on_grid = true;
    o->limited = l->limited;
    o->bt709 = l->bt709;
    v4l2_shutter_info(&s->shutter, o);
}

err_t camera_v4l2_open_with(void *st, const struct camera_cfg *cfg, const struct v4l2_sys *sys)
{
    struct state *s = st;
    memset(s, 0, sizeof *s);
    s->video = (struct v4l2_node){sys, s->path, -1};
    s->sub = (struct v4l2_node){sys, s->opt.subdev, -1};
    s->motor = (struct v4l2_node){sys, s->opt.lens, -1};
    err_t e = read_uri(s, cfg->uri);
    if (!e)
        e = check_request(cfg);
    if (!e)
        e = open_nodes(s);
    if (!e)
        e = set_format(s, cfg);
    if (!e)
        e = set_controls(s);
    if (!e)
        e = start_stream(s, cfg->buffers);
    if (!e)
        fill_info(s);
    else
        v4l2_close(s);
    return e;
}

static err_t v4l2_open(void *st, const struct camera_cfg *cfg)
{
    return camera_v4l2_open_with(st, cfg, &v4l2_sys_libc);
}

/* ---- use ---- */

static void v4l2_info(const void *st, struct camera_info *out)
{
    *out = ((const struct state *)st)->info;
}

static int v4l2_fd(const void *st)
{
    return ((const struct state *)st)->video.fd;
}

static err_t v4l2_request(void *st, const struct exposure *requested, struct exposure *set)
{
    struct state *s = st;
    if (!(isfinite(requested->time_s) && requested->time_s > 0.0 && isfinite(requested->gain) &&
          requested->gain > 0.0))
        return err_fail(ERR_ARG, "%s: an exposure of %g s with gain %g", s->video.path,
                        requested->time_s, requested->gain);
    if (v4l2_queue_check(&s->queue) != OK)
        return ERR_LOST;
    err_t e = v4l2_shutter_request(&s->shutter, requested, set);
    if (e == ERR_LOST)
        s->queue.lost = V4L2_UNPLUGGED;
    return e;
}

/* A change of the source behind the node means another camera. */
static err_t read_events(struct state *s, const struct v4l2_node *n)
{
    struct v4l2_event ev = {0};
    for (int i = 0; i < EVENTS_MAX && v4l2_sys_ioctl(n, VIDIOC_DQEVENT, &ev) == 0; i++) {
        if (ev.type == V4L2_EVENT_SOURCE_CHANGE)
            return v4l2_queue_lose(&s->queue, "its source changed; open it again");
        v4l2_lens_event(&s->lens, &ev);
    }
    return OK;
}

static err_t v4l2_next(void *st, struct frame *out)
{
    struct state *s = st;
    const struct v4l2_layout *l = &s->layout;
    struct v4l2_queue_item item;
    memset(out, 0, sizeof *out);
    err_t e = s->events ? read_events(s, &s->video) : OK;
    if (!e && s->lens.events)
        e = read_events(s, &s->lens.node);
    if (!e)
        e = v4l2_queue_take(&s->queue, &item);
    if (e)
        return e;
    if (v4l2_shutter_shifted(&s->shutter) == ERR_LOST) // else with the next frame
        s->queue.lost = V4L2_UNPLUGGED;
    bool is_short = item.bytes < l->least || item.bytes < 1;
    *out = (struct frame){.data = item.data,
                          .bytes = item.bytes,
                          .w = l->w,
                          .h = l->h,
                          .stride = l->stride,
                          .format = l->format,
                          .sequence = item.sequence,
                          .timestamp_ns = item.timestamp_ns,
                          .flags = (item.error ? FRAME_ERROR : 0u) | (is_short ? FRAME_SHORT : 0u),
                          .lens_known = s->lens.known,
                          .lens = (double)s->lens.position,
                          .index = item.index};
    return OK;
}

static err_t v4l2_shift(void *st, double seconds, double *shift)
{
    struct state *s = st;
    if (v4l2_queue_check(&s->queue) != OK)
        return ERR_LOST;
    if (s->opt.sync)
        return err_fail(ERR_UNSUPPORTED, "%s: its frames are locked to a line", s->video.path);
    err_t e = v4l2_shutter_shift(&s->shutter, seconds, shift);
    if (e == ERR_LOST)
        s->queue.lost = V4L2_UNPLUGGED;
    return e;
}

static void v4l2_release(void *st, struct frame *f)
{
    struct state *s = st;
    if (f->data)
        v4l2_queue_give(&s->queue, f->index);
    memset(f, 0, sizeof *f);
}

static err_t v4l2_focus(void *st, bool again)
{
    struct state *s = st;
    if (v4l2_queue_check(&s->queue) != OK)
        return ERR_LOST;
    err_t e = v4l2_lens_focus(&s->lens, again);
    if (e == ERR_LOST)
        s->queue.lost = V4L2_UNPLUGGED;
    return e;
}

const struct camera_ops camera_v4l2 = {.name = "v4l2",
                                       .state_bytes = sizeof(struct state),
                                       .open = v4l2_open,
                                       .close = v4l2_close,
                                       .info = v4l2_info,
                                       .fd = v4l2_fd,
                                       .request = v4l2_request,
                                       .shift = v4l2_shift,
                                       .next = v4l2_next,
                                       .release = v4l2_release,
                                       .focus = v4l2_focus};
