/* A buffer is ours, the driver's or the caller's; the driver may only hand out buffers that it has.
 * One failure (EIO, a buffer that is not the driver's, a refused VIDIOC_QBUF) is reported and
 * forgotten; after a second one without a frame between them the stream is stopped and started
 * again, which brings all but the caller's buffers back; when that did not help the device counts
 * as lost. The restart is the one place where taking a frame may have to wait for the device.
 * Buffers are unmapped before VIDIOC_REQBUFS frees them, even if the device no longer answers. */
#include "drivers/device/v4l2_queue.h"

#include <errno.h>
#include <linux/videodev2.h>
#include <string.h>
#include <sys/mman.h>

#define LENGTH_MAX ((size_t)1 << 30)

struct message { // struct v4l2_buffer with its only plane
    struct v4l2_buffer b;
    struct v4l2_plane plane[VIDEO_MAX_PLANES];
};

static uint32_t buf_type(const struct v4l2_queue *q)
{
    return q->mplane ? V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE : V4L2_BUF_TYPE_VIDEO_CAPTURE;
}

static int buffer_ioctl(struct v4l2_queue *q, unsigned long request, struct message *m, int index)
{
    *m = (struct message){
        .b = {.index = (uint32_t)index, .type = buf_type(q), .memory = V4L2_MEMORY_MMAP}};
    if (q->mplane) {
        m->b.m.planes = m->plane;
        m->b.length = VIDEO_MAX_PLANES;
    }
    return v4l2_sys_ioctl(&q->node, request, m);
}

/* ---- open and close ---- */

/* A node has one set of buffers: EBUSY means that another program streams. */
static err_t ask_buffers(struct v4l2_queue *q, int wanted)
{
    struct v4l2_requestbuffers r = {
        .count = (uint32_t)wanted, .type = buf_type(q), .memory = V4L2_MEMORY_MMAP};
    int number = v4l2_sys_ioctl(&q->node, VIDIOC_REQBUFS, &r);
    if (number)
        return v4l2_sys_fail(&q->node, number, "get buffers");
    q->requested = true;
    if (r.count < V4L2_QUEUE_MIN)
        return err_fail(ERR_NOMEM, "%s: %u buffers of %d asked for, at least %d are needed",
                        q->node.path, r.count, wanted, V4L2_QUEUE_MIN);
    q->n = r.count < CAMERA_BUFFERS_MAX ? (int)r.count : CAMERA_BUFFERS_MAX;
    return OK;
}

