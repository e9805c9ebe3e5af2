/* v4l2_sys.h - system calls of the V4L2 backend, as a table, so that a test can play the kernel.
 * thread: as camera.h. */
#ifndef DEVICE_V4L2_SYS_H
#define DEVICE_V4L2_SYS_H

#include "core/base/err.h"

#include <stddef.h>
#include <stdint.h>

/* Results are those of the calls that the members are named after: -1 (mmap: MAP_FAILED) and errno.
 * */
struct v4l2_sys {
    void *ctx;
    int (*open)(void *ctx, const char *path); // for reading and writing, never blocking
    int (*close)(void *ctx, int fd);
    int (*ioctl)(void *ctx, int fd, unsigned long request, void *arg);
    void *(*mmap)(void *ctx, size_t length, int fd, int64_t offset); // shared, read and write
    int (*munmap)(void *ctx, void *p, size_t length);
    int (*name)(void *ctx, int fd, char *out, size_t cap); // what the kernel calls an open node
    int64_t (*clock_ns)(void *ctx);                        // CLOCK_MONOTONIC
};

extern const struct v4l2_sys v4l2_sys_libc;

/* An open device node. */
struct v4l2_node {
    const struct v4l2_sys *sys;
    const char *path;
    int fd; // -1: not open
};

/* err:  ERR_LOST (no such device now), ERR_BUSY, ERR_IO (no permission: says what gives it) */
MUST_USE err_t v4l2_sys_open(struct v4l2_node *n);
void v4l2_sys_close(struct v4l2_node *n); // accepts one that is not open

/* 0, or errno; never EINTR unless signals come without end. */
int v4l2_sys_ioctl(const struct v4l2_node *n, unsigned long request, void *arg);

/* Says that the node could not do `what`.
 * err:  ERR_LOST, ERR_BUSY, ERR_NOMEM, ERR_UNSUPPORTED (it does not know such a thing), ERR_IO */
MUST_USE err_t v4l2_sys_fail(const struct v4l2_node *n, int number, const char *what);

#endif
