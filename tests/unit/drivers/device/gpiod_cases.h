/* gpiod_cases.h - what both versions of libgpiod must do for a button. The test program plays the
 * library: it includes this, then defines its functions over `lib`.
 * thread: one. */
#ifndef DEVICE_GPIOD_CASES_H
#define DEVICE_GPIOD_CASES_H

#include "drivers/device/trigger.h"

#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

struct gpiod_case_edge {
    int64_t time_ns;
    bool rising;
    uint32_t seqno;
};

/* The library with one chip of 8 lines, of which line 3 is called shutter. */
static struct {
    int objects;                                        // that are not freed yet
    int fail_open, fail_request, fail_read, fail_alloc; // errno; fail_alloc: which one
    int fd, offset;
    enum { LIB_UP = 1, LIB_DOWN, LIB_OFF } bias;
    unsigned long debounce_us;
    const struct gpiod_case_edge *edge;
    int n_edges;
} lib;

static inline int lib_fail(int why)
{
    errno = why;
    return -1;
}

/* Something that has to be freed; the library's types say nothing, so any address does. */
static inline void *lib_new(void)
{
    if (lib.fail_alloc > 0 && --lib.fail_alloc == 0) {
        errno = ENOMEM;
        return NULL;
    }
    lib.objects++;
    return malloc(1);
}

static inline void lib_free(void *p)
{
    lib.objects -= p != NULL;
    free(p);
}

static inline err_t lib_open(const char *uri, void **st)
{
    *st = malloc(trigger_gpiod.state_bytes);
    assert_non_null(*st);
    memset(*st, 0xA5, trigger_gpiod.state_bytes);
    err_t e = trigger_gpiod.open(*st, uri);
    if (e) {
        free(*st);
        assert_int_equal(lib.objects, 0);
    }
    return e;
}

static inline void lib_close(void *st)
{
    trigger_gpiod.close(st);
    free(st);
    assert_int_equal(lib.objects, 0);
}

static inline void lib_reset(void)
{
    memset(&lib, 0, sizeof lib);
    lib.offset = -1;
}

static inline void lib_says(const char *uri, err_t code, const char *says)
{
    void *st;
    assert_int_equal(lib_open(uri, &st), code);
    if (!strstr(err_text(), says))
        print_message("%s\n", err_text());
    assert_non_null(strstr(err_text(), says));
}

static void test_open(void **state)
{
    void *st;
    (void)state;
    lib_reset();
    assert_int_equal(lib_open("gpiod:/dev/gpiochip0/shutter", &st), OK);
    assert_true(lib.offset == 3 && lib.bias == LIB_UP && trigger_gpiod.fd(st) == lib.fd);
    lib_close(st);
    assert_int_equal(lib_open("gpiod:/dev/gpiochip0/7,edge=rising", &st), OK);
    assert_true(lib.offset == 7 && lib.bias == LIB_DOWN);
    lib_close(st);
    assert_int_equal(lib_open("gpiod:/dev/gpiochip0/0,bias=none", &st), OK);
    assert_true(lib.offset == 0 && lib.bias == LIB_OFF);
    lib_close(st);
    lib_says("gpiod:/dev/gpiochip0/8", ERR_ARG, "has 8 lines");
    lib_says("gpiod:/dev/gpiochip0/flash", ERR_LOST, "none of the chip's 8 lines");
    lib_says("gpio:/dev/gpiochip0/3", ERR_ARG, "does not begin with \"gpiod:\"");
    lib.fail_request = EBUSY;
    lib_says("gpiod:/dev/gpiochip0/3", ERR_BUSY, "used by \"leds\"");
    lib.fail_open = EACCES;
    lib_says("gpiod:/dev/gpiochip0/3", ERR_IO, "group \"hdrig\"");
    lib.fail_open = ENOENT;
    lib_says("gpiod:/dev/gpiochip0/3", ERR_LOST, "no such GPIO chip");
    lib.fail_open = ENOTTY;
    lib_says("gpiod:/dev/gpiochip0/3", ERR_UNSUPPORTED, "not a GPIO chip");
}

static void test_no_memory(void **state)
{
    err_t e;
    int i = 0;
    (void)state;
    do {
        void *st;
        lib_reset();
        lib.fail_alloc = ++i;
        e = lib_open("gpiod:/dev/gpiochip0/3", &st);
        if (!e)
            lib_close(st);
        assert_true(e == OK || e == ERR_NOMEM);
    } while (e);
    assert_true(i > 1);
}

static bool lib_lengths; // lib_run asks for them

/* Events that come from those edges. */
static inline int lib_run(const char *uri, const struct gpiod_case_edge *edges, int n,
                          struct trigger_event *out)
{
    void *st;
    int got = 0;
    lib_reset();
    lib.edge = edges;
    lib.n_edges = n;
    assert_int_equal(lib_open(uri, &st), OK);
    if (lib_lengths)
        trigger_gpiod.lengths(st);
    err_t e;
    while ((e = trigger_gpiod.next(st, &out[got])) == OK)
        got++;
    assert_int_equal(e, ERR_AGAIN);
    lib.fail_read = ENODEV;
    assert_int_equal(trigger_gpiod.next(st, &out[got]), ERR_LOST);
    lib.fail_read = EIO;
    assert_int_equal(trigger_gpiod.next(st, &out[got]), ERR_IO);
    lib_close(st);
    return got;
}

#endif
