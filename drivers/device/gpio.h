/* gpio.h - one line of a GPIO chip, through the kernel's character device (uAPI v2, Linux 5.10):
 * what button and lamp share, and the counting of edges.
 * thread: one per line. */
#ifndef DEVICE_GPIO_H
#define DEVICE_GPIO_H

#include "core/base/err.h"
#include "drivers/device/device.h"
#include "drivers/device/trigger.h"

enum { GPIO_CHIP_CAP = 256, GPIO_LINE_CAP = 32 }; // bytes with the terminating 0

enum gpio_bias { GPIO_BIAS_UP, GPIO_BIAS_DOWN, GPIO_BIAS_NONE, GPIO_BIAS_OF_EDGE };

/* A line as its URI describes it. */
struct gpio_spec {
    char uri[16 + GPIO_CHIP_CAP + GPIO_LINE_CAP]; // without options, begins every sentence
    char chip[GPIO_CHIP_CAP];                     // path, name or label
    char line[GPIO_LINE_CAP];                     // offset or name
    int rising;                                   // for a button: the edge that counts
    int bias;                                     // enum gpio_bias, resolved
    double debounce_ms;
    int active_low; // for a lamp
};

enum gpio_use { GPIO_BUTTON, GPIO_LAMP };

/* "SCHEME:CHIP/LINE,options" of trigger.h and lamp.h. err: ERR_ARG */
MUST_USE err_t gpio_parse(const char *uri, const char *scheme, enum gpio_use use,
                          struct gpio_spec *out);

/* Path of the node that has the chip's path, name or label.
 * err:  ERR_LOST (no such chip), ERR_ARG (two have that label), ERR_IO (permission), ERR_NOMEM */
MUST_USE err_t gpio_chip_path(const struct device_sys *sys, const struct gpio_spec *spec,
                              char path[GPIO_CHIP_CAP]);

/* True if the line is asked for by its number. */
bool gpio_offset(const struct gpio_spec *spec, uint32_t *out);

/* Request the line; *fd does not block.
 * own:  sys->close.
 * err:  ERR_LOST, ERR_ARG, ERR_BUSY (names the consumer), ERR_IO, ERR_UNSUPPORTED, ERR_NOMEM */
MUST_USE err_t gpio_request(const struct device_sys *sys, const struct gpio_spec *spec,
                            enum gpio_use use, int *fd);

/* A lamp's line; `on` as the lamp sees it. err: ERR_IO, ERR_LOST */
MUST_USE err_t gpio_set(const struct device_sys *sys, int fd, const struct gpio_spec *spec,
                        bool on);

struct gpio_edge {
    int64_t time_ns;
    uint32_t seqno; // counts the edges of this line, from 1 on
    bool rising;
};

/* The oldest edge that waits. err: ERR_AGAIN, ERR_IO, ERR_LOST */
MUST_USE err_t gpio_read(const struct device_sys *sys, int fd, const struct gpio_spec *spec,
                         struct gpio_edge *out);

/* The error of a call on this line that failed with errno `why`. consumer: name of the program that
 * holds the line, may be "" or NULL. err: never OK */
MUST_USE err_t gpio_fail(const struct gpio_spec *spec, int why, const char *consumer);

/* The same for reads and writes of a line after gpio_request. err: ERR_AGAIN, ERR_IO, ERR_LOST */
MUST_USE err_t gpio_fail_read(const struct gpio_spec *spec, int why);

/* The error of a line that the chip does not have. err: never OK */
MUST_USE err_t gpio_fail_line(const struct gpio_spec *spec, uint32_t n_lines);

/* Edges that count, and what the kernel lost before them. Begin with zeros. */
struct gpio_count {
    uint32_t seqno, count, lost;
    bool lengths;    // presses count when they end (trigger.h)
    int64_t down_ns; // begin of the present press; 0: none, or not known
};

/* True: this edge is a trigger, *out is filled in. */
bool gpio_count_edge(struct gpio_count *c, const struct gpio_spec *spec,
                     const struct gpio_edge *edge, struct trigger_event *out);

#endif
