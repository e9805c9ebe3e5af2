/* v4l2_fake.h - a V4L2 driver in a table of system calls: formats, controls with ranges and flags,
 * a queue, exposures that act some frames later, and everything that can go wrong. It watches its
 * user: what a driver would not expect (a buffer queued twice, memory that stays mapped, a call
 * without device) is a breach, which the test looks for. Frames carry the exposure code that made
 * them in their first four bytes.
 * thread: one. */
#ifndef DEVICE_V4L2_FAKE_H
#define DEVICE_V4L2_FAKE_H

#include "drivers/device/v4l2_sys.h"

#include <errno.h>
#include <linux/media-bus-format.h>
#include <linux/v4l2-subdev.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum {
    FAKE_CONTROLS = 48,
    FAKE_BUFFERS = 40,
    FAKE_LIST = 8,
    FAKE_LATE = 64,
    FAKE_MEMORY = 1 << 18
};

enum fake_clock {
    FAKE_MANUAL,  // frames come by fake_frame
    FAKE_VIRTUAL, // by asking for one
    FAKE_REAL     // by time
};

struct fake_control {
    uint32_t id, flags;
    int64_t lo, hi, step, usual, value;
    int refuse; // errno of writing it
    bool stuck; // takes every value and keeps its own
};

struct fake_buffer {
    uint8_t *p; // mapped
    size_t mapped;
    bool queued, done;
    struct v4l2_buffer b;
    uint32_t bytes, offset;
};

struct fake {
    struct v4l2_sys sys;
    // what it is
    char driver[16], card[32], bus[32], sensor[64];
    uint32_t caps, stamp_flags, colours, matrix, range;
    bool mplane, sub; // the controls are on the sub-device
    bool lens;        // ... and those of the focus on another one
    int search;       // looks until a search ends, at 77; 0: never
    bool in_vain;     // it finds nothing
    uint32_t fourcc[FAKE_LIST], bus_code;
    int w[FAKE_LIST], h[FAKE_LIST];
    struct v4l2_fract pace[FAKE_LIST]; // rising
    struct fake_control control[FAKE_CONTROLS];
    int n_controls, margin, late; // lines; frames until an exposure acts
    enum fake_clock clock;
    int64_t start_ns;
    // what it does wrong; 0: nothing
    int open_errno, lost_at, stall_at; // frame
    uint32_t wrong_w, wrong_fourcc, wrong_stride, wrong_image, wrong_field, wrong_planes;
    uint32_t wrong_length, wrong_count;
    bool no_stride;
    char node[512]; // file that must be there
    // for the next frame
    uint32_t flags, cut, index_add, offset;
    bool overlong;
    // counts of calls
    long calls, fail_at; // count of all; the one that fails, from 1
    bool fail_on;        // and all after it
    int fail_errno;
    unsigned long fail_request; // counts only those
    uint32_t liar;              // one answer in so many has a wrong byte
    uint32_t dice;
    // state
    struct v4l2_format fmt;
    struct v4l2_fract now_pace;
    struct fake_buffer buf[FAKE_BUFFERS];
    int fifo[FAKE_BUFFERS], n_fifo; // queued, oldest first
    int ready[FAKE_BUFFERS], n_ready;
    int n, fd, sub_fd, lens_fd, fds, maps;
    bool streaming, lost, fatal, source_changed, lens_changed, on_lens; // on_lens: this call is
    uint32_t sequence;
    int64_t armed_ns, number, now_ns, history[FAKE_LATE];
    int offs;           // VIDIOC_STREAMOFF so far
    int left, searches; // looks of the one that runs; so far
    char breach[200];
};

static inline void fake_breach(struct fake *f, const char *what)
{
    if (!f->breach[0])
        snprintf(f->breach, sizeof f->breach, "call %ld: %s", f->calls, what);
}

static inline int fake_errno(int number)
{
    errno = number;
    return number ? -1 : 0;
}

