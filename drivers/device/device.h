/* device.h - the calls that reach a device node, as a table, so that a test can play the kernel.
 * thread: any. */
#ifndef DEVICE_DEVICE_H
#define DEVICE_DEVICE_H

#include <sys/types.h>

struct device_sys {
    const char *dev; // folder of the nodes
    int (*open)(const char *path, int flags);
    int (*close)(int fd);
    int (*ioctl)(int fd, unsigned long request, void *arg);
    ssize_t (*read)(int fd, void *buf, size_t n);
};

extern const struct device_sys device_libc;

#endif
