/* v4l2_queue.h - the mapped buffers of a V4L2 capture node and the owner of each.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_QUEUE_H
#define DEVICE_V4L2_QUEUE_H

#include "drivers/device/camera.h"
#include "drivers/device/v4l2_sys.h"

#include <stdbool.h>

enum { V4L2_QUEUE_MIN = 3 }; // buffers without which no camera streams
#define V4L2_UNPLUGGED "unplugged"

enum v4l2_queue_owner { V4L2_QUEUE_OURS, V4L2_QUEUE_DRIVER, V4L2_QUEUE_CALLER };

struct v4l2_queue {
    struct v4l2_node node; // not owned
    bool mplane;
    bool requested, streaming, restarted;
    const char *lost; // why; NULL: it is there
    int n;       // buffers
    int trouble; // failures since the last frame
    struct {
        uint8_t *p; // NULL: not mapped
        size_t length;
        enum v4l2_queue_owner owner;
    } slot[CAMERA_BUFFERS_MAX];
    bool monotonic, start; // kind of the stamps, from the flags of the first buffer
};

/* A filled buffer; it is the caller's until v4l2_queue_give. */
struct v4l2_queue_item {
    int index;
    const uint8_t *data;
    size_t bytes;
    bool error;
    uint32_t sequence;
    int64_t timestamp_ns; // 0: of another kind than that of the first buffer
};

/* Map at least V4L2_QUEUE_MIN buffers that hold `least` bytes each.
 * own:  v4l2_queue_close, also after an error.
 * err:  ERR_BUSY, ERR_LOST, ERR_NOMEM, ERR_UNSUPPORTED (buffers do not fit), ERR_IO */
MUST_USE err_t v4l2_queue_open(struct v4l2_queue *q, int wanted, size_t least);
void v4l2_queue_close(struct v4l2_queue *q); // accepts a zeroed one; works when the device is gone

/* err:  as open; ERR_UNSUPPORTED (formats along the way do not agree) */
MUST_USE err_t v4l2_queue_start(struct v4l2_queue *q);

/* The oldest filled buffer.
 * err:  ERR_AGAIN, ERR_IO, ERR_LOST; see camera_ops.next */
MUST_USE err_t v4l2_queue_take(struct v4l2_queue *q, struct v4l2_queue_item *out);

/* Give a buffer of the caller back; others are left alone. */
void v4l2_queue_give(struct v4l2_queue *q, int index);

/* Mark the device as gone or changed: no more buffers are taken. `why` is kept, not copied. */
MUST_USE err_t v4l2_queue_lose(struct v4l2_queue *q, const char *why);

/* err:  ERR_LOST with the reason, once it is marked */
MUST_USE err_t v4l2_queue_check(const struct v4l2_queue *q);

#endif