static inline struct fake_control *fake_control(struct fake *f, uint32_t id)
{
    for (int i = 0; i < f->n_controls; i++)
        if (f->control[i].id == id)
            return &f->control[i];
    return NULL;
}

static inline bool fake_is_lens(uint32_t id)
{
    return id == V4L2_CID_FOCUS_ABSOLUTE || id == V4L2_CID_FOCUS_AUTO ||
           id == V4L2_CID_AUTO_FOCUS_START || id == V4L2_CID_AUTO_FOCUS_STATUS;
}

/* State of the node that is called. */
static inline struct fake_control *fake_reach(struct fake *f, uint32_t id)
{
    return f->on_lens == (f->lens && fake_is_lens(id)) ? fake_control(f, id) : NULL;
}

static inline void fake_add(struct fake *f, uint32_t id, int64_t lo, int64_t hi, int64_t usual)
{
    f->control[f->n_controls++] =
        (struct fake_control){.id = id, .lo = lo, .hi = hi, .step = 1, .usual = usual, .value = hi};
}

/* ---- frames ---- */

static inline int64_t fake_code(struct fake *f)
{
    struct fake_control *c = fake_control(f, V4L2_CID_EXPOSURE_ABSOLUTE);
    c = c ? c : fake_control(f, V4L2_CID_EXPOSURE);
    return c ? c->value : 0;
}

static inline int64_t fake_period_ns(const struct fake *f)
{
    return (int64_t)(1e9 * f->now_pace.numerator / f->now_pace.denominator);
}

static inline uint32_t fake_image(const struct fake *f)
{
    return f->mplane ? f->fmt.fmt.pix_mp.plane_fmt[0].sizeimage : f->fmt.fmt.pix.sizeimage;
}

static inline uint32_t fake_length(const struct fake *f)
{
    return f->wrong_length ? f->wrong_length : fake_image(f) + 64;
}

static inline void fake_fill(struct fake *f, struct fake_buffer *b, int64_t stamp_ns)
{
    int32_t code = (int32_t)f->history[(f->number + FAKE_LATE - f->late) % FAKE_LATE];
    b->bytes = fake_image(f) - f->cut + f->offset;
    b->offset = f->offset;
    if (f->overlong)
        b->bytes = fake_length(f) + 1;
    if (b->p && f->offset + sizeof code <= b->mapped)
        memcpy(b->p + f->offset, &code, sizeof code);
    b->b.sequence = f->sequence;
    b->b.flags = f->flags | f->stamp_flags;
    b->b.timestamp.tv_sec = stamp_ns / 1000000000;
    b->b.timestamp.tv_usec = stamp_ns % 1000000000 / 1000;
    f->flags = f->cut = f->offset = 0;
    f->overlong = false;
}

/* One frame ends. */
static inline void fake_frame(struct fake *f)
{
    if (!f->streaming || f->lost)
        return;
    f->now_ns += fake_period_ns(f);
    f->history[f->number % FAKE_LATE] = fake_code(f);
    if (f->lost_at && f->number >= f->lost_at) {
        f->lost = true;
        return;
    }
    if (f->stall_at && f->number >= f->stall_at)
        return;
    if (f->n_fifo > 0 && f->n_fifo <= FAKE_BUFFERS) {
        int i = f->fifo[0];
        memmove(f->fifo, f->fifo + 1, (size_t)--f->n_fifo * sizeof f->fifo[0]);
        fake_fill(f, &f->buf[i], f->now_ns);
        f->buf[i].done = true;
        f->ready[f->n_ready++] = i;
    }
    f->number++;
    f->sequence++;
}

static inline int64_t fake_clock_ns(void *ctx)
{
    struct fake *f = ctx;
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return f->clock == FAKE_REAL ? (int64_t)t.tv_sec * 1000000000 + t.tv_nsec : f->now_ns;
}

