/* A button through libgpiod 1, which speaks the kernel's first GPIO interface: no debouncing, no
 * numbers of edges, a buffer of 16 that drops the newest. Debouncing by the stamps instead: an edge
 * counts if no other came in the time before it. A glitch of a quiet line therefore counts, which
 * the kernel's debouncing (gpio:, libgpiod 2) would pass over.
 * Empty if the library is another version: trigger_gpiod2.c. */
#include "drivers/device/clocks.h"
#include "drivers/device/trigger.h"

#include "drivers/device/gpio.h"

#include <gpiod.h>

#ifdef GPIOD_LINE_BULK_MAX_LINES

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <time.h>

enum { BURST = 1024 }; // edges looked at in one call

struct state {
    struct gpio_spec spec;
    struct gpio_count count;
    struct gpiod_chip *chip;
    struct gpiod_line *line;
    int64_t last_ns; // time of the last edge
};

static void button_close(void *st)
{
    struct state *s = st;
    if (s->chip)
        gpiod_chip_close(s->chip); // releases the line
    memset(s, 0, sizeof *s);
}

static err_t request_line(struct state *s)
{
    static const int bias[] = {GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP,
                               GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN,
                               GPIOD_LINE_REQUEST_FLAG_BIAS_DISABLE};
    uint32_t offset, n = gpiod_chip_num_lines(s->chip);
    if (!gpio_offset(&s->spec, &offset))
        s->line = gpiod_chip_find_line(s->chip, s->spec.line);
    else if (offset < n)
        s->line = gpiod_chip_get_line(s->chip, offset);
    if (!s->line)
        return gpio_fail_line(&s->spec, n);
    if (gpiod_line_request_both_edges_events_flags(s->line, "hdrig", bias[s->spec.bias]) != 0)
        return gpio_fail(&s->spec, errno, gpiod_line_consumer(s->line));
    if (fcntl(gpiod_line_event_get_fd(s->line), F_SETFL, O_NONBLOCK) != 0)
        return gpio_fail(&s->spec, errno, NULL);
    return OK;
}

static err_t button_open(void *st, const char *uri)
{
    struct state *s = st;
    char path[GPIO_CHIP_CAP];
    memset(s, 0, sizeof *s);
    s->last_ns = INT64_MIN / 2;
    err_t e = gpio_parse(uri, "gpiod", GPIO_BUTTON, &s->spec);
    if (!e)
        e = gpio_chip_path(&device_libc, &s->spec, path);
    if (e)
        return e;
    s->chip = gpiod_chip_open(path);
    e = s->chip ? request_line(s) : gpio_fail(&s->spec, errno, NULL);
    if (e)
        button_close(s);
    return e;
}

static int button_fd(const void *st)
{
    return gpiod_line_event_get_fd(((const struct state *)st)->line);
}

static int64_t ns_of(const struct timespec *t)
{
    return (int64_t)t->tv_sec * 1000000000 + t->tv_nsec;
}

/* Before Linux 5.7 stamps came from CLOCK_REALTIME, which is far ahead. */
static int64_t event_time_ns(const struct timespec *t)
{
    int64_t now = clocks_now();
    return ns_of(t) > now + 1000000000 ? now : ns_of(t);
}

static void button_lengths(void *st)
{
    ((struct state *)st)->count.lengths = true;
}

static err_t button_next(void *st, struct trigger_event *out)
{
    struct state *s = st;
    for (int i = 0; i < BURST; i++) {
        struct gpiod_line_event ev;
        if (gpiod_line_event_read(s->line, &ev) != 0)
            return gpio_fail_read(&s->spec, errno);
        struct gpio_edge edge = {event_time_ns(&ev.ts), s->count.seqno + 1,
                                 ev.event_type == GPIOD_LINE_EVENT_RISING_EDGE};
        bool quiet = (double)(edge.time_ns - s->last_ns) >= s->spec.debounce_ms * 1e6;
        s->last_ns = edge.time_ns;
        if (quiet && gpio_count_edge(&s->count, &s->spec, &edge, out))
            return OK;
    }
    return ERR_AGAIN;
}

const struct trigger_ops trigger_gpiod = {.name = "gpiod",
                                          .state_bytes = sizeof(struct state),
                                          .open = button_open,
                                          .close = button_close,
                                          .fd = button_fd,
                                          .lengths = button_lengths,
                                          .next = button_next};

#endif
