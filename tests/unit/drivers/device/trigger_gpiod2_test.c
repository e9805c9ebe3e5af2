/* Buttons through libgpiod 2, played by this program; the headers are in fakegpiod2. */
#include "drivers/device/trigger_gpiod2.c"

#include "tests/unit/drivers/device/gpiod_cases.h"

struct gpiod_chip *gpiod_chip_open(const char *path)
{
    assert_string_equal(path, "/dev/gpiochip0");
    if (lib.fail_open) {
        errno = lib.fail_open;
        return NULL;
    }
    return lib_new();
}

void gpiod_chip_close(struct gpiod_chip *chip)
{
    lib_free(chip);
}

struct gpiod_chip_info *gpiod_chip_get_info(struct gpiod_chip *chip)
{
    assert_non_null(chip);
    return lib_new();
}

void gpiod_chip_info_free(struct gpiod_chip_info *info)
{
    lib_free(info);
}

size_t gpiod_chip_info_get_num_lines(struct gpiod_chip_info *info)
{
    assert_non_null(info);
    return 8;
}

int gpiod_chip_get_line_offset_from_name(struct gpiod_chip *chip, const char *name)
{
    assert_non_null(chip);
    return strcmp(name, "shutter") == 0 ? 3 : lib_fail(ENOENT);
}

struct gpiod_line_info *gpiod_chip_get_line_info(struct gpiod_chip *chip, unsigned int offset)
{
    assert_true(chip && offset == 3);
    return lib_new();
}

void gpiod_line_info_free(struct gpiod_line_info *info)
{
    assert_non_null(info);
    lib_free(info);
}

const char *gpiod_line_info_get_consumer(struct gpiod_line_info *info)
{
    assert_non_null(info);
    return "leds";
}

struct gpiod_line_settings *gpiod_line_settings_new(void)
{
    return lib_new();
}

void gpiod_line_settings_free(struct gpiod_line_settings *settings)
{
    lib_free(settings);
}

int gpiod_line_settings_set_direction(struct gpiod_line_settings *settings,
                                      enum gpiod_line_direction direction)
{
    assert_true(settings && direction == GPIOD_LINE_DIRECTION_INPUT);
    return 0;
}

int gpiod_line_settings_set_edge_detection(struct gpiod_line_settings *settings,
                                           enum gpiod_line_edge edge)
{
    assert_true(settings && edge == GPIOD_LINE_EDGE_BOTH);
    return 0;
}

int gpiod_line_settings_set_bias(struct gpiod_line_settings *settings, enum gpiod_line_bias bias)
{
    assert_non_null(settings);
    lib.bias = bias == GPIOD_LINE_BIAS_PULL_UP     ? LIB_UP
               : bias == GPIOD_LINE_BIAS_PULL_DOWN ? LIB_DOWN
                                                   : LIB_OFF;
    return 0;
}

void gpiod_line_settings_set_debounce_period_us(struct gpiod_line_settings *settings,
                                                unsigned long period)
{
    assert_non_null(settings);
    lib.debounce_us = period;
}

struct gpiod_line_config *gpiod_line_config_new(void)
{
    return lib_new();
}

void gpiod_line_config_free(struct gpiod_line_config *config)
{
    lib_free(config);
}

int gpiod_line_config_add_line_settings(struct gpiod_line_config *config,
                                        const unsigned int *offsets, size_t num_offsets,
                                        struct gpiod_line_settings *settings)
{
    assert_true(config && settings && num_offsets == 1);
    lib.offset = (int)offsets[0];
    return 0;
}

struct gpiod_request_config *gpiod_request_config_new(void)
{
    return lib_new();
}

void gpiod_request_config_free(struct gpiod_request_config *config)
{
    lib_free(config);
}

void gpiod_request_config_set_consumer(struct gpiod_request_config *config, const char *consumer)
{
    assert_non_null(config);
    assert_string_equal(consumer, "hdrig");
}