static inline void fake_pass(struct fake *f)
{
    if (f->node[0] && access(f->node, F_OK) != 0)
        f->lost = true;
    if (f->clock == FAKE_REAL && f->streaming && !f->lost)
        while (f->now_ns + fake_period_ns(f) <= fake_clock_ns(f) && !f->lost &&
               !(f->stall_at && f->number >= f->stall_at))
            fake_frame(f);
}

/* Readable when a frame waits, or will. */
static inline void fake_arm(struct fake *f)
{
    int64_t t = 0;
    if (f->fd < 0)
        return;
    bool runs = f->streaming && !(f->stall_at && f->number >= f->stall_at);
    if (f->clock == FAKE_REAL && runs)
        t = f->now_ns + fake_period_ns(f);
    if (f->lost || f->n_ready > 0 || (f->clock == FAKE_VIRTUAL && runs))
        t = 1;
    if (t == f->armed_ns)
        return;
    f->armed_ns = t;
    struct itimerspec spec = {.it_value = {t / 1000000000, t % 1000000000}};
    timerfd_settime(f->fd, TFD_TIMER_ABSTIME, &spec, NULL);
}

/* ---- formats ---- */

static inline uint32_t fake_row(uint32_t fourcc, uint32_t w)
{
    bool rgb = fourcc == V4L2_PIX_FMT_RGB24 || fourcc == V4L2_PIX_FMT_BGR24;
    bool bytes = fourcc == V4L2_PIX_FMT_NV12 || fourcc == V4L2_PIX_FMT_GREY;
    return rgb                               ? 3 * w
           : bytes                           ? w
           : fourcc == V4L2_PIX_FMT_MJPEG    ? 0
           : fourcc == V4L2_PIX_FMT_SRGGB10P ? (w + 3) / 4 * 5
           : fourcc == V4L2_PIX_FMT_SRGGB12P ? (w + 1) / 2 * 3
                                             : 2 * w;
}

static inline void fake_put_format(struct fake *f, uint32_t w, uint32_t h, uint32_t fourcc)
{
    uint32_t row = fake_row(fourcc, w), rows = fourcc == V4L2_PIX_FMT_NV12 ? h / 2 * 3 : h;
    uint32_t stride = row ? row + 8 : 0, image = stride ? stride * rows : w * h;
    stride = f->wrong_stride ? f->wrong_stride : f->no_stride ? 0 : stride;
    image = f->wrong_image ? f->wrong_image : image;
    w = f->wrong_w ? f->wrong_w : w;
    fourcc = f->wrong_fourcc ? f->wrong_fourcc : fourcc;
    uint32_t field = f->wrong_field ? f->wrong_field : V4L2_FIELD_NONE;
    if (f->mplane) {
        struct v4l2_pix_format_mplane *m = &f->fmt.fmt.pix_mp;
        *m = (struct v4l2_pix_format_mplane){.width = w, .height = h, .pixelformat = fourcc};
        m->field = field;
        m->colorspace = f->colours;
        m->ycbcr_enc = (uint8_t)f->matrix;
        m->quantization = (uint8_t)f->range;
        m->num_planes = (uint8_t)(f->wrong_planes ? f->wrong_planes : 1);
        m->plane_fmt[0].bytesperline = stride;
        m->plane_fmt[0].sizeimage = image;
        return;
    }
    f->fmt.fmt.pix = (struct v4l2_pix_format){.width = w,
                                              .height = h,
                                              .pixelformat = fourcc,
                                              .field = field,
                                              .bytesperline = stride,
                                              .sizeimage = image,
                                              .colorspace = f->colours,
                                              .ycbcr_enc = f->matrix,
                                              .quantization = f->range};
}

