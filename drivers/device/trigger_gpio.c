/* A button: edges from gpio.c, of which one direction counts. */
#include "drivers/device/trigger.h"

#include "drivers/device/gpio.h"

#include <string.h>

enum { BURST = 1024 }; // edges looked at in one call

struct state {
    const struct device_sys *sys;
    struct gpio_spec spec;
    struct gpio_count count;
    int fd;
};

err_t trigger_gpio_open_with(void *st, const char *uri, const struct device_sys *sys)
{
    struct state *s = st;
    memset(s, 0, sizeof *s);
    s->sys = sys;
    err_t e = gpio_parse(uri, "gpio", GPIO_BUTTON, &s->spec);
    return e ? e : gpio_request(sys, &s->spec, GPIO_BUTTON, &s->fd);
}

static err_t button_open(void *st, const char *uri)
{
    return trigger_gpio_open_with(st, uri, &device_libc);
}

static void button_close(void *st)
{
    struct state *s = st;
    s->sys->close(s->fd);
}

static int button_fd(const void *st)
{
    return ((const struct state *)st)->fd;
}

static void button_lengths(void *st)
{
    ((struct state *)st)->count.lengths = true;
}

static err_t button_next(void *st, struct trigger_event *out)
{
    struct state *s = st;
    for (int i = 0; i < BURST; i++) {
        struct gpio_edge edge;
        err_t e = gpio_read(s->sys, s->fd, &s->spec, &edge);
        if (e)
            return e;
        if (gpio_count_edge(&s->count, &s->spec, &edge, out))
            return OK;
    }
    return ERR_AGAIN;
}

const struct trigger_ops trigger_gpio = {.name = "gpio",
                                         .state_bytes = sizeof(struct state),
                                         .open = button_open,
                                         .close = button_close,
                                         .fd = button_fd,
                                         .lengths = button_lengths,
                                         .next = button_next};
