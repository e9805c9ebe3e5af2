/* A pattern is a list of times, on and off in turn, that repeats from the moment it is shown. What
 * the lamp should be now follows from the clock alone, so a tick that comes late is right again. */
#include "drivers/device/lamp.h"

#include "drivers/device/gpio.h"

#include <stdlib.h>

enum { STEPS = 4 };

struct lamp {
    const struct device_sys *sys;
    struct gpio_spec spec;
    int fd;
    enum lamp_state state;
    bool on, dark; // on: state of the line; dark: the line has failed
    int64_t since_ns, next_ns;
};

static const int64_t ms = 1000000;

/* ms on, off, on, off; states without an entry are steady. */
static const int pattern[][STEPS] = {
    [LAMP_BUSY] = {125, 125},
    [LAMP_FAULT] = {100, 100, 100, 700},
};

err_t lamp_open_with(const char *uri, const struct device_sys *sys, struct lamp **out)
{
    struct lamp *l = calloc(1, sizeof *l);
    *out = NULL;
    if (!l)
        return err_fail(ERR_NOMEM, "%.64s: no memory for the lamp", uri);
    l->sys = sys;
    l->next_ns = INT64_MAX;
    err_t e = gpio_parse(uri, "gpio", GPIO_LAMP, &l->spec);
    if (!e)
        e = gpio_request(sys, &l->spec, GPIO_LAMP, &l->fd);
    if (e) {
        free(l);
        return e;
    }
    *out = l;
    return OK;
}

err_t lamp_open(const char *uri, struct lamp **out)
{
    return lamp_open_with(uri, &device_libc, out);
}

void lamp_close(struct lamp *l)
{
    if (!l)
        return;
    err_t e = l->on ? gpio_set(l->sys, l->fd, &l->spec, false) : OK;
    (void)e; // the line is given back in any case
    l->sys->close(l->fd);
    free(l);
}

void lamp_show(struct lamp *l, enum lamp_state s, int64_t now_ns)
{
    if (l->dark || s == l->state)
        return;
    l->state = s;
    l->since_ns = l->next_ns = now_ns;
}

int64_t lamp_next_ns(const struct lamp *l)
{
    return l->next_ns;
}

/* Whether the pattern has the lamp on at a time after its start, and for how long yet. */
static bool pattern_is_on(const int *steps, int64_t at_ns, int64_t *left_ns)
{
    int64_t period = 0;
    for (int i = 0; i < STEPS; i++)
        period += steps[i] * ms;
    at_ns %= period;
    int i = 0;
    while (at_ns >= steps[i] * ms)
        at_ns -= steps[i++] * ms;
    *left_ns = steps[i] * ms - at_ns;
    return i % 2 == 0;
}

err_t lamp_tick(struct lamp *l, int64_t now_ns)
{
    if (l->dark || now_ns < l->next_ns)
        return OK;
    bool on = l->state == LAMP_ARMED;
    l->next_ns = INT64_MAX;
    if (l->state == LAMP_BUSY || l->state == LAMP_FAULT) {
        int64_t left;
        on = pattern_is_on(pattern[l->state], now_ns - l->since_ns, &left);
        l->next_ns = now_ns + left;
    }
    if (on == l->on)
        return OK;
    err_t e = gpio_set(l->sys, l->fd, &l->spec, on);
    l->on = on && !e;
    l->dark = e != OK;
    if (e)
        l->next_ns = INT64_MAX;
    return e;
}