/* As drivers do: the nearest of what there is. */
static inline int fake_set_format(struct fake *f, struct v4l2_format *a)
{
    uint32_t w = f->mplane ? a->fmt.pix_mp.width : a->fmt.pix.width;
    uint32_t h = f->mplane ? a->fmt.pix_mp.height : a->fmt.pix.height;
    uint32_t fourcc = f->mplane ? a->fmt.pix_mp.pixelformat : a->fmt.pix.pixelformat;
    int size = 0, code = 0;
    if (f->n > 0)
        fake_breach(f, "S_FMT with buffers");
    for (int i = 0; i < FAKE_LIST && f->w[i]; i++)
        if (f->w[i] == (int)w && f->h[i] == (int)h)
            size = i;
    for (int i = 0; i < FAKE_LIST && f->fourcc[i]; i++)
        if (f->fourcc[i] == fourcc)
            code = i;
    fake_put_format(f, (uint32_t)f->w[size], (uint32_t)f->h[size], f->fourcc[code]);
    a->fmt = f->fmt.fmt;
    return 0;
}

static inline int fake_list(struct fake *f, unsigned long request, void *arg)
{
    if (request == VIDIOC_ENUM_FMT) {
        struct v4l2_fmtdesc *d = arg;
        if (d->index >= FAKE_LIST || !f->fourcc[d->index])
            return EINVAL;
        d->pixelformat = f->fourcc[d->index];
        return 0;
    }
    if (request == VIDIOC_ENUM_FRAMESIZES) {
        struct v4l2_frmsizeenum *s = arg;
        if (s->index >= FAKE_LIST || !f->w[s->index])
            return EINVAL;
        s->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        s->discrete.width = (uint32_t)f->w[s->index];
        s->discrete.height = (uint32_t)f->h[s->index];
        return 0;
    }
    struct v4l2_frmivalenum *v = arg;
    if (v->index >= FAKE_LIST || !f->pace[v->index].denominator)
        return EINVAL;
    v->type = V4L2_FRMIVAL_TYPE_DISCRETE;
    v->discrete = f->pace[v->index];
    return 0;
}

static inline int fake_parm(struct fake *f, unsigned long request, struct v4l2_streamparm *p)
{
    if (f->sub || !f->pace[0].denominator)
        return ENOTTY;
    if (request == VIDIOC_S_PARM) {
        if (f->n > 0)
            fake_breach(f, "S_PARM with buffers");
        f->now_pace = p->parm.capture.timeperframe;
    }
    p->parm.capture.capability = V4L2_CAP_TIMEPERFRAME;
    p->parm.capture.timeperframe = f->now_pace;
    return 0;
}

static inline int fake_pad(struct fake *f, unsigned long request, struct v4l2_subdev_format *p)
{
    if (request == VIDIOC_SUBDEV_G_FMT) {
        p->format.width = 64;
        p->format.height = 48;
        p->format.code = MEDIA_BUS_FMT_SBGGR8_1X8;
    } else if (f->bus_code) {
        p->format.code = f->bus_code;
    }
    return 0;
}

/* ---- controls ---- */

static inline int fake_query(struct fake *f, struct v4l2_query_ext_ctrl *q)
{
    struct fake_control *c = fake_reach(f, q->id), *a;
    if (!c)
        return EINVAL;
    q->minimum = c->lo;
    q->maximum = c->hi;
    q->step = (uint64_t)c->step;
    q->default_value = c->usual;
    q->flags = c->flags;
    a = fake_control(f, V4L2_CID_EXPOSURE_AUTO);
    if (c->id == V4L2_CID_EXPOSURE_ABSOLUTE && a && a->value != V4L2_EXPOSURE_MANUAL)
        q->flags |= V4L2_CTRL_FLAG_INACTIVE;
    return 0;
}

static inline bool fake_owned(struct fake *f, uint32_t id)
{
    struct fake_control *a = fake_control(f, V4L2_CID_EXPOSURE_AUTO);
    struct fake_control *b = fake_control(f, V4L2_CID_AUTO_WHITE_BALANCE);
    return (id == V4L2_CID_EXPOSURE_ABSOLUTE && a && a->value != V4L2_EXPOSURE_MANUAL &&
            a->value != V4L2_EXPOSURE_SHUTTER_PRIORITY) ||
           (id == V4L2_CID_WHITE_BALANCE_TEMPERATURE && b && b->value != 0);
}

