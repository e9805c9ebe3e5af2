/* gpio_fake.h - GPIO chips that behave as the kernel's (drivers/gpio/gpiolib-cdev.c of 6.1): names,
 * hogs, debouncing, numbered edges, a buffer that drops the oldest, removal. Their nodes are files
 * of tmpdir.h's folder; any call can be made to fail.
 * thread: one. */
#ifndef DEVICE_GPIO_FAKE_H
#define DEVICE_GPIO_FAKE_H

#include "drivers/device/device.h"
#include "tests/unit/tmpdir.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <linux/gpio.h>
#include <stdbool.h>
#include <stdint.h>
#include <unistd.h>

enum { GPIO_FAKE_CHIPS = 3, GPIO_FAKE_LINES = 8, GPIO_FAKE_KEPT = 64, GPIO_FAKE_FDS = 256 };

struct gpio_fake_line {
    char name[32], consumer[32]; // consumer: who has it
    struct gpio_v2_line_request asked;
    bool level, told; // physical; what was last reported
    int64_t changed_ns;
    struct gpio_v2_line_event edge[GPIO_FAKE_KEPT];
    unsigned n, lost;
    uint32_t seqno;
    int sets;   // times that an output was set
    int end[2]; // ends of a pipe: a byte in it makes the request's descriptor readable
};

struct gpio_fake_chip {
    const char *label;
    bool gone;
    int open_errno, request_errno;
    struct gpio_fake_line line[GPIO_FAKE_LINES];
};

static struct {
    struct gpio_fake_chip chip[GPIO_FAKE_CHIPS];
    struct gpio_fake_chip *chip_of[GPIO_FAKE_FDS];
    struct gpio_fake_line *line_of[GPIO_FAKE_FDS];
    int n_open, calls, fail_call, fail_errno; // call number fail_call fails; 0: none
} gpio_fake;

static inline bool gpio_fake_fails(void)
{
    if (++gpio_fake.calls != gpio_fake.fail_call)
        return false;
    errno = gpio_fake.fail_errno;
    return true;
}

static inline int gpio_fake_no(int why)
{
    errno = why;
    return -1;
}

static inline int gpio_fake_open(const char *path, int flags)
{
    char real[PATH_MAX];
    int i = -1;
    if (gpio_fake_fails())
        return -1;
    if (!realpath(path, real))
        return -1;
    const char *base = strrchr(real, '/') + 1;
    if (sscanf(base, "gpiochip%d", &i) == 1 && gpio_fake.chip[i].open_errno)
        return gpio_fake_no(gpio_fake.chip[i].open_errno);
    int fd = open(path, flags & ~O_ACCMODE);
    if (fd < 0)
        return fd;
    gpio_fake.n_open++;
    gpio_fake.chip_of[fd] = i >= 0 ? &gpio_fake.chip[i] : NULL;
    return fd;
}

static inline int gpio_fake_close(int fd)
{
    struct gpio_fake_line *l = gpio_fake.line_of[fd];
    gpio_fake.n_open--;
    gpio_fake.chip_of[fd] = NULL;
    gpio_fake.line_of[fd] = NULL;
    if (l) {
        l->consumer[0] = '\0';
        close(l->end[1]);
    }
    return close(fd);
}

static inline int gpio_fake_request(struct gpio_fake_chip *c, struct gpio_v2_line_request *r)
{
    struct gpio_fake_line *l = &c->line[r->offsets[0]];
    if (c->request_errno)
        return gpio_fake_no(c->request_errno);
    if (r->num_lines != 1 || r->offsets[0] >= GPIO_FAKE_LINES || !r->consumer[0])
        return gpio_fake_no(EINVAL);
    if (l->consumer[0])
        return gpio_fake_no(EBUSY);
    if (pipe(l->end) != 0)
        return -1;
    r->fd = l->end[0];
    gpio_fake.n_open++;
    gpio_fake.chip_of[r->fd] = c;
    gpio_fake.line_of[r->fd] = l;
    memcpy(l->consumer, r->consumer, sizeof l->consumer);
    l->asked = *r;
    l->told = l->level;
    l->n = l->seqno = l->lost = 0;
    l->changed_ns = INT64_MAX;
    if (r->config.flags & GPIO_V2_LINE_FLAG_OUTPUT)
        l->level = (r->config.flags & GPIO_V2_LINE_FLAG_ACTIVE_LOW) != 0;
    return 0;
}

static inline int gpio_fake_line_info(struct gpio_fake_chip *c, struct gpio_v2_line_info *info)
{
    uint32_t at = info->offset;
    if (at >= GPIO_FAKE_LINES)
        return gpio_fake_no(EINVAL);
    *info = (struct gpio_v2_line_info){.offset = at};
    memcpy(info->name, c->line[at].name, sizeof info->name);
    memcpy(info->consumer, c->line[at].consumer, sizeof info->consumer);
    info->flags = info->consumer[0] ? GPIO_V2_LINE_FLAG_USED : 0;
    return 0;
}

