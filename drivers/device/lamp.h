/* lamp.h - a lamp on a GPIO line that shows the state of the rig. The caller runs lamp_tick at the
 * time of lamp_next_ns; nothing here sleeps.
 * thread: one. */
#ifndef DEVICE_LAMP_H
#define DEVICE_LAMP_H

#include "core/base/err.h"
#include "drivers/device/device.h"

#include <stdint.h>

enum lamp_state {
    LAMP_OFF,
    LAMP_ARMED, // steady
    LAMP_BUSY,  // 4 Hz
    LAMP_FAULT  // two short flashes a second
};

struct lamp;

/* uri: gpio:CHIP/LINE[,active=high|low] as in trigger.h.
 * own:  lamp_close, which leaves it off.
 * err:  as trigger_ops.open, ERR_NOMEM */
MUST_USE err_t lamp_open(const char *uri, struct lamp **out);
MUST_USE err_t lamp_open_with(const char *uri, const struct device_sys *sys, struct lamp **out);
void lamp_close(struct lamp *l); // accepts NULL

void lamp_show(struct lamp *l, enum lamp_state s, int64_t now_ns);

/* When lamp_tick has something to do, CLOCK_MONOTONIC; INT64_MAX: never. */
int64_t lamp_next_ns(const struct lamp *l);

/* err: ERR_IO, ERR_LOST (line gone): returned once, the lamp is dark from then on. */
MUST_USE err_t lamp_tick(struct lamp *l, int64_t now_ns);

#endif