static inline int64_t fake_clamp(const struct fake_control *c, int64_t v)
{
    v = v < c->lo ? c->lo : v > c->hi ? c->hi : v;
    v = c->lo + (v - c->lo + c->step / 2) / c->step * c->step; // the nearest
    return v > c->hi ? v - c->step : v;
}

static inline int fake_set(struct fake *f, struct fake_control *c, int64_t v)
{
    if (c->refuse)
        return c->refuse;
    if (c->stuck)
        return 0;
    c->value = fake_clamp(c, v);
    struct fake_control *e = fake_control(f, V4L2_CID_EXPOSURE);
    if (c->id == V4L2_CID_VBLANK && e && f->margin) {
        e->hi = f->h[0] + c->value - f->margin;
        e->value = fake_clamp(e, e->value);
    }
    return 0;
}

/* Values of menus and switches are not clamped but refused. */
static inline int fake_check(struct fake *f, const struct fake_control *c, int64_t v)
{
    if (c->flags & V4L2_CTRL_FLAG_READ_ONLY)
        return EACCES;
    if (c->flags & V4L2_CTRL_FLAG_GRABBED)
        return EBUSY;
    if (fake_owned(f, c->id))
        return EACCES;
    return c->id == V4L2_CID_EXPOSURE_AUTO && (v < c->lo || v > c->hi) ? EINVAL : 0;
}

/* A search runs while its status is looked at. */
static inline void fake_search(struct fake *f, unsigned long request, struct fake_control *c)
{
    struct fake_control *at = fake_control(f, V4L2_CID_FOCUS_ABSOLUTE);
    struct fake_control *status = fake_control(f, V4L2_CID_AUTO_FOCUS_STATUS);
    if (c->id == V4L2_CID_AUTO_FOCUS_START && request == VIDIOC_S_EXT_CTRLS) {
        f->left = f->search;
        f->searches++;
        status->value = V4L2_AUTO_FOCUS_STATUS_BUSY;
    }
    if (c != status || f->left == 0 || --f->left > 0)
        return;
    status->value = f->in_vain ? V4L2_AUTO_FOCUS_STATUS_FAILED : V4L2_AUTO_FOCUS_STATUS_REACHED;
    at->value = f->in_vain ? at->hi : 77;
}

static inline int fake_controls(struct fake *f, unsigned long request, struct v4l2_ext_controls *a)
{
    a->error_idx = a->count;
    for (uint32_t i = 0; i < a->count; i++) { // nothing is written unless all may be
        struct fake_control *c = fake_reach(f, a->controls[i].id);
        int number = !c                              ? EINVAL
                     : request == VIDIOC_S_EXT_CTRLS ? fake_check(f, c, a->controls[i].value)
                                                     : 0;
        if (number)
            return number;
    }
    for (uint32_t i = 0; i < a->count; i++) {
        struct fake_control *c = fake_control(f, a->controls[i].id);
        int number = 0;
        fake_search(f, request, c);
        if (request == VIDIOC_S_EXT_CTRLS)
            number = fake_set(f, c, a->controls[i].value);
        else if (c->id == V4L2_CID_PIXEL_RATE)
            a->controls[i].value64 = c->value;
        else
            a->controls[i].value = (int32_t)c->value;
        if (number) {
            a->error_idx = i;
            return number;
        }
    }
    return 0;
}

/* ---- queue ---- */

static inline int fake_request(struct fake *f, struct v4l2_requestbuffers *r)
{
    if (f->streaming)
        return EBUSY;
    if (f->maps > 0)
        fake_breach(f, "REQBUFS with memory mapped");
    if (r->count && f->wrong_count)
        r->count = f->wrong_count;
    memset(f->buf, 0, sizeof f->buf);
    f->n = (int)r->count;
    f->n_fifo = f->n_ready = 0;
    return 0;
}

