/* trigger.h - sources of capture requests: a button on a GPIO line, a key, a timer. A backend is
 * one constant table, trigger_NAME. Commands on the control socket are handled elsewhere, since
 * they get an answer (firmware/daemon/ctl.h).
 * thread: one, the same from open to close. Only open and close block. */
#ifndef DEVICE_TRIGGER_H
#define DEVICE_TRIGGER_H

#include "core/base/err.h"
#include "drivers/device/device.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* URIs: gpio:CHIP/LINE[,edge=falling|rising][,bias=up|down|none][,debounce_ms=5]
 *         CHIP is a path, a name or a label of a chip; LINE an offset or the name of a line.
 *         Default: falling edge with pull-up (a button to ground); pull-down for a rising one.
 *         A line that is held down at open is no trigger. debounce_ms: 0..1000.
 *       gpiod:... the same through libgpiod, for chips that only it finds. Version 1 has no
 *         debouncing (this program does it by the stamps) and cannot tell what was lost.
 *       evdev:/dev/input/...[,key=CODE]   a key going down; default any key
 *       timer:SECONDS                     every so often, 0.01 .. 1e6 */
struct trigger_event {
    int64_t time_ns; // CLOCK_MONOTONIC of the edge, after debouncing
    uint32_t count;  // number of this event on its device, from 1 on
    uint32_t lost;   // before this one, as far as the kernel says: edges of either direction,
                     // gaps in a key's events, expiries of a timer
    int64_t held_ns; // how long it was down, after `lengths`; else 0
};

struct trigger_ops {
    const char *name; // BACKEND of the URI
    size_t state_bytes;

    /* own:  close; on error there is nothing to close.
     * err:  ERR_ARG (URI: key and bound), ERR_LOST (no such device or line), ERR_BUSY (names the
     *       consumer), ERR_IO (no permission: says which group or rule), ERR_UNSUPPORTED */
    MUST_USE err_t (*open)(void *st, const char *uri);
    void (*close)(void *st);
    int (*fd)(const void *st); // readable when next has an event or an error. Constant.

    /* From now on the event of a press comes when it ends, with its length. A press with lost edges
     * is dropped then, since its length is not known. NULL: the device has no lengths. */
    void (*lengths)(void *st);

    /* err:  ERR_AGAIN (none), ERR_IO (one read failed), ERR_LOST (device gone: close) */
    MUST_USE err_t (*next)(void *st, struct trigger_event *out);
};

/* open of gpio and evdev with other system calls. */
MUST_USE err_t trigger_gpio_open_with(void *st, const char *uri, const struct device_sys *sys);
MUST_USE err_t trigger_evdev_open_with(void *st, const char *uri, const struct device_sys *sys);

extern const struct trigger_ops trigger_gpio, trigger_gpiod, trigger_evdev, trigger_timer;

#endif
