/* A button through libgpiod 2: the same requests as in gpio.c, by calls of the library.
 * Empty if the library is another version: trigger_gpiod1.c. */
#include "drivers/device/trigger.h"

#include "drivers/device/gpio.h"

#include <gpiod.h>

#ifndef GPIOD_LINE_BULK_MAX_LINES

#include <errno.h>
#include <fcntl.h>
#include <string.h>

enum { BURST = 1024 /* edges looked at in one call */, KEPT_EDGES = 64 };

struct state {
    struct gpio_spec spec;
    struct gpio_count count;
    struct gpiod_line_request *line;
    struct gpiod_edge_event_buffer *events;
};

static void button_close(void *st)
{
    struct state *s = st;
    if (s->line)
        gpiod_line_request_release(s->line);
    gpiod_edge_event_buffer_free(s->events);
    memset(s, 0, sizeof *s);
}

static bool configure_line(const struct gpio_spec *spec, uint32_t offset,
                           struct gpiod_line_settings *settings, struct gpiod_line_config *config)
{
    static const enum gpiod_line_bias bias[] = {GPIOD_LINE_BIAS_PULL_UP, GPIOD_LINE_BIAS_PULL_DOWN,
                                                GPIOD_LINE_BIAS_DISABLED};
    if (!settings || !config)
        return false;
    gpiod_line_settings_set_debounce_period_us(settings,
                                               (unsigned long)(spec->debounce_ms * 1e3 + 0.5));
    return gpiod_line_settings_set_direction(settings, GPIOD_LINE_DIRECTION_INPUT) == 0 &&
           gpiod_line_settings_set_edge_detection(settings, GPIOD_LINE_EDGE_BOTH) == 0 &&
           gpiod_line_settings_set_bias(settings, bias[spec->bias]) == 0 &&
           gpiod_line_config_add_line_settings(config, &offset, 1, settings) == 0;
}

/* The error of a failed request, with the consumer of the line. */
static err_t request_fail(const struct gpio_spec *spec, struct gpiod_chip *chip, uint32_t offset,
                          int why)
{
    struct gpiod_line_info *info = gpiod_chip_get_line_info(chip, offset);
    err_t e = gpio_fail(spec, why, info ? gpiod_line_info_get_consumer(info) : NULL);
    if (info)
        gpiod_line_info_free(info);
    return e;
}

static err_t request_line(struct state *s, struct gpiod_chip *chip, uint32_t offset)
{
    struct gpiod_request_config *how = gpiod_request_config_new();
    struct gpiod_line_settings *settings = gpiod_line_settings_new();
    struct gpiod_line_config *config = gpiod_line_config_new();
    if (how) {
        gpiod_request_config_set_consumer(how, "hdrig");
        gpiod_request_config_set_event_buffer_size(how, KEPT_EDGES);
        if (configure_line(&s->spec, offset, settings, config))
            s->line = gpiod_chip_request_lines(chip, how, config);
    }
    int why = errno;
    gpiod_line_config_free(config);
    gpiod_line_settings_free(settings);
    gpiod_request_config_free(how);
    return s->line ? OK : request_fail(&s->spec, chip, offset, why);
}

/* LINE to the number of the chip's line. */
static err_t find_line(const struct gpio_spec *spec, struct gpiod_chip *chip, uint32_t *offset)
{
    struct gpiod_chip_info *info = gpiod_chip_get_info(chip);
    if (!info)
        return gpio_fail(spec, errno, NULL);
    uint32_t n = (uint32_t)gpiod_chip_info_get_num_lines(info);
    gpiod_chip_info_free(info);
    if (!gpio_offset(spec, offset)) {
        int at = gpiod_chip_get_line_offset_from_name(chip, spec->line);
        *offset = at < 0 ? n : (uint32_t)at;
    }
    return *offset < n ? OK : gpio_fail_line(spec, n);
}

static err_t open_line(struct state *s, struct gpiod_chip *chip)
{
    uint32_t offset;
    err_t e = find_line(&s->spec, chip, &offset);
    if (!e)
        e = request_line(s, chip, offset);
    if (e)
        return e;
    s->events = gpiod_edge_event_buffer_new(1);
    if (!s->events || fcntl(gpiod_line_request_get_fd(s->line), F_SETFL, O_NONBLOCK) != 0)
        return gpio_fail(&s->spec, errno, NULL);
    return OK;
}

static err_t button_open(void *st, const char *uri)
{
    struct state *s = st;
    char path[GPIO_CHIP_CAP];
    memset(s, 0, sizeof *s);
    err_t e = gpio_parse(uri, "gpiod", GPIO_BUTTON, &s->spec);
    if (!e)
        e = gpio_chip_path(&device_libc, &s->spec, path);
    if (e)
        return e;
    struct gpiod_chip *chip = gpiod_chip_open(path);
    if (!chip)
        return gpio_fail(&s->spec, errno, NULL);
    e = open_line(s, chip);
    gpiod_chip_close(chip);
    if (e)
        button_close(s);
    return e;
}

static int button_fd(const void *st)
{
    return gpiod_line_request_get_fd(((const struct state *)st)->line);
}

static void button_lengths(void *st)
{
    ((struct state *)st)->count.lengths = true;
}

static err_t button_next(void *st, struct trigger_event *out)
{
    struct state *s = st;
    for (int i = 0; i < BURST; i++) {
        if (gpiod_line_request_read_edge_events(s->line, s->events, 1) != 1)
            return gpio_fail_read(&s->spec, errno);
        struct gpiod_edge_event *ev = gpiod_edge_event_buffer_get_event(s->events, 0);
        struct gpio_edge edge = {(int64_t)gpiod_edge_event_get_timestamp_ns(ev),
                                 (uint32_t)gpiod_edge_event_get_line_seqno(ev),
                                 gpiod_edge_event_get_event_type(ev) ==
                                     GPIOD_EDGE_EVENT_RISING_EDGE};
        if (gpio_count_edge(&s->count, &s->spec, &edge, out))
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