static inline int gpio_fake_ioctl(int fd, unsigned long request, void *arg)
{
    struct gpio_fake_chip *c = gpio_fake.chip_of[fd];
    struct gpio_fake_line *l = gpio_fake.line_of[fd];
    if (gpio_fake_fails())
        return -1;
    if (!c)
        return gpio_fake_no(ENOTTY);
    if (c->gone)
        return gpio_fake_no(ENODEV);
    if (l && request == GPIO_V2_LINE_SET_VALUES_IOCTL) {
        const struct gpio_v2_line_values *v = arg;
        bool low = (l->asked.config.flags & GPIO_V2_LINE_FLAG_ACTIVE_LOW) != 0;
        l->level = ((v->bits & v->mask & 1) != 0) != low;
        l->sets++;
        return 0;
    }
    if (request == GPIO_GET_CHIPINFO_IOCTL) {
        struct gpiochip_info *info = arg;
        *info = (struct gpiochip_info){.lines = GPIO_FAKE_LINES};
        snprintf(info->name, sizeof info->name, "gpiochip%d", (int)(c - gpio_fake.chip));
        snprintf(info->label, sizeof info->label, "%s", c->label);
        return 0;
    }
    return request == GPIO_V2_GET_LINEINFO_IOCTL ? gpio_fake_line_info(c, arg)
           : request == GPIO_V2_GET_LINE_IOCTL   ? gpio_fake_request(c, arg)
                                                 : gpio_fake_no(EINVAL);
}

static inline ssize_t gpio_fake_read(int fd, void *buf, size_t n)
{
    struct gpio_fake_line *l = gpio_fake.line_of[fd];
    char byte;
    if (gpio_fake_fails())
        return -1;
    if (gpio_fake.chip_of[fd]->gone)
        return gpio_fake_no(ENODEV);
    if (!(fcntl(fd, F_GETFL) & O_NONBLOCK)) // it would wait
        abort();
    if (l->n == 0)
        return gpio_fake_no(EAGAIN);
    if (n < sizeof l->edge[0])
        return gpio_fake_no(EINVAL);
    memcpy(buf, &l->edge[0], sizeof l->edge[0]);
    memmove(&l->edge[0], &l->edge[1], --l->n * sizeof l->edge[0]);
    if (l->n == 0 && read(fd, &byte, 1) != 1)
        abort();
    return sizeof l->edge[0];
}

static const struct device_sys gpio_fake_sys = {tmpdir_root, gpio_fake_open, gpio_fake_close,
                                                gpio_fake_ioctl, gpio_fake_read};

static inline void gpio_fake_report(struct gpio_fake_line *l, int64_t ns)
{
    l->told = l->level;
    l->seqno++;
    if (l->n == l->asked.event_buffer_size) {
        memmove(&l->edge[0], &l->edge[1], --l->n * sizeof l->edge[0]);
        l->lost++;
    }
    if (l->n == 0 && write(l->end[1], "", 1) != 1)
        abort();
    l->edge[l->n++] = (struct gpio_v2_line_event){.timestamp_ns = (uint64_t)ns,
                                                  .id = l->level ? GPIO_V2_LINE_EVENT_RISING_EDGE
                                                                 : GPIO_V2_LINE_EVENT_FALLING_EDGE,
                                                  .seqno = l->seqno,
                                                  .line_seqno = l->seqno};
}

/* Time passes: a level that stood long enough is reported. */
static inline void gpio_fake_wait(struct gpio_fake_line *l, int64_t ns)
{
    const struct gpio_v2_line_config *c = &l->asked.config;
    int64_t hold = c->num_attrs ? 1000 * (int64_t)c->attrs[0].attr.debounce_period_us : 0;
    if (l->changed_ns > ns - hold)
        return;
    if (l->level != l->told)
        gpio_fake_report(l, l->changed_ns + hold);
    l->changed_ns = INT64_MAX;
}

/* The wire changes at that time. */
static inline void gpio_fake_drive(struct gpio_fake_line *l, int64_t ns, bool level)
{
    gpio_fake_wait(l, ns);
    if (l->level == level)
        return;
    l->level = level;
    l->changed_ns = ns;
    gpio_fake_wait(l, ns);
}

static inline void gpio_fake_start(void)
{
    tmpdir_make();
    memset(&gpio_fake, 0, sizeof gpio_fake);
    for (int c = 0; c < GPIO_FAKE_CHIPS; c++) {
        char node[16];
        snprintf(node, sizeof node, "gpiochip%d", c);
        tmpdir_text(node, "");
        gpio_fake.chip[c].label = c == 0 ? "rigchip" : "other";
        for (int i = 0; i < GPIO_FAKE_LINES; i++)
            gpio_fake.chip[c].line[i].level = true; // pulled up
    }
    snprintf(gpio_fake.chip[0].line[3].name, 32, "shutter");
    snprintf(gpio_fake.chip[0].line[5].name, 32, "lamp");
}

static inline void gpio_fake_stop(void)
{
    if (gpio_fake.n_open != 0)
        abort(); // a descriptor was not closed
    tmpdir_remove();
}

#endif