static inline void fake_tell(struct fake *f, struct v4l2_buffer *out, int i)
{
    struct fake_buffer *b = &f->buf[i];
    struct v4l2_plane *plane = out->m.planes;
    uint32_t type = out->type;
    *out = b->b;
    out->index = (uint32_t)i + f->index_add;
    out->type = type;
    out->memory = V4L2_MEMORY_MMAP;
    f->index_add = 0;
    if (f->mplane) {
        out->length = 1;
        out->m.planes = plane;
        plane[0].length = fake_length(f);
        plane[0].m.mem_offset = (uint32_t)(i * 4096);
        plane[0].bytesused = b->bytes;
        plane[0].data_offset = b->offset;
        return;
    }
    out->length = fake_length(f);
    out->m.offset = (uint32_t)(i * 4096);
    out->bytesused = b->bytes;
}

static inline int fake_buffer(struct fake *f, unsigned long request, struct v4l2_buffer *b)
{
    uint32_t type = f->mplane ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (b->type != type || b->memory != V4L2_MEMORY_MMAP || (f->mplane && !b->m.planes))
        fake_breach(f, "buffer type");
    if (request == VIDIOC_DQBUF) {
        if (f->fatal || !f->streaming)
            return f->fatal ? EIO : EINVAL;
        if (f->clock == FAKE_VIRTUAL && f->n_ready == 0)
            fake_frame(f);
        if (f->lost || f->n_ready == 0)
            return f->lost ? ENODEV : EAGAIN;
        int i = f->ready[0];
        memmove(f->ready, f->ready + 1, (size_t)--f->n_ready * sizeof f->ready[0]);
        f->buf[i].queued = f->buf[i].done = false;
        fake_tell(f, b, i);
        return 0;
    }
    if (b->index >= (uint32_t)f->n)
        return EINVAL;
    if (request == VIDIOC_QUERYBUF) {
        f->buf[b->index].b.flags = f->stamp_flags;
        fake_tell(f, b, (int)b->index);
        return 0;
    }
    if (f->fatal)
        return EIO;
    if (f->buf[b->index].queued || b->flags)
        fake_breach(f, "QBUF of a buffer that is queued, or with flags");
    f->buf[b->index].queued = true;
    f->fifo[f->n_fifo++] = (int)b->index;
    return 0;
}

static inline int fake_stream(struct fake *f, bool on)
{
    if (on && f->n_fifo == 0 && f->offs == 0)
        fake_breach(f, "STREAMON without buffers");
    if (!on) {
        for (int i = 0; i < f->n; i++)
            f->buf[i].queued = f->buf[i].done = false;
        f->n_fifo = f->n_ready = 0;
        f->fatal = false;
        f->offs++;
    } else {
        f->now_ns = fake_clock_ns(f);
        f->sequence = 0;
    }
    f->streaming = on;
    return 0;
}

/* ---- system calls ---- */

static inline int fake_refuses(struct fake *f, unsigned long request)
{
    if (f->fail_request && request != f->fail_request)
        return 0;
    f->calls++;
    if (!f->fail_at || f->calls < f->fail_at || (f->calls > f->fail_at && !f->fail_on))
        return 0;
    f->lost = f->lost || f->fail_errno == ENODEV;
    return f->fail_errno;
}

static inline int fake_event(struct fake *f, struct v4l2_event *ev)
{
    if (f->lens_changed && f->on_lens == f->lens) {
        f->lens_changed = false;
        *ev = (struct v4l2_event){.type = V4L2_EVENT_CTRL, .id = V4L2_CID_FOCUS_ABSOLUTE};
        ev->u.ctrl.changes = V4L2_EVENT_CTRL_CH_VALUE;
        ev->u.ctrl.value = (int32_t)fake_control(f, V4L2_CID_FOCUS_ABSOLUTE)->value;
        return 0;
    }
    ev->type = V4L2_EVENT_SOURCE_CHANGE;
    return f->source_changed && !f->on_lens ? 0 : ENOENT;
}

