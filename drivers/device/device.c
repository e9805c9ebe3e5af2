#include "drivers/device/device.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

static int node_open(const char *path, int flags)
{
    return open(path, flags);
}

static int node_ioctl(int fd, unsigned long request, void *arg)
{
    return ioctl(fd, request, arg);
}

const struct device_sys device_libc = {"/dev", node_open, close, node_ioctl, read};
