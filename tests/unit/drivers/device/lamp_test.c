/* The lamp's line over time, seen as the eye sees it: from outside. */
#include "drivers/device/lamp.h"

#include "tests/unit/drivers/device/gpio_fake.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static const int64_t ms = 1000000;

static struct gpio_fake_line *wire(void)
{
    return &gpio_fake.chip[0].line[5];
}

static struct lamp *open_lamp(const char *uri)
{
    struct lamp *l;
    assert_int_equal(lamp_open_with(uri, &gpio_fake_sys, &l), OK);
    assert_int_equal(lamp_next_ns(l), INT64_MAX);
    return l;
}

/* Ticks as lamp_next_ns wants them, until `to`. */
static void run(struct lamp *l, int64_t to)
{
    for (int64_t at = lamp_next_ns(l); at <= to; at = lamp_next_ns(l)) {
        assert_int_equal(lamp_tick(l, at), OK);
        assert_true(lamp_next_ns(l) > at);
    }
}

static void test_steady(void **state)
{
    (void)state;
    gpio_fake_start();
    for (int low = 0; low < 2; low++) {
        struct lamp *l = open_lamp(low ? "gpio:rigchip/lamp,active=low" : "gpio:rigchip/lamp");
        assert_int_equal(wire()->level, low);
        lamp_show(l, LAMP_ARMED, 5 * ms);
        assert_int_equal(lamp_next_ns(l), 5 * ms);
        assert_int_equal(lamp_tick(l, 4 * ms), OK); // too early
        assert_int_equal(wire()->level, low);
        run(l, 100000 * ms);
        assert_int_equal(wire()->level, !low);
        assert_int_equal(wire()->sets, 1);
        lamp_show(l, LAMP_ARMED, 6 * ms);
        assert_int_equal(lamp_next_ns(l), INT64_MAX);
        lamp_show(l, LAMP_OFF, 7 * ms);
        run(l, 100000 * ms);
        assert_int_equal(wire()->level, low);
        assert_int_equal(wire()->sets, 2);
        lamp_show(l, LAMP_ARMED, 8 * ms);
        run(l, 8 * ms);
        lamp_close(l);
        assert_int_equal(wire()->level, low);
        wire()->sets = 0;
    }
    lamp_close(NULL);
    gpio_fake_stop();
}

/* Flashes in a second, and ms that it is lit. */
static void count(struct lamp *l, int64_t from, int *flashes, int *lit)
{
    bool was = wire()->level;
    *flashes = *lit = 0;
    for (int i = 0; i < 1000; i++) {
        run(l, from + i * ms);
        *flashes += wire()->level && !was;
        *lit += wire()->level;
        was = wire()->level;
    }
}

static void test_patterns(void **state)
{
    int flashes, lit;
    (void)state;
    gpio_fake_start();
    struct lamp *l = open_lamp("gpio:rigchip/lamp");
    lamp_show(l, LAMP_BUSY, 77 * ms);
    for (int i = 0; i < 3; i++) {
        count(l, 77 * ms + i * 1000 * ms, &flashes, &lit);
        assert_true(flashes == 4 && lit == 500);
    }
    lamp_show(l, LAMP_FAULT, 5000 * ms);
    for (int i = 0; i < 3; i++) {
        lamp_show(l, LAMP_FAULT, 5000 * ms + 300 * ms + i); // keeps its time
        count(l, 5000 * ms + i * 1000 * ms, &flashes, &lit);
        assert_true(flashes == 2 && lit == 200);
    }
    lamp_close(l);
    gpio_fake_stop();
}

/* A tick that comes late sees the lamp as it has to be, and goes on in time. */
static void test_late(void **state)
{
    (void)state;
    gpio_fake_start();
    struct lamp *l = open_lamp("gpio:rigchip/lamp");
    lamp_show(l, LAMP_BUSY, 0);
    assert_int_equal(lamp_tick(l, 0), OK);
    assert_int_equal(lamp_next_ns(l), 125 * ms);
    assert_int_equal(lamp_tick(l, 10 * 250 * ms + 124 * ms), OK);
    assert_true(wire()->level && wire()->sets == 1);
    assert_int_equal(lamp_next_ns(l), 10 * 250 * ms + 125 * ms);
    assert_int_equal(lamp_tick(l, 86400LL * 1000 * ms + 125 * ms), OK);
    assert_false(wire()->level);
    assert_int_equal(lamp_next_ns(l), 86400LL * 1000 * ms + 250 * ms);
    lamp_close(l);
    gpio_fake_stop();
}

static void test_gone(void **state)
{
    (void)state;
    gpio_fake_start();
    struct lamp *l = open_lamp("gpio:rigchip/lamp");
    lamp_show(l, LAMP_BUSY, 0);
    assert_int_equal(lamp_tick(l, 0), OK);
    gpio_fake.chip[0].gone = true;
    assert_int_equal(lamp_tick(l, 125 * ms), ERR_LOST);
    assert_non_null(strstr(err_text(), "gpio:rigchip/lamp: the GPIO chip has gone"));
    assert_int_equal(lamp_next_ns(l), INT64_MAX);
    assert_int_equal(lamp_tick(l, 250 * ms), OK); // told once
    lamp_show(l, LAMP_FAULT, 300 * ms);
    assert_int_equal(lamp_next_ns(l), INT64_MAX);
    lamp_close(l);
    gpio_fake.chip[0].gone = false;
    l = open_lamp("gpio:rigchip/lamp");
    lamp_show(l, LAMP_ARMED, 0);
    gpio_fake.fail_call = gpio_fake.calls + 1;
    gpio_fake.fail_errno = EIO;
    assert_int_equal(lamp_tick(l, 0), ERR_IO);
    lamp_close(l);
    gpio_fake_stop();
}

static void test_refused(void **state)
{
    struct lamp *l, *second;
    (void)state;
    gpio_fake_start();
    assert_int_equal(lamp_open_with("gpio:rigchip/lamp,edge=rising", &gpio_fake_sys, &l), ERR_ARG);
    assert_null(l);
    assert_int_equal(lamp_open_with("gpio:rigchip/lamp,active=no", &gpio_fake_sys, &l), ERR_ARG);
    assert_int_equal(lamp_open("gpio:/nowhere/0", &l), ERR_LOST);
    l = open_lamp("gpio:rigchip/lamp");
    assert_int_equal(lamp_open_with("gpio:rigchip/5", &gpio_fake_sys, &second), ERR_BUSY);
    lamp_close(l);
    gpio_fake_stop();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_steady), cmocka_unit_test(test_patterns), cmocka_unit_test(test_late),
        cmocka_unit_test(test_gone),   cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
