/* Buttons through libgpiod 1, played by this program; the headers are in fakegpiod1. */
#include "drivers/device/trigger_gpiod1.c"

#include "tests/unit/drivers/device/gpiod_cases.h"

static void *the_chip;

struct gpiod_chip *gpiod_chip_open(const char *path)
{
    assert_string_equal(path, "/dev/gpiochip0");
    if (lib.fail_open) {
        errno = lib.fail_open;
        return NULL;
    }
    the_chip = lib_new();
    return the_chip;
}

void gpiod_chip_close(struct gpiod_chip *chip)
{
    assert_ptr_equal(chip, the_chip);
    if (lib.fd > 0)
        close(lib.fd);
    lib.fd = 0;
    lib_free(chip);
}

unsigned int gpiod_chip_num_lines(struct gpiod_chip *chip)
{
    (void)chip;
    return 8;
}

struct gpiod_line *gpiod_chip_get_line(struct gpiod_chip *chip, unsigned int offset)
{
    assert_true(offset < 8);
    lib.offset = (int)offset;
    return (void *)chip;
}

struct gpiod_line *gpiod_chip_find_line(struct gpiod_chip *chip, const char *name)
{
    return strcmp(name, "shutter") == 0 ? gpiod_chip_get_line(chip, 3) : NULL;
}

const char *gpiod_line_consumer(struct gpiod_line *line)
{
    (void)line;
    return "leds";
}

int gpiod_line_request_both_edges_events_flags(struct gpiod_line *line, const char *consumer,
                                               int flags)
{
    (void)line;
    assert_string_equal(consumer, "hdrig");
    if (lib.fail_request)
        return lib_fail(lib.fail_request);
    lib.bias = flags == GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP     ? LIB_UP
               : flags == GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN ? LIB_DOWN
                                                                 : LIB_OFF;
    lib.fd = open("/dev/null", O_RDONLY);
    return 0;
}

int gpiod_line_event_get_fd(struct gpiod_line *line)
{
    (void)line;
    return lib.fd;
}

int gpiod_line_event_read(struct gpiod_line *line, struct gpiod_line_event *event)
{
    (void)line;
    assert_true(fcntl(lib.fd, F_GETFL) & O_NONBLOCK); // else this would wait
    if (lib.fail_read || lib.n_edges == 0)
        return lib_fail(lib.fail_read ? lib.fail_read : EAGAIN);
    event->ts = (struct timespec){lib.edge->time_ns / 1000000000, lib.edge->time_ns % 1000000000};
    event->event_type =
        lib.edge->rising ? GPIOD_LINE_EVENT_RISING_EDGE : GPIOD_LINE_EVENT_FALLING_EDGE;
    lib.edge++;
    lib.n_edges--;
    return 0;
}

/* One press, one event, at its first edge; what follows within the time does not count. */
static void test_bounce(void **state)
{
    static const struct gpiod_case_edge edge[] = {
        {100000000, false, 0}, {101000000, true, 0}, {102000000, false, 0}, {400000000, true, 0},
        {401000000, false, 0}, {402000000, true, 0}, {407000000, false, 0}, {411000000, true, 0},
        {415999999, false, 0}, {500000000, true, 0}, {600000000, false, 0},
    };
    struct trigger_event ev[12];
    (void)state;
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3", edge, 11, ev), 3);
    assert_true(ev[0].time_ns == 100000000 && ev[0].count == 1);
    assert_true(ev[1].time_ns == 407000000 && ev[1].count == 2);
    assert_true(ev[2].time_ns == 600000000 && ev[2].count == 3 && ev[2].lost == 0);
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3,debounce_ms=0", edge, 11, ev), 6);
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3,edge=rising", edge, 11, ev), 2);
}

static void test_lengths(void **state)
{
    static const struct gpiod_case_edge edge[] = {
        {50000000, true, 0},   {100000000, false, 0}, {101000000, true, 0},
        {102000000, false, 0}, {400000000, true, 0},  {500000000, false, 0},
    };
    struct trigger_event ev[8];
    (void)state;
    lib_lengths = true;
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3", edge, 6, ev), 1);
    assert_true(ev[0].time_ns == 400000000 && ev[0].held_ns == 300000000);
    lib_lengths = false;
}

/* A kernel before 5.7 stamps with the time of day. */
static void test_other_clock(void **state)
{
    static const struct gpiod_case_edge edge = {1700000000000000000, false, 0};
    struct trigger_event ev[2];
    struct timespec now;
    (void)state;
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3", &edge, 1, ev), 1);
    clock_gettime(CLOCK_MONOTONIC, &now);
    int64_t ago = (int64_t)now.tv_sec * 1000000000 + now.tv_nsec - ev[0].time_ns;
    assert_true(ago >= 0 && ago < 10000000000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open),        cmocka_unit_test(test_no_memory),
        cmocka_unit_test(test_bounce),      cmocka_unit_test(test_lengths),
        cmocka_unit_test(test_other_clock),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