void gpiod_request_config_set_event_buffer_size(struct gpiod_request_config *config, size_t size)
{
    assert_true(config && size == 64);
}

struct gpiod_line_request *gpiod_chip_request_lines(struct gpiod_chip *chip,
                                                    struct gpiod_request_config *how,
                                                    struct gpiod_line_config *config)
{
    assert_true(chip && how && config);
    errno = lib.fail_request;
    if (lib.fail_request)
        return NULL;
    void *request = lib_new();
    if (request)
        lib.fd = open("/dev/null", O_RDONLY);
    return request;
}

void gpiod_line_request_release(struct gpiod_line_request *request)
{
    assert_non_null(request);
    close(lib.fd);
    lib_free(request);
}

int gpiod_line_request_get_fd(struct gpiod_line_request *request)
{
    assert_non_null(request);
    return lib.fd;
}

int gpiod_line_request_read_edge_events(struct gpiod_line_request *request,
                                        struct gpiod_edge_event_buffer *buffer, size_t max_events)
{
    assert_true(request && buffer && max_events == 1);
    assert_true(fcntl(lib.fd, F_GETFL) & O_NONBLOCK); // else this would wait
    if (lib.fail_read || lib.n_edges == 0)
        return lib_fail(lib.fail_read ? lib.fail_read : EAGAIN);
    lib.edge++;
    lib.n_edges--;
    return 1;
}

struct gpiod_edge_event_buffer *gpiod_edge_event_buffer_new(size_t capacity)
{
    assert_int_equal(capacity, 1);
    return lib_new();
}

void gpiod_edge_event_buffer_free(struct gpiod_edge_event_buffer *buffer)
{
    lib_free(buffer);
}

struct gpiod_edge_event *gpiod_edge_event_buffer_get_event(struct gpiod_edge_event_buffer *buffer,
                                                           unsigned long index)
{
    assert_true(buffer && index == 0);
    return (void *)buffer;
}

enum gpiod_edge_event_type gpiod_edge_event_get_event_type(struct gpiod_edge_event *event)
{
    assert_non_null(event);
    return lib.edge[-1].rising ? GPIOD_EDGE_EVENT_RISING_EDGE : GPIOD_EDGE_EVENT_FALLING_EDGE;
}

uint64_t gpiod_edge_event_get_timestamp_ns(struct gpiod_edge_event *event)
{
    assert_non_null(event);
    return (uint64_t)lib.edge[-1].time_ns;
}

unsigned long gpiod_edge_event_get_line_seqno(struct gpiod_edge_event *event)
{
    assert_non_null(event);
    return lib.edge[-1].seqno;
}

static void test_edges(void **state)
{
    static const struct gpiod_case_edge edge[] = {
        {100, false, 1}, {200, true, 2}, {300, true, 6}, {400, false, 8}, {500, false, 9}};
    struct trigger_event ev[6];
    (void)state;
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3,debounce_ms=7.5", edge, 5, ev), 3);
    assert_int_equal(lib.debounce_us, 7500);
    assert_true(ev[0].time_ns == 100 && ev[0].count == 1 && ev[0].lost == 0);
    assert_true(ev[1].time_ns == 400 && ev[1].count == 2 && ev[1].lost == 4);
    assert_true(ev[2].time_ns == 500 && ev[2].count == 3 && ev[2].lost == 0);
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3,edge=rising", edge, 5, ev), 2);
    assert_int_equal(lib.debounce_us, 5000);
    assert_true(ev[1].time_ns == 300 && ev[1].lost == 3);
    lib_lengths = true;
    assert_int_equal(lib_run("gpiod:/dev/gpiochip0/3", edge, 5, ev), 1);
    assert_true(ev[0].time_ns == 200 && ev[0].held_ns == 100 && ev[0].count == 1);
    lib_lengths = false;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open),
        cmocka_unit_test(test_no_memory),
        cmocka_unit_test(test_edges),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