static err_t map_buffer(struct v4l2_queue *q, int i, size_t least)
{
    struct message m;
    int number = buffer_ioctl(q, VIDIOC_QUERYBUF, &m, i);
    if (number)
        return v4l2_sys_fail(&q->node, number, "describe its buffers");
    if (q->mplane && m.b.length != 1)
        return err_fail(ERR_UNSUPPORTED, "%s: buffers of %u planes, only 1 is supported",
                        q->node.path, m.b.length);
    size_t length = q->mplane ? m.plane[0].length : m.b.length;
    uint32_t offset = q->mplane ? m.plane[0].m.mem_offset : m.b.m.offset;
    if (length < least || length < 1 || length > LENGTH_MAX)
        return err_fail(ERR_UNSUPPORTED, "%s: buffers of %zu bytes, pictures need %zu..%zu",
                        q->node.path, length, least, LENGTH_MAX);
    void *p = q->node.sys->mmap(q->node.sys->ctx, length, q->node.fd, offset);
    if (p == MAP_FAILED)
        return v4l2_sys_fail(&q->node, errno, "map its buffers");
    q->slot[i].p = p;
    q->slot[i].length = length;
    if (i == 0) {
        q->monotonic =
            (m.b.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        q->start = q->monotonic &&
                   (m.b.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    }
    return OK;
}

err_t v4l2_queue_open(struct v4l2_queue *q, int wanted, size_t least)
{
    err_t e = ask_buffers(q, wanted < V4L2_QUEUE_MIN ? V4L2_QUEUE_MIN : wanted);
    for (int i = 0; !e && i < q->n; i++)
        e = map_buffer(q, i, least);
    return e;
}

static int stop_stream(struct v4l2_queue *q)
{
    int type = (int)buf_type(q);
    q->streaming = false;
    return v4l2_sys_ioctl(&q->node, VIDIOC_STREAMOFF, &type);
}

void v4l2_queue_close(struct v4l2_queue *q)
{
    if (q->streaming)
        stop_stream(q);
    for (int i = 0; i < q->n; i++)
        if (q->slot[i].p)
            q->node.sys->munmap(q->node.sys->ctx, q->slot[i].p, q->slot[i].length);
    struct v4l2_requestbuffers none = {.type = buf_type(q), .memory = V4L2_MEMORY_MMAP};
    if (q->requested)
        v4l2_sys_ioctl(&q->node, VIDIOC_REQBUFS, &none);
    memset(q, 0, sizeof *q);
}

/* ---- streaming ---- */

static int queue_one(struct v4l2_queue *q, int i)
{
    struct message m;
    int number = buffer_ioctl(q, VIDIOC_QBUF, &m, i);
    if (number == 0)
        q->slot[i].owner = V4L2_QUEUE_DRIVER;
    return number;
}

/* Give all buffers of ours to the driver. Returns the first errno. */
static int queue_ours(struct v4l2_queue *q)
{
    int number = 0;
    for (int i = 0; !number && i < q->n; i++)
        if (q->slot[i].owner == V4L2_QUEUE_OURS)
            number = queue_one(q, i);
    return number;
}

err_t v4l2_queue_start(struct v4l2_queue *q)
{
    int type = (int)buf_type(q), number = queue_ours(q);
    if (number)
        return v4l2_sys_fail(&q->node, number, "queue its buffers");
    number = v4l2_sys_ioctl(&q->node, VIDIOC_STREAMON, &type);
    if (number == EPIPE || number == ENOLINK)
        return err_fail(ERR_UNSUPPORTED,
                        "%s: formats between sensor and memory do not agree, or a link is off: "
                        "set them with media-ctl",
                        q->node.path);
    if (number == ENOSPC)
        return err_fail(ERR_BUSY, "%s: the USB bus has no bandwidth left for this size and rate",
                        q->node.path);
    if (number)
        return v4l2_sys_fail(&q->node, number, "start its stream");
    q->streaming = true;
    return OK;
}

err_t v4l2_queue_lose(struct v4l2_queue *q, const char *why)
{
    q->lost = why;
    return v4l2_queue_check(q);
}

err_t v4l2_queue_check(const struct v4l2_queue *q)
{
    return q->lost ? err_fail(ERR_LOST, "%s: %s", q->node.path, q->lost) : OK;
}

static err_t restart_stream(struct v4l2_queue *q)
{
    if (q->restarted)
        return v4l2_queue_lose(q, "fails again after its stream was restarted; open it again");
    q->restarted = true;
    q->trouble = 0;
    int number = stop_stream(q);
    for (int i = 0; i < q->n; i++)
        if (q->slot[i].owner == V4L2_QUEUE_DRIVER)
            q->slot[i].owner = V4L2_QUEUE_OURS;
    if (number || v4l2_queue_start(q) != OK)
        return v4l2_queue_lose(q, "its stream broke off and cannot be restarted; open it again");
    return err_fail(ERR_IO, "%s: its stream broke off and was restarted", q->node.path);
}

static err_t count_failure(struct v4l2_queue *q, const char *what)
{
    if (++q->trouble >= 2)
        return restart_stream(q);
    return err_fail(ERR_IO, "%s: %s", q->node.path, what);
}

static bool is_gone(int number)
{
    return number == ENODEV || number == ENXIO || number == ESHUTDOWN;
}

static int64_t frame_time_ns(const struct v4l2_queue *q, const struct v4l2_buffer *b)
{
    if (!q->monotonic)
        return q->node.sys->clock_ns(q->node.sys->ctx);
    bool monotonic = (b->flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    bool start = (b->flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    int64_t s = b->timestamp.tv_sec, us = b->timestamp.tv_usec;
    bool sane = s >= 0 && s < INT64_MAX / 2000000000 && us >= 0 && us < 1000000;
    return monotonic && start == q->start && sane ? s * 1000000000 + us * 1000 : 0;
}

static void describe_item(const struct v4l2_queue *q, const struct message *m,
                          struct v4l2_queue_item *out)
{
    int i = (int)m->b.index;
    size_t used = q->mplane ? m->plane[0].bytesused : m->b.bytesused;
    size_t offset = q->mplane ? m->plane[0].data_offset : 0, length = q->slot[i].length;
    bool fits = used <= length && offset <= used;
    *out = (struct v4l2_queue_item){.index = i,
                                    .data = q->slot[i].p + (fits ? offset : 0),
                                    .bytes = fits ? used - offset : 0,
                                    .error = !fits || (m->b.flags & V4L2_BUF_FLAG_ERROR),
                                    .sequence = m->b.sequence,
                                    .timestamp_ns = frame_time_ns(q, &m->b)};
}

err_t v4l2_queue_take(struct v4l2_queue *q, struct v4l2_queue_item *out)
{
    struct message m;
    if (v4l2_queue_check(q) != OK)
        return ERR_LOST;
    int again = queue_ours(q), number = buffer_ioctl(q, VIDIOC_DQBUF, &m, 0);
    if (is_gone(number))
        return v4l2_queue_lose(q, V4L2_UNPLUGGED);
    if (number == EAGAIN && again)
        return count_failure(q, "does not take its buffers back");
    if (number == EAGAIN || number == EINTR)
        return err_fail(ERR_AGAIN, "%s: no frame waits", q->node.path);
    if (number)
        return count_failure(q, strerror(number));
    if (m.b.index >= (uint32_t)q->n || q->slot[m.b.index].owner != V4L2_QUEUE_DRIVER ||
        (q->mplane && m.b.length != 1))
        return count_failure(q, "the driver returned a buffer that it does not own");
    describe_item(q, &m, out);
    q->slot[out->index].owner = V4L2_QUEUE_CALLER;
    q->trouble = 0;
    q->restarted = false;
    return OK;
}

void v4l2_queue_give(struct v4l2_queue *q, int index)
{
    if (index < 0 || index >= q->n || q->slot[index].owner != V4L2_QUEUE_CALLER)
        return;
    q->slot[index].owner = V4L2_QUEUE_OURS;
    queue_one(q, index); // after a failure the next take tries again
}