static inline int fake_dispatch(struct fake *f, unsigned long request, void *arg)
{
    switch (request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *c = arg;
        memcpy(c->driver, f->driver, sizeof f->driver);
        memcpy(c->card, f->card, sizeof f->card);
        memcpy(c->bus_info, f->bus, sizeof f->bus);
        c->device_caps = f->caps;
        c->capabilities = f->caps | V4L2_CAP_DEVICE_CAPS | V4L2_CAP_VIDEO_CAPTURE;
        return 0;
    }
    case VIDIOC_ENUM_FMT:
    case VIDIOC_ENUM_FRAMESIZES:
    case VIDIOC_ENUM_FRAMEINTERVALS:
        return fake_list(f, request, arg);
    case VIDIOC_G_FMT:
        ((struct v4l2_format *)arg)->fmt = f->fmt.fmt;
        return 0;
    case VIDIOC_S_FMT:
        return fake_set_format(f, arg);
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM:
        return fake_parm(f, request, arg);
    case VIDIOC_REQBUFS:
        return fake_request(f, arg);
    case VIDIOC_QUERYBUF:
    case VIDIOC_QBUF:
    case VIDIOC_DQBUF:
        return fake_buffer(f, request, arg);
    case VIDIOC_STREAMON:
    case VIDIOC_STREAMOFF:
        return fake_stream(f, request == VIDIOC_STREAMON);
    case VIDIOC_SUBSCRIBE_EVENT:
        return 0;
    case VIDIOC_DQEVENT:
        return fake_event(f, arg);
    default:
        return ENOTTY;
    }
}

static inline uint32_t fake_roll(struct fake *f, uint32_t n)
{
    f->dice = f->dice * 1664525 + 1013904223;
    return (f->dice >> 8) % n;
}

/* A byte of the answer, or of what it points to, is wrong; pointers are not the kernel's. */
static inline void fake_lie(struct fake *f, unsigned long request, void *arg)
{
    size_t size = _IOC_SIZE(request);
    if (!f->liar || fake_roll(f, f->liar) != 0 || size == 0)
        return;
    struct v4l2_ext_controls *all = arg;
    struct v4l2_buffer *b = arg;
    bool controls = request == VIDIOC_S_EXT_CTRLS || request == VIDIOC_G_EXT_CTRLS;
    bool planes = f->mplane && (request == VIDIOC_DQBUF || request == VIDIOC_QUERYBUF);
    uint8_t *at = controls ? (uint8_t *)all->controls : planes ? (uint8_t *)b->m.planes : arg;
    if (controls)
        size = all->count * sizeof *all->controls;
    else if (planes && fake_roll(f, 2))
        size = sizeof *b->m.planes;
    else if (planes) {
        at = arg;
        size = offsetof(struct v4l2_buffer, m);
    }
    at[fake_roll(f, (uint32_t)size)] ^= (uint8_t)(1 + fake_roll(f, 255));
}

