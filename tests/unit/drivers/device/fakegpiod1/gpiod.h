/* gpiod.h - the part of libgpiod 1.6 that trigger_gpiod1.c uses, for its test. */
#ifndef FAKEGPIOD1_GPIOD_H
#define FAKEGPIOD1_GPIOD_H

#include <time.h>

#define GPIOD_LINE_BULK_MAX_LINES 64

enum {
    GPIOD_LINE_REQUEST_FLAG_BIAS_DISABLE = 8,
    GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN = 16,
    GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP = 32
};

enum { GPIOD_LINE_EVENT_RISING_EDGE = 1, GPIOD_LINE_EVENT_FALLING_EDGE };

struct gpiod_chip;
struct gpiod_line;
struct gpiod_line_event {
    struct timespec ts;
    int event_type;
};

struct gpiod_chip *gpiod_chip_open(const char *path);
void gpiod_chip_close(struct gpiod_chip *chip);
unsigned int gpiod_chip_num_lines(struct gpiod_chip *chip);
struct gpiod_line *gpiod_chip_get_line(struct gpiod_chip *chip, unsigned int offset);
struct gpiod_line *gpiod_chip_find_line(struct gpiod_chip *chip, const char *name);
const char *gpiod_line_consumer(struct gpiod_line *line);
int gpiod_line_request_both_edges_events_flags(struct gpiod_line *line, const char *consumer,
                                               int flags);
int gpiod_line_event_get_fd(struct gpiod_line *line);
int gpiod_line_event_read(struct gpiod_line *line, struct gpiod_line_event *event);

#endif
