/* A key of a keyboard, a foot switch, a remote control: EV_KEY with value 1 or, where lengths are
 * on, with value 0 of the key that went down last. Repeats (2) are ignored. After SYN_DROPPED,
 * which says that the kernel's queue ran over, nothing counts up to the next report.
 * Source: Linux Documentation/input/event-codes.rst. */
#include "drivers/device/trigger.h"

#include "drivers/device/uri.h"

#include <linux/input.h>

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <time.h>

enum { BURST = 1024 }; // events looked at in one call

static const char scheme[] = "evdev:";

struct state {
    const struct device_sys *sys;
    char path[256];
    int64_t key; // -1: any
    int fd;
    bool dropped, lengths;
    uint32_t count, lost;
    int down;        // code of the key that is down; 0: none
    int64_t down_ns; // when
};

static const struct uri_key keys[] = {
    {"key", offsetof(struct state, key), URI_WHOLE, 1, KEY_MAX, NULL},
};

static err_t parse_uri(struct state *s, const char *uri)
{
    size_t skip = sizeof scheme - 1;
    if (strncmp(uri, scheme, skip) != 0)
        return err_fail(ERR_ARG, "%.64s: does not begin with \"%s\"", uri, scheme);
    size_t n = strcspn(uri + skip, ",");
    if (n < 1 || n >= sizeof s->path)
        return err_fail(ERR_ARG, "%.64s: a path of %zu bytes, not 1..%zu", uri, n,
                        sizeof s->path - 1);
    memcpy(s->path, uri + skip, n);
    s->key = -1;
    const char *options = uri + skip + n;
    return uri_parse("evdev", options + (*options == ','),
                     &(struct uri_table){keys, sizeof keys / sizeof keys[0], s}, 1);
}

static err_t device_fail(const struct state *s, int why)
{
    if (why == EACCES || why == EPERM)
        return err_fail(ERR_IO, "%s: no permission; the user must be in group \"input\"", s->path);
    if (why == ENOENT || why == ENODEV || why == ENXIO)
        return err_fail(ERR_LOST, "%s: there is no such input device", s->path);
    if (why == ENOTTY || why == EINVAL)
        return err_fail(ERR_UNSUPPORTED, "%s: not an input device", s->path);
    return err_fail(why == EBUSY ? ERR_BUSY : ERR_IO, "%s: %s", s->path, strerror(why));
}

/* Check that the device has the key, and make it stamp with CLOCK_MONOTONIC. */
static err_t prepare_device(const struct state *s)
{
    unsigned char has[KEY_MAX / 8 + 1] = {0};
    int clock = CLOCK_MONOTONIC;
    if (s->sys->ioctl(s->fd, EVIOCGBIT(EV_KEY, sizeof has), has) < 0 ||
        s->sys->ioctl(s->fd, EVIOCSCLOCKID, &clock) < 0)
        return device_fail(s, errno);
    bool any = false;
    for (size_t i = 0; i < sizeof has; i++)
        any |= has[i] != 0;
    if (!any)
        return err_fail(ERR_UNSUPPORTED, "%s: the device has no keys", s->path);
    if (s->key >= 0 && !(has[s->key / 8] >> s->key % 8 & 1))
        return err_fail(ERR_ARG, "%s: the device has no key %d", s->path, (int)s->key);
    return OK;
}

err_t trigger_evdev_open_with(void *st, const char *uri, const struct device_sys *sys)
{
    struct state *s = st;
    memset(s, 0, sizeof *s);
    s->sys = sys;
    err_t e = parse_uri(s, uri);
    if (e)
        return e;
    s->fd = sys->open(s->path, O_RDONLY | O_NONBLOCK | O_CLOEXEC);
    if (s->fd < 0)
        return device_fail(s, errno);
    e = prepare_device(s);
    if (e)
        sys->close(s->fd);
    return e;
}

static err_t key_open(void *st, const char *uri)
{
    return trigger_evdev_open_with(st, uri, &device_libc);
}

static void key_close(void *st)
{
    struct state *s = st;
    s->sys->close(s->fd);
}

static int key_fd(const void *st)
{
    return ((const struct state *)st)->fd;
}

/* True: this event is a trigger; *held_ns: see trigger.h. */
static bool is_trigger(struct state *s, const struct input_event *ev, int64_t at, int64_t *held_ns)
{
    *held_ns = 0;
    if (ev->type == EV_SYN && ev->code == SYN_DROPPED) {
        s->dropped = true;
        s->down = 0;
        s->lost++;
    } else if (ev->type == EV_SYN && ev->code == SYN_REPORT) {
        s->dropped = false;
    }
    if (s->dropped || ev->type != EV_KEY || (s->key >= 0 && ev->code != s->key))
        return false;
    if (ev->value == 1) {
        s->down = ev->code;
        s->down_ns = at;
        return !s->lengths;
    }
    if (ev->value != 0 || ev->code != s->down || !s->lengths)
        return false;
    s->down = 0;
    *held_ns = at - s->down_ns;
    return true;
}

static void key_lengths(void *st)
{
    ((struct state *)st)->lengths = true;
}

static err_t key_next(void *st, struct trigger_event *out)
{
    struct state *s = st;
    for (int i = 0; i < BURST; i++) {
        struct input_event ev;
        ssize_t n = s->sys->read(s->fd, &ev, sizeof ev);
        if (n < 0)
            return errno == EAGAIN || errno == EINTR ? ERR_AGAIN
                   : errno == ENODEV                 ? device_fail(s, errno)
                                     : err_fail(ERR_IO, "%s: %s", s->path, strerror(errno));
        if (n != sizeof ev)
            return n == 0 ? device_fail(s, ENODEV)
                          : err_fail(ERR_IO, "%s: an event of %zd bytes, not %zu", s->path, n,
                                     sizeof ev);
        int64_t held_ns,
            at = (int64_t)ev.input_event_sec * 1000000000 + (int64_t)ev.input_event_usec * 1000;
        if (!is_trigger(s, &ev, at, &held_ns))
            continue;
        *out = (struct trigger_event){at, ++s->count, s->lost, held_ns};
        s->lost = 0;
        return OK;
    }
    return ERR_AGAIN;
}

const struct trigger_ops trigger_evdev = {.name = "evdev",
                                          .state_bytes = sizeof(struct state),
                                          .open = key_open,
                                          .close = key_close,
                                          .fd = key_fd,
                                          .lengths = key_lengths,
                                          .next = key_next};
