/* A chip is looked up by asking every /dev/gpiochipN for its name and label; links are not counted
 * as second chips. A line is looked up by asking for the names of all. Then one request: an input
 * with both edges and the kernel's debouncing, or an output that is off.
 * Both edges: the numbers that the kernel gives them count every change of the line, so that a gap
 * tells of each one that its buffer of 64 could not keep. It drops the oldest. Bounce has no
 * numbers (Linux drivers/gpio/gpiolib-cdev.c counts edges after debouncing), so how much of it was
 * swallowed is not known.
 * Source: Linux Documentation/userspace-api/gpio/chardev.rst, include/uapi/linux/gpio.h. */
#include "drivers/device/gpio.h"

#include "drivers/device/uri.h"

#include <linux/gpio.h>

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEPT_EDGES = 64 };

static const char consumer_name[] = "hdrig";

/* ---- URI ---- */

#define AT(field) offsetof(struct gpio_spec, field)
static const struct uri_key button_keys[] = {
    {"edge", AT(rising), URI_WORD, 0, 0, "falling|rising"},
    {"bias", AT(bias), URI_WORD, 0, 0, "up|down|none"},
    {"debounce_ms", AT(debounce_ms), URI_REAL, 0, 1000, NULL},
};
static const struct uri_key lamp_keys[] = {
    {"active", AT(active_low), URI_WORD, 0, 0, "high|low"},
};

/* CHIP/LINE of n bytes, split at the last slash. */
static err_t split_address(const char *uri, const char *at, size_t n, struct gpio_spec *out)
{
    const char *slash = memrchr(at, '/', n);
    size_t chip = slash ? (size_t)(slash - at) : 0, line = slash ? n - chip - 1 : 0;
    if (chip < 1 || chip >= GPIO_CHIP_CAP || line < 1 || line >= GPIO_LINE_CAP)
        return err_fail(ERR_ARG, "%.64s: not CHIP/LINE with 1..%d and 1..%d bytes", uri,
                        GPIO_CHIP_CAP - 1, GPIO_LINE_CAP - 1);
    memcpy(out->chip, at, chip);
    memcpy(out->line, slash + 1, line);
    return OK;
}

err_t gpio_parse(const char *uri, const char *scheme, enum gpio_use use, struct gpio_spec *out)
{
    size_t skip = strlen(scheme);
    *out = (struct gpio_spec){.bias = GPIO_BIAS_OF_EDGE, .debounce_ms = 5.0};
    if (strncmp(uri, scheme, skip) != 0 || uri[skip] != ':')
        return err_fail(ERR_ARG, "%.64s: does not begin with \"%s:\"", uri, scheme);
    const char *at = uri + skip + 1;
    size_t n = strcspn(at, ",");
    err_t e = split_address(uri, at, n, out);
    if (e)
        return e;
    snprintf(out->uri, sizeof out->uri, "%s:%s/%s", scheme, out->chip, out->line);
    struct uri_table t = {button_keys, sizeof button_keys / sizeof button_keys[0], out};
    if (use == GPIO_LAMP)
        t = (struct uri_table){lamp_keys, sizeof lamp_keys / sizeof lamp_keys[0], out};
    e = uri_parse(out->uri, at + n + (at[n] == ','), &t, 1);
    if (out->bias == GPIO_BIAS_OF_EDGE)
        out->bias = out->rising ? GPIO_BIAS_DOWN : GPIO_BIAS_UP;
    return e;
}

/* ---- errors ---- */

err_t gpio_fail(const struct gpio_spec *spec, int why, const char *consumer)
{
    switch (why) {
    case EACCES:
    case EPERM:
        return err_fail(ERR_IO,
                        "%s: no permission; the user must be in group \"hdrig\", to which udev "
                        "gives the GPIO chips (60-hdrig.rules)",
                        spec->uri);
    case ENOENT:
        return err_fail(ERR_LOST, "%s: there is no such GPIO chip", spec->uri);
    case ENODEV:
        return err_fail(ERR_LOST, "%s: the GPIO chip has gone", spec->uri);
    case EBUSY:
        return err_fail(ERR_BUSY, "%s: the line is used by %s%s%s", spec->uri,
                        consumer && *consumer ? "\"" : "",
                        consumer && *consumer ? consumer : "another program",
                        consumer && *consumer ? "\"" : "");
    case ENOTTY:
        return err_fail(ERR_UNSUPPORTED, "%s: not a GPIO chip", spec->uri);
    case ENXIO:
    case EINVAL:
    case EOPNOTSUPP:
        return err_fail(ERR_UNSUPPORTED, "%s: the line cannot do what is asked of it (%s)",
                        spec->uri, strerror(why));
    default:
        return err_fail(why == ENOMEM ? ERR_NOMEM : ERR_IO, "%s: %s", spec->uri, strerror(why));
    }
}

