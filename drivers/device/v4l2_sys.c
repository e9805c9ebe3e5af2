#include "drivers/device/v4l2_sys.h"

#include "drivers/device/clocks.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <time.h>
#include <unistd.h>

enum { TRIES = 16 }; // for a call that signals interrupt

static int libc_open(void *ctx, const char *path)
{
    (void)ctx;
    return open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC);
}

static int libc_close(void *ctx, int fd)
{
    (void)ctx;
    return close(fd);
}

static int libc_ioctl(void *ctx, int fd, unsigned long request, void *arg)
{
    (void)ctx;
    return ioctl(fd, request, arg);
}

static void *libc_mmap(void *ctx, size_t length, int fd, int64_t offset)
{
    (void)ctx;
    return mmap(NULL, length, PROT_READ | PROT_WRITE, MAP_SHARED, fd, (off_t)offset);
}

static int libc_munmap(void *ctx, void *p, size_t length)
{
    (void)ctx;
    return munmap(p, length);
}

/* Sub-devices have their names nowhere else without a walk through the media graph. */
static int libc_name(void *ctx, int fd, char *out, size_t cap)
{
    char path[64];
    struct stat st;
    (void)ctx;
    if (fstat(fd, &st) < 0)
        return -1;
    snprintf(path, sizeof path, "/sys/dev/char/%u:%u/name", major(st.st_rdev), minor(st.st_rdev));
    FILE *f = fopen(path, "re");
    if (!f)
        return -1;
    bool read = fgets(out, (int)cap, f) != NULL;
    fclose(f);
    if (read)
        out[strcspn(out, "\n")] = '\0';
    return read ? 0 : -1;
}

static int64_t libc_clock(void *ctx)
{
    (void)ctx;
    return clocks_now();
}

const struct v4l2_sys v4l2_sys_libc = {.open = libc_open,
                                       .close = libc_close,
                                       .ioctl = libc_ioctl,
                                       .mmap = libc_mmap,
                                       .munmap = libc_munmap,
                                       .name = libc_name,
                                       .clock_ns = libc_clock};

err_t v4l2_sys_open(struct v4l2_node *n)
{
    for (int i = 0; i < TRIES; i++) {
        n->fd = n->sys->open(n->sys->ctx, n->path);
        if (n->fd >= 0)
            return OK;
        if (errno != EINTR)
            break;
    }
    if (errno == EACCES || errno == EPERM)
        return err_fail(ERR_IO,
                        "%s: no permission to open it: the user must be in group video, which "
                        "udev's rules give cameras to (60-hdrig.rules, or the system's own)",
                        n->path);
    if (errno == ENOENT || errno == ENOTDIR)
        return err_fail(ERR_LOST, "%s: no such camera now", n->path);
    return v4l2_sys_fail(n, errno, "open it");
}

void v4l2_sys_close(struct v4l2_node *n)
{
    if (n->sys && n->fd >= 0)
        n->sys->close(n->sys->ctx, n->fd);
    n->fd = -1;
}

int v4l2_sys_ioctl(const struct v4l2_node *n, unsigned long request, void *arg)
{
    int number = EINTR;
    for (int i = 0; i < TRIES && number == EINTR; i++) {
        if (n->sys->ioctl(n->sys->ctx, n->fd, request, arg) >= 0)
            return 0;
        number = errno;
    }
    return number;
}

err_t v4l2_sys_fail(const struct v4l2_node *n, int number, const char *what)
{
    switch (number) {
    case ENODEV:
    case ENXIO:
    case ESHUTDOWN:
        return err_fail(ERR_LOST, "%s: unplugged (%s while trying to %s)", n->path,
                        strerror(number), what);
    case EBUSY:
        return err_fail(ERR_BUSY, "%s: in use by another program (cannot %s)", n->path, what);
    case ENOMEM:
        return err_fail(ERR_NOMEM, "%s: no memory to %s", n->path, what);
    case EINVAL:
    case ENOTTY:
    case ENOSYS:
    case EOPNOTSUPP:
    case ERANGE:
        return err_fail(ERR_UNSUPPORTED, "%s: cannot %s: %s", n->path, what, strerror(number));
    default:
        return err_fail(ERR_IO, "%s: cannot %s: %s", n->path, what, strerror(number));
    }
}
