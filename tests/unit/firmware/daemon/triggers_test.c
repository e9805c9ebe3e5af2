/* Presses of triggers that the test plays: what counts, what is too soon, what is a long one. */
#include "firmware/daemon/triggers.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#define MS INT64_C(1000000)

/* The device. */
static struct {
    bool there, gone, lengths;
    int n, opened;
    struct trigger_event ev[8];
} dev;

static err_t dev_open(void *st, const char *uri)
{
    (void)st;
    (void)uri;
    dev.opened += dev.there;
    return dev.there ? OK : err_fail(ERR_LOST, "not there");
}

static void dev_close(void *st)
{
    (void)st;
    dev.opened--;
}

static int dev_fd(const void *st)
{
    (void)st;
    return 0;
}

static void dev_lengths(void *st)
{
    (void)st;
    dev.lengths = true;
}

static err_t dev_next(void *st, struct trigger_event *out)
{
    (void)st;
    if (dev.n == 0)
        return dev.gone ? err_fail(ERR_LOST, "gone") : ERR_AGAIN;
    *out = dev.ev[0];
    memmove(dev.ev, dev.ev + 1, (size_t)--dev.n * sizeof dev.ev[0]);
    return OK;
}

static const struct trigger_ops ops = {.name = "dev",
                                       .state_bytes = 1,
                                       .open = dev_open,
                                       .close = dev_close,
                                       .fd = dev_fd,
                                       .lengths = dev_lengths,
                                       .next = dev_next};

static err_t find(const char *uri, const struct trigger_ops **out)
{
    *out = &ops;
    return strcmp(uri, "dev:") == 0 ? OK : err_fail(ERR_ARG, "%s: no trigger", uri);
}

static char heard[64];

static void press(void *ctx, int64_t time_ns, bool is_long)
{
    size_t n = strlen(heard);
    (void)ctx;
    snprintf(heard + n, sizeof heard - n, "%s%d ", is_long ? "long " : "", (int)(time_ns / MS));
}

static struct triggers *start(const char *uri, int hold_ms)
{
    static char uris[CONFIG_TRIGGERS][CONFIG_TEXT];
    struct triggers *t;
    struct triggers_config cfg = {
        .uri = uris, .lockout_ms = 200, .hold_ms = hold_ms, .find = find, .press = press};
    memset(&dev, 0, sizeof dev);
    dev.there = true;
    heard[0] = 0;
    memcpy(uris[2], uri, strlen(uri) + 1);
    assert_int_equal(triggers_open(&cfg, &t), strcmp(uri, "dev:") == 0 ? OK : ERR_ARG);
    return t;
}

static void event(int64_t ms, int64_t held_ms)
{
    dev.ev[dev.n++] = (struct trigger_event){ms * MS, 1, 0, held_ms * MS};
}

static void presses(void **state)
{
    struct triggers_count n;
    (void)state;
    struct triggers *t = start("dev:", 0);
    event(100, 0);
    event(299, 0); // too soon
    event(300, 0);
    dev.ev[2].lost = 5;
    assert_int_equal(triggers_step(t, 0), OK);
    assert_string_equal(heard, "100 300 ");
    assert_false(dev.lengths); // presses count when they begin
    triggers_look(t, &n);
    assert_true(n.locked_out == 1 && n.lost_edges == 5);
    struct pollfd fds[CONFIG_TRIGGERS];
    assert_int_equal(triggers_poll(t, fds, CONFIG_TRIGGERS), 1);
    triggers_close(t);
    assert_int_equal(dev.opened, 0);
    assert_null(start("other:", 0));
}

static void a_long_press(void **state)
{
    (void)state;
    struct triggers *t = start("dev:", 2000);
    event(1000, 100);
    event(5000, 1999);
    event(9000, 2000);
    event(9100, 4000); // too soon
    assert_int_equal(triggers_step(t, 0), OK);
    assert_string_equal(heard, "1000 5000 long 9000 ");
    assert_true(dev.lengths);
    triggers_close(t);
}

/* Pulled out and plugged in again: lengths are asked for again. */
static void comes_and_goes(void **state)
{
    (void)state;
    struct triggers *t = start("dev:", 2000);
    dev.there = false;
    assert_int_equal(triggers_step(t, 0), OK);
    dev.there = true;
    assert_int_equal(triggers_step(t, 1), OK);
    assert_int_equal(dev.opened, 0); // not at once
    assert_int_equal(triggers_step(t, 3000 * MS), OK);
    assert_int_equal(dev.opened, 1);
    dev.gone = true;
    assert_int_equal(triggers_step(t, 3001 * MS), OK);
    assert_int_equal(dev.opened, 0);
    dev.gone = dev.lengths = false;
    event(7000, 3000);
    assert_int_equal(triggers_step(t, 6000 * MS), OK);
    assert_true(dev.lengths);
    assert_string_equal(heard, "long 7000 ");
    triggers_close(t);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(presses),
        cmocka_unit_test(a_long_press),
        cmocka_unit_test(comes_and_goes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