err_t gpio_fail_read(const struct gpio_spec *spec, int why)
{
    if (why == EAGAIN || why == EINTR)
        return ERR_AGAIN;
    return why == ENODEV ? gpio_fail(spec, why, NULL)
                         : err_fail(ERR_IO, "%s: %s", spec->uri, strerror(why));
}

/* ---- chips ---- */

static err_t chip_info(const struct device_sys *sys, const char *path, struct gpiochip_info *info,
                       int *why)
{
    int fd = sys->open(path, O_RDWR | O_CLOEXEC);
    memset(info, 0, sizeof *info);
    *why = fd < 0 || sys->ioctl(fd, GPIO_GET_CHIPINFO_IOCTL, info) != 0 ? errno : 0;
    if (fd >= 0)
        sys->close(fd);
    info->name[sizeof info->name - 1] = info->label[sizeof info->label - 1] = '\0';
    return *why ? ERR_AGAIN : OK;
}

/* Compare one node with the request; `found` holds the chip's name after a match. */
static err_t match_chip(const struct device_sys *sys, const struct gpio_spec *spec,
                        const char *path, char found[GPIO_MAX_NAME_SIZE], int *refused)
{
    struct gpiochip_info info;
    int why;
    if (chip_info(sys, path, &info, &why) != OK) {
        if (why == EACCES || why == EPERM)
            *refused = why;
        return ERR_AGAIN;
    }
    if (strcmp(info.name, spec->chip) != 0 && strcmp(info.label, spec->chip) != 0)
        return ERR_AGAIN;
    if (*found && strcmp(found, info.name) != 0)
        return err_fail(ERR_ARG, "%s: %s and %s both have this label, give the name or path of one",
                        spec->uri, found, info.name);
    memcpy(found, info.name, GPIO_MAX_NAME_SIZE);
    return OK;
}

err_t gpio_chip_path(const struct device_sys *sys, const struct gpio_spec *spec,
                     char path[GPIO_CHIP_CAP])
{
    char found[GPIO_MAX_NAME_SIZE] = "", node[GPIO_CHIP_CAP];
    int refused = ENOENT;
    err_t e = OK;
    struct dirent *at;
    if (spec->chip[0] == '/') {
        memcpy(path, spec->chip, GPIO_CHIP_CAP);
        return OK;
    }
    DIR *dir = opendir(sys->dev);
    if (!dir)
        return err_fail(ERR_IO, "%s: cannot read %s: %s", spec->uri, sys->dev, strerror(errno));
    while ((e == OK || e == ERR_AGAIN) && (at = readdir(dir))) {
        if (strncmp(at->d_name, "gpiochip", 8) != 0 ||
            snprintf(node, sizeof node, "%s/%s", sys->dev, at->d_name) >= (int)sizeof node)
            continue;
        e = match_chip(sys, spec, node, found, &refused);
        if (!e)
            memcpy(path, node, sizeof node);
    }
    closedir(dir);
    if (e && e != ERR_AGAIN)
        return e;
    return *found ? OK : gpio_fail(spec, refused, NULL);
}

/* ---- lines ---- */

static err_t line_info(const struct device_sys *sys, int chip, const struct gpio_spec *spec,
                       struct gpio_v2_line_info *info)
{
    if (sys->ioctl(chip, GPIO_V2_GET_LINEINFO_IOCTL, info) != 0)
        return errno == EINVAL || errno == ENOTTY
                   ? err_fail(ERR_UNSUPPORTED,
                              "%s: the kernel's GPIO interface is older than Linux 5.10", spec->uri)
                   : gpio_fail(spec, errno, NULL);
    info->name[sizeof info->name - 1] = info->consumer[sizeof info->consumer - 1] = '\0';
    return OK;
}

bool gpio_offset(const struct gpio_spec *spec, uint32_t *out)
{
    unsigned long n = strtoul(spec->line, NULL, 10);
    *out = n < UINT32_MAX ? (uint32_t)n : UINT32_MAX;
    return spec->line[strspn(spec->line, "0123456789")] == '\0';
}

err_t gpio_fail_line(const struct gpio_spec *spec, uint32_t n_lines)
{
    uint32_t offset;
    return gpio_offset(spec, &offset)
               ? err_fail(ERR_ARG, "%s: the chip has %u lines, counted from 0", spec->uri, n_lines)
               : err_fail(ERR_LOST, "%s: none of the chip's %u lines has this name", spec->uri,
                          n_lines);
}

static err_t find_line(const struct device_sys *sys, int chip, const struct gpio_spec *spec,
                       struct gpio_v2_line_info *info)
{
    struct gpiochip_info c = {0};
    if (sys->ioctl(chip, GPIO_GET_CHIPINFO_IOCTL, &c) != 0)
        return gpio_fail(spec, errno, NULL);
    uint32_t offset;
    bool number = gpio_offset(spec, &offset);
    for (offset = number ? offset : 0; offset < c.lines; offset++) {
        *info = (struct gpio_v2_line_info){.offset = offset};
        err_t e = line_info(sys, chip, spec, info);
        if (e || number || strcmp(info->name, spec->line) == 0)
            return e;
    }
    return gpio_fail_line(spec, c.lines);
}