static inline int fake_ioctl(void *ctx, int fd, unsigned long request, void *arg)
{
    struct fake *f = ctx;
    f->on_lens = f->lens_fd >= 0 && fd == f->lens_fd;
    bool sub = f->sub_fd >= 0 && fd == f->sub_fd, has_controls = f->on_lens || sub == f->sub;
    if (fd < 0 || (!sub && !f->on_lens && fd != f->fd))
        fake_breach(f, "ioctl without device");
    int number = fake_refuses(f, request);
    fake_pass(f);
    fake_arm(f);
    if (f->lost)
        number = ENODEV;
    if (number)
        return fake_errno(number);
    if (request == VIDIOC_QUERY_EXT_CTRL)
        number = has_controls ? fake_query(f, arg) : EINVAL;
    else if (request == VIDIOC_S_EXT_CTRLS || request == VIDIOC_G_EXT_CTRLS)
        number = has_controls ? fake_controls(f, request, arg) : EINVAL;
    else if (request == VIDIOC_SUBDEV_G_FMT || request == VIDIOC_SUBDEV_S_FMT)
        number = sub ? fake_pad(f, request, arg) : ENOTTY;
    else if (!f->on_lens || request == VIDIOC_SUBSCRIBE_EVENT || request == VIDIOC_DQEVENT)
        number = sub ? ENOTTY : fake_dispatch(f, request, arg);
    else
        number = ENOTTY;
    fake_arm(f);
    if (!number)
        fake_lie(f, request, arg);
    return fake_errno(number);
}

static inline int fake_open(void *ctx, const char *path)
{
    struct fake *f = ctx;
    bool sub = strstr(path, "subdev") != NULL, lens = strstr(path, "lens") != NULL;
    int number = fake_refuses(f, 0);
    if (f->node[0] && access(f->node, F_OK) != 0)
        number = ENOENT;
    if (f->open_errno || number)
        return fake_errno(number ? number : f->open_errno);
    int *node = lens ? &f->lens_fd : sub ? &f->sub_fd : &f->fd;
    if (*node >= 0)
        fake_breach(f, "opened twice");
    int fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    *node = fd;
    f->armed_ns = node == &f->fd ? 0 : f->armed_ns;
    f->fds++;
    return fd;
}

static inline int fake_close(void *ctx, int fd)
{
    struct fake *f = ctx;
    if (fd < 0 || (fd != f->fd && fd != f->sub_fd && fd != f->lens_fd))
        fake_breach(f, "close of what is not open");
    if (fd == f->fd && (f->maps > 0 || ((f->streaming || f->n) && !f->lost && !f->fail_at)))
        fake_breach(f, "closed with memory mapped, with buffers, or while it streams");
    *(fd == f->fd ? &f->fd : fd == f->lens_fd ? &f->lens_fd : &f->sub_fd) = -1;
    f->fds--;
    if (f->fd < 0) { // the driver frees all
        f->n = f->n_fifo = f->n_ready = 0;
        f->streaming = false;
    }
    return close(fd);
}

static inline void *fake_mmap(void *ctx, size_t length, int fd, int64_t offset)
{
    struct fake *f = ctx;
    int number = fake_refuses(f, 0);
    number = number == EINTR ? 0 : number; // signals do not interrupt it
    bool none = offset < 0 || offset / 4096 >= f->n || f->buf[offset / 4096].p;
    if (fd != f->fd || (!f->liar && (length != fake_length(f) || none)))
        fake_breach(f, "mmap of what is not a buffer");
    number = none || length > FAKE_MEMORY ? EINVAL : number;
    errno = number;
    uint8_t *p = number ? NULL : calloc(1, length);
    if (!p)
        return MAP_FAILED;
    f->buf[offset / 4096].p = p;
    f->buf[offset / 4096].mapped = length;
    f->maps++;
    return p;
}

static inline int fake_munmap(void *ctx, void *p, size_t length)
{
    struct fake *f = ctx;
    int i = 0;
    while (i < FAKE_BUFFERS - 1 && f->buf[i].p != p)
        i++;
    if (f->fd < 0 || f->buf[i].p != p || f->buf[i].mapped != length)
        fake_breach(f, "munmap");
    f->buf[i].p = NULL;
    free(p);
    f->maps--;
    return 0;
}

static inline int fake_name(void *ctx, int fd, char *out, size_t cap)
{
    struct fake *f = ctx;
    if (fake_refuses(f, 0))
        return -1;
    snprintf(out, cap, "%s", fd == f->sub_fd ? f->sensor : "capture");
    return 0;
}

#endif