static void set_line_config(const struct gpio_spec *spec, enum gpio_use use,
                            struct gpio_v2_line_config *c)
{
    static const uint64_t bias[] = {GPIO_V2_LINE_FLAG_BIAS_PULL_UP,
                                    GPIO_V2_LINE_FLAG_BIAS_PULL_DOWN,
                                    GPIO_V2_LINE_FLAG_BIAS_DISABLED};
    if (use == GPIO_LAMP) { // value 0: off
        c->flags = GPIO_V2_LINE_FLAG_OUTPUT | (spec->active_low ? GPIO_V2_LINE_FLAG_ACTIVE_LOW : 0);
        return;
    }
    c->flags = GPIO_V2_LINE_FLAG_INPUT | GPIO_V2_LINE_FLAG_EDGE_RISING |
               GPIO_V2_LINE_FLAG_EDGE_FALLING | bias[spec->bias];
    if (spec->debounce_ms > 0.0) {
        c->num_attrs = 1;
        c->attrs[0].mask = 1;
        c->attrs[0].attr.id = GPIO_V2_LINE_ATTR_ID_DEBOUNCE;
        c->attrs[0].attr.debounce_period_us = (uint32_t)(spec->debounce_ms * 1e3 + 0.5);
    }
}

static err_t take_line(const struct device_sys *sys, int chip, const struct gpio_spec *spec,
                       enum gpio_use use, int *fd)
{
    struct gpio_v2_line_info info;
    struct gpio_v2_line_request r = {.num_lines = 1};
    err_t e = find_line(sys, chip, spec, &info);
    if (e)
        return e;
    r.offsets[0] = info.offset;
    r.event_buffer_size = use == GPIO_BUTTON ? KEPT_EDGES : 0;
    memcpy(r.consumer, consumer_name, sizeof consumer_name);
    set_line_config(spec, use, &r.config);
    if (sys->ioctl(chip, GPIO_V2_GET_LINE_IOCTL, &r) != 0)
        return gpio_fail(spec, errno, info.consumer);
    if (r.fd < 0 || fcntl(r.fd, F_SETFL, O_NONBLOCK) != 0)
        return err_fail(ERR_IO, "%s: the kernel gave no usable descriptor (%d)", spec->uri, r.fd);
    *fd = r.fd;
    return OK;
}

err_t gpio_request(const struct device_sys *sys, const struct gpio_spec *spec, enum gpio_use use,
                   int *fd)
{
    char path[GPIO_CHIP_CAP];
    *fd = -1;
    err_t e = gpio_chip_path(sys, spec, path);
    if (e)
        return e;
    int chip = sys->open(path, O_RDWR | O_CLOEXEC);
    if (chip < 0)
        return gpio_fail(spec, errno, NULL);
    e = take_line(sys, chip, spec, use, fd);
    sys->close(chip);
    return e;
}

err_t gpio_set(const struct device_sys *sys, int fd, const struct gpio_spec *spec, bool on)
{
    struct gpio_v2_line_values v = {.bits = on, .mask = 1};
    if (sys->ioctl(fd, GPIO_V2_LINE_SET_VALUES_IOCTL, &v) != 0)
        return gpio_fail_read(spec, errno);
    return OK;
}

err_t gpio_read(const struct device_sys *sys, int fd, const struct gpio_spec *spec,
                struct gpio_edge *out)
{
    struct gpio_v2_line_event ev;
    ssize_t n = sys->read(fd, &ev, sizeof ev);
    if (n < 0)
        return gpio_fail_read(spec, errno);
    if (n != sizeof ev)
        return n == 0
                   ? gpio_fail_read(spec, ENODEV)
                   : err_fail(ERR_IO, "%s: an edge of %zd bytes, not %zu", spec->uri, n, sizeof ev);
    *out = (struct gpio_edge){(int64_t)ev.timestamp_ns, ev.line_seqno,
                              ev.id == GPIO_V2_LINE_EVENT_RISING_EDGE};
    return OK;
}

bool gpio_count_edge(struct gpio_count *c, const struct gpio_spec *spec,
                     const struct gpio_edge *edge, struct trigger_event *out)
{
    uint32_t lost = edge->seqno - c->seqno - 1;
    bool down = edge->rising == (spec->rising != 0);
    int64_t since_ns = lost ? 0 : c->down_ns;
    c->lost += lost;
    c->seqno = edge->seqno;
    c->down_ns = down ? edge->time_ns : 0;
    if (c->lengths ? down || !since_ns : !down)
        return false;
    *out = (struct trigger_event){edge->time_ns, ++c->count, c->lost,
                                  c->lengths ? edge->time_ns - since_ns : 0};
    c->lost = 0;
    return true;
}
