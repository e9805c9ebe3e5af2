/* Buttons on chips that behave as the kernel's, keys of an input device, the timer. */
#include "drivers/device/trigger.h"

#include "tests/unit/drivers/device/gpio_fake.h"

#include <linux/input.h>
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <time.h>

#include <cmocka.h>

static const int64_t ms = 1000000;

static struct gpio_fake_line *button(void)
{
    return &gpio_fake.chip[0].line[3];
}

static err_t try_gpio(const char *rest, void **st)
{
    char uri[700];
    snprintf(uri, sizeof uri, "gpio:%s", rest);
    *st = malloc(trigger_gpio.state_bytes);
    assert_non_null(*st);
    memset(*st, 0xA5, trigger_gpio.state_bytes);
    err_t e = trigger_gpio_open_with(*st, uri, &gpio_fake_sys);
    if (e)
        free(*st);
    return e;
}

static void *open_gpio(const char *rest)
{
    void *st;
    err_t e = try_gpio(rest, &st);
    if (e)
        print_message("%s: %s\n", rest, err_text());
    assert_int_equal(e, OK);
    return st;
}

static void close_gpio(void *st)
{
    trigger_gpio.close(st);
    free(st);
}

static void refuse(const char *rest, err_t code, const char *says)
{
    void *st;
    err_t e = try_gpio(rest, &st);
    if (e != code || !strstr(err_text(), says))
        print_message("%s: %d %s\n", rest, e, err_text());
    assert_int_equal(e, code);
    assert_non_null(strstr(err_text(), says));
    assert_int_equal(gpio_fake.n_open, 0);
}

static bool readable(int fd)
{
    struct pollfd p = {.fd = fd, .events = POLLIN};
    return poll(&p, 1, 0) == 1;
}

/* Everything that waits; *last is the last one. */
static int drain(void *st, struct trigger_event *last, uint32_t *lost)
{
    int n = 0;
    err_t e;
    struct trigger_event ev;
    while ((e = trigger_gpio.next(st, &ev)) == OK) {
        n++;
        *lost += ev.lost;
        *last = ev;
    }
    assert_int_equal(e, ERR_AGAIN);
    assert_false(readable(trigger_gpio.fd(st)));
    return n;
}

static void test_uri(void **state)
{
    static const struct {
        const char *rest, *says;
    } bad[] = {
        {"", "not CHIP/LINE"},
        {"rigchip", "not CHIP/LINE"},
        {"rigchip/", "not CHIP/LINE"},
        {"/3", "not CHIP/LINE"},
        {",edge=rising", "not CHIP/LINE"},
        {"rigchip/a-name-of-thirty-two-characters-", "not CHIP/LINE"},
        {"rigchip/3,edge=up", "edge is \"up\", not one of falling|rising"},
        {"rigchip/3,bias=left", "bias is \"left\""},
        {"rigchip/3,debounce_ms=1001", "not a number in 0..1000"},
        {"rigchip/3,debounce_ms=-1", "not a number in 0..1000"},
        {"rigchip/3,active=low", "no option is called \"active\""},
        {"rigchip/8", "has 8 lines"},
        {"rigchip/99999999999999999999", "has 8 lines"},
    };
    void *st = malloc(trigger_gpio.state_bytes);
    (void)state;
    gpio_fake_start();
    assert_non_null(st);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        refuse(bad[i].rest, ERR_ARG, bad[i].says);
    assert_int_equal(trigger_gpio_open_with(st, "gpiod:rigchip/3", &gpio_fake_sys), ERR_ARG);
    free(st);
    gpio_fake_stop();
}

static void test_lookup(void **state)
{
    char path[600];
    static const char *const good[] = {"rigchip/shutter", "gpiochip0/3", "rigchip/3"};
    (void)state;
    gpio_fake_start();
    assert_int_equal(symlink(tmpdir_path("gpiochip0"), tmpdir_path("gpiochip4")), 0);
    for (int i = 0; i < 3; i++) {
        close_gpio(open_gpio(good[i]));
        assert_int_equal(button()->asked.offsets[0], 3);
        memset(&button()->asked, 0, sizeof button()->asked);
    }
    snprintf(path, sizeof path, "%s/shutter", tmpdir_path("gpiochip4"));
    close_gpio(open_gpio(path));
    assert_int_equal(button()->asked.offsets[0], 3);
    refuse("other/3", ERR_ARG, "both have this label");
    refuse("nochip/3", ERR_LOST, "no such GPIO chip");
    refuse("/nowhere/3", ERR_LOST, "no such GPIO chip");
    refuse("rigchip/nobody", ERR_LOST, "none of the chip's 8 lines has this name");
    tmpdir_text("file", "");
    snprintf(path, sizeof path, "%s/3", tmpdir_path("file"));
    refuse(path, ERR_UNSUPPORTED, "not a GPIO chip");
    gpio_fake.chip[0].open_errno = EACCES;
    refuse("rigchip/3", ERR_IO, "must be in group \"hdrig\"");
    snprintf(path, sizeof path, "%s/3", tmpdir_path("gpiochip0"));
    refuse(path, ERR_IO, "must be in group \"hdrig\"");
    gpio_fake_stop();
}

static void check_flags(const char *rest, uint64_t flags, uint32_t debounce_us)
{
    const struct gpio_v2_line_request *r = &button()->asked;
    close_gpio(open_gpio(rest));
    assert_int_equal(r->config.flags, flags | GPIO_V2_LINE_FLAG_INPUT |
                                          GPIO_V2_LINE_FLAG_EDGE_RISING |
                                          GPIO_V2_LINE_FLAG_EDGE_FALLING);
    assert_int_equal(r->config.num_attrs, debounce_us > 0);
    if (debounce_us > 0) {
        assert_int_equal(r->config.attrs[0].attr.id, GPIO_V2_LINE_ATTR_ID_DEBOUNCE);
        assert_int_equal(r->config.attrs[0].attr.debounce_period_us, debounce_us);
        assert_int_equal(r->config.attrs[0].mask, 1);
    }
    assert_int_equal(r->event_buffer_size, 64);
    assert_string_equal(r->consumer, "hdrig");
}

static void test_request(void **state)
{
    (void)state;
    gpio_fake_start();
    check_flags("rigchip/3", GPIO_V2_LINE_FLAG_BIAS_PULL_UP, 5000);
    check_flags("rigchip/3,edge=rising", GPIO_V2_LINE_FLAG_BIAS_PULL_DOWN, 5000);
    check_flags("rigchip/3,bias=none,debounce_ms=0", GPIO_V2_LINE_FLAG_BIAS_DISABLED, 0);
    check_flags("rigchip/3,edge=rising,bias=up,debounce_ms=0.0015", GPIO_V2_LINE_FLAG_BIAS_PULL_UP,
                2);
    gpio_fake_stop();
}

/* A line that is held at open is no trigger, nor is its release; a press is one, at its stamp. */
static void test_press(void **state)
{
    struct trigger_event ev = {0};
    uint32_t lost = 0;
    (void)state;
    gpio_fake_start();
    button()->level = false;
    void *st = open_gpio("rigchip/shutter");
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_AGAIN);
    gpio_fake_drive(button(), 100 * ms, true);
    gpio_fake_wait(button(), 200 * ms);
    assert_true(readable(trigger_gpio.fd(st)));
    assert_int_equal(drain(st, &ev, &lost), 0);
    gpio_fake_drive(button(), 300 * ms, false);
    gpio_fake_wait(button(), 304 * ms);
    assert_false(readable(trigger_gpio.fd(st)));
    gpio_fake_wait(button(), 305 * ms);
    assert_int_equal(drain(st, &ev, &lost), 1);
    assert_true(ev.time_ns == 305 * ms && ev.count == 1 && ev.lost == 0);
    close_gpio(st);
    button()->level = false;
    st = open_gpio("rigchip/3,edge=rising,debounce_ms=0");
    gpio_fake_drive(button(), 400 * ms, true);
    gpio_fake_drive(button(), 401 * ms, false);
    assert_int_equal(drain(st, &ev, &lost), 1);
    assert_true(ev.time_ns == 400 * ms && lost == 0);
    close_gpio(st);
    gpio_fake_stop();
}

/* Bursts shorter than the debouncing are one press or none. */
static void test_bounce(void **state)
{
    struct trigger_event ev = {0};
    uint32_t lost = 0;
    int64_t t = 0;
    (void)state;
    gpio_fake_start();
    void *st = open_gpio("rigchip/shutter,debounce_ms=10");
    srand(5);
    for (uint32_t press = 1; press <= 300; press++) {
        for (int down = 1; down >= 0; down--) {
            t += 50 * ms;
            for (int bounces = rand() % 20; bounces > 0; bounces--) {
                gpio_fake_drive(button(), t += 1 + rand() % (4 * ms), !down);
                gpio_fake_drive(button(), t += 1 + rand() % (4 * ms), down);
                gpio_fake_drive(button(), t += 1 + rand() % (4 * ms), !down);
            }
            gpio_fake_drive(button(), t += ms, !down);
            gpio_fake_wait(button(), t + 10 * ms);
        }
        gpio_fake_drive(button(), t += 50 * ms, false); // a glitch of 2 ms
        gpio_fake_drive(button(), t += 2 * ms, true);
        gpio_fake_wait(button(), t += 20 * ms);
        assert_int_equal(drain(st, &ev, &lost), 1);
        assert_int_equal(ev.count, press);
    }
    assert_int_equal(lost, 0);
    close_gpio(st);
    gpio_fake_stop();
}

/* A thousand edges: all of them where they are read in time, else the gap is told. */
static void test_burst(void **state)
{
    struct trigger_event ev = {0};
    uint32_t lost = 0;
    int64_t t = 0;
    int n = 0;
    (void)state;
    gpio_fake_start();
    void *st = open_gpio("rigchip/shutter,debounce_ms=0");
    for (int i = 0; i < 1000; i++) {
        gpio_fake_drive(button(), t += 10000, i % 2 == 1);
        if (i % 50 == 49)
            n += drain(st, &ev, &lost);
    }
    assert_true(n == 500 && ev.count == 500 && lost == 0 && ev.time_ns == t - 10000);
    for (int i = 0; i < 1000; i++)
        gpio_fake_drive(button(), t += 10000, i % 2 == 1);
    assert_int_equal(trigger_gpio.next(st, &ev), OK);
    assert_true(ev.lost == 1000 - 64 && ev.count == 501);
    assert_int_equal(drain(st, &ev, &lost), 31);
    assert_true(lost == 0 && button()->lost == 1000 - 64);
    close_gpio(st);
    gpio_fake_stop();
}

/* What is lost before an edge that does not count is told with the next one that does. */
static void test_lost_before_release(void **state)
{
    struct trigger_event ev = {0};
    (void)state;
    gpio_fake_start();
    void *st = open_gpio("rigchip/shutter,debounce_ms=0");
    for (int i = 0; i < 4; i++)
        gpio_fake_drive(button(), i * ms, i % 2 == 1);
    button()->edge[0] = button()->edge[3]; // 1, 2 and 3 are lost, 4 is a release
    button()->n = 1;
    gpio_fake_drive(button(), 9 * ms, false);
    assert_int_equal(trigger_gpio.next(st, &ev), OK);
    assert_true(ev.lost == 3 && ev.count == 1 && ev.time_ns == 9 * ms);
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_AGAIN);
    gpio_fake_drive(button(), 10 * ms, true);
    gpio_fake_drive(button(), 11 * ms, false);
    assert_int_equal(trigger_gpio.next(st, &ev), OK);
    assert_true(ev.lost == 0 && ev.count == 2);
    close_gpio(st);
    gpio_fake_stop();
}

/* Where lengths are asked for, a press counts when it ends, unless its begin is not known. */
static void test_lengths(void **state)
{
    struct trigger_event ev = {0};
    uint32_t lost = 0;
    (void)state;
    gpio_fake_start();
    button()->level = false; // down at open
    void *st = open_gpio("rigchip/shutter");
    trigger_gpio.lengths(st);
    gpio_fake_drive(button(), 100 * ms, true);
    gpio_fake_wait(button(), 200 * ms);
    assert_int_equal(drain(st, &ev, &lost), 0);
    gpio_fake_drive(button(), 300 * ms, false);
    gpio_fake_wait(button(), 400 * ms);
    assert_int_equal(drain(st, &ev, &lost), 0);
    gpio_fake_drive(button(), 450 * ms, true);
    gpio_fake_drive(button(), 452 * ms, false); // bounces
    gpio_fake_drive(button(), 454 * ms, true);
    gpio_fake_wait(button(), 500 * ms);
    assert_int_equal(drain(st, &ev, &lost), 1);
    assert_true(ev.time_ns == 459 * ms && ev.held_ns == 154 * ms && ev.count == 1);
    gpio_fake_drive(button(), 600 * ms, false);
    gpio_fake_wait(button(), 3600 * ms);
    assert_int_equal(drain(st, &ev, &lost), 0);
    gpio_fake_drive(button(), 3700 * ms, true);
    gpio_fake_wait(button(), 3800 * ms);
    assert_int_equal(drain(st, &ev, &lost), 1);
    assert_true(ev.held_ns == 3100 * ms && ev.count == 2);
    close_gpio(st);
    button()->level = true;
    st = open_gpio("rigchip/shutter,debounce_ms=0");
    trigger_gpio.lengths(st);
    for (int i = 1; i < 7; i++)
        gpio_fake_drive(button(), 5000 * i * ms, i % 2 == 0);
    button()->edge[1] = button()->edge[3]; // end of the first press and begin of the second lost
    button()->edge[2] = button()->edge[4];
    button()->edge[3] = button()->edge[5];
    button()->n = 4;
    assert_int_equal(trigger_gpio.next(st, &ev), OK);
    assert_true(ev.held_ns == 5000 * ms && ev.time_ns == 30000 * ms);
    assert_true(ev.count == 1 && ev.lost == 2);
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_AGAIN);
    close_gpio(st);
    gpio_fake_stop();
}

static void test_refused_lines(void **state)
{
    (void)state;
    gpio_fake_start();
    void *st = open_gpio("rigchip/3");
    void *second;
    assert_int_equal(try_gpio("rigchip/shutter", &second), ERR_BUSY);
    assert_non_null(strstr(err_text(), "the line is used by \"hdrig\""));
    close_gpio(st);
    snprintf(button()->consumer, 32, "sd-card detect");
    refuse("rigchip/3", ERR_BUSY, "used by \"sd-card detect\"");
    button()->consumer[0] = '\0';
    gpio_fake.chip[0].request_errno = ENXIO;
    refuse("rigchip/3", ERR_UNSUPPORTED, "cannot do what is asked");
    gpio_fake_stop();
}

static void test_chip_removed(void **state)
{
    struct trigger_event ev;
    (void)state;
    gpio_fake_start();
    void *st = open_gpio("rigchip/3");
    gpio_fake.chip[0].gone = true;
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_LOST);
    assert_non_null(strstr(err_text(), "gpio:rigchip/3: the GPIO chip has gone"));
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_LOST);
    close_gpio(st);
    gpio_fake.chip[0].gone = false;
    st = open_gpio("rigchip/3");
    gpio_fake.fail_call = gpio_fake.calls + 1;
    gpio_fake.fail_errno = EIO;
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_IO);
    assert_int_equal(trigger_gpio.next(st, &ev), ERR_AGAIN);
    close_gpio(st);
    gpio_fake_stop();
}

/* Each call of an opening fails once: nothing stays open, and every reason has its code. */
static void test_every_failure(void **state)
{
    static const int why[] = {EIO, ENODEV, EACCES, ENOMEM, ENOTTY};
    void *st;
    (void)state;
    gpio_fake_start();
    close_gpio(open_gpio("rigchip/shutter"));
    int calls = gpio_fake.calls;
    assert_true(calls > 8);
    for (size_t k = 0; k < sizeof why / sizeof why[0]; k++)
        for (int i = 1; i <= calls; i++) {
            gpio_fake.calls = 0;
            gpio_fake.fail_call = i;
            gpio_fake.fail_errno = why[k];
            err_t e = try_gpio("rigchip/shutter", &st);
            if (e == OK) // a chip that is not ours
                close_gpio(st);
            else
                assert_true(e == ERR_IO || e == ERR_LOST || e == ERR_NOMEM || e == ERR_UNSUPPORTED);
            assert_int_equal(gpio_fake.n_open, 0);
        }
    gpio_fake_stop();
}

/* ---- keys ---- */

static struct {
    int end[2];
    int open_errno, bit_errno, clock_errno, read_errno;
    bool keyless;
    int clock;
} input;

static int input_open(const char *path, int flags)
{
    assert_string_equal(path, "/dev/input/event0");
    assert_true(flags & O_NONBLOCK);
    if (input.open_errno)
        return gpio_fake_no(input.open_errno);
    assert_int_equal(pipe2(input.end, O_NONBLOCK), 0);
    return input.end[0];
}

static int input_close(int fd)
{
    assert_int_equal(fd, input.end[0]);
    close(input.end[1]);
    return close(fd);
}

static int input_ioctl(int fd, unsigned long request, void *arg)
{
    (void)fd;
    if (request == EVIOCSCLOCKID) {
        input.clock = *(int *)arg;
        return input.clock_errno ? gpio_fake_no(input.clock_errno) : 0;
    }
    assert_int_equal(_IOC_NR(request), _IOC_NR(EVIOCGBIT(EV_KEY, 0)));
    if (!input.keyless)
        ((unsigned char *)arg)[KEY_ENTER / 8] |= 1 << KEY_ENTER % 8;
    return input.bit_errno ? gpio_fake_no(input.bit_errno) : KEY_MAX / 8 + 1;
}

static ssize_t input_read(int fd, void *buf, size_t n)
{
    return input.read_errno ? gpio_fake_no(input.read_errno) : read(fd, buf, n);
}

static const struct device_sys input_sys = {"/dev", input_open, input_close, input_ioctl,
                                            input_read};

static void type(int sec, int kind, int code, int value)
{
    struct input_event ev = {.type = (uint16_t)kind, .code = (uint16_t)code, .value = value};
    ev.input_event_sec = sec;
    ev.input_event_usec = 250;
    assert_int_equal(write(input.end[1], &ev, sizeof ev), sizeof ev);
}

static err_t key_event(void *st, int64_t time_ns, uint32_t count, uint32_t lost)
{
    struct trigger_event ev = {0};
    err_t e = trigger_evdev.next(st, &ev);
    if (e)
        return e;
    assert_true(ev.time_ns == time_ns && ev.count == count && ev.lost == lost);
    return OK;
}

static void test_lengths_of_keys(void **state)
{
    struct trigger_event ev;
    void *st = malloc(trigger_evdev.state_bytes);
    (void)state;
    assert_non_null(st);
    memset(&input, 0, sizeof input);
    assert_int_equal(trigger_evdev_open_with(st, "evdev:/dev/input/event0", &input_sys), OK);
    trigger_evdev.lengths(st);
    type(1, EV_KEY, KEY_ENTER, 0); // was down at open
    type(2, EV_KEY, KEY_ENTER, 1);
    type(3, EV_KEY, KEY_ENTER, 2);
    assert_int_equal(trigger_evdev.next(st, &ev), ERR_AGAIN);
    type(5, EV_KEY, KEY_A, 0); // another one
    type(6, EV_KEY, KEY_ENTER, 0);
    assert_int_equal(trigger_evdev.next(st, &ev), OK);
    assert_true(ev.time_ns == 6000250000 && ev.held_ns == 4000000000 && ev.count == 1);
    type(7, EV_KEY, KEY_ENTER, 1);
    type(8, EV_SYN, SYN_DROPPED, 0);
    type(8, EV_SYN, SYN_REPORT, 0);
    type(9, EV_KEY, KEY_ENTER, 0); // belongs to no press
    assert_int_equal(trigger_evdev.next(st, &ev), ERR_AGAIN);
    trigger_evdev.close(st);
    free(st);
    assert_null(trigger_timer.lengths);
}

static void test_keys(void **state)
{
    void *st = malloc(trigger_evdev.state_bytes);
    (void)state;
    assert_non_null(st);
    memset(&input, 0, sizeof input);
    assert_int_equal(trigger_evdev_open_with(st, "evdev:/dev/input/event0", &input_sys), OK);
    assert_int_equal(input.clock, CLOCK_MONOTONIC);
    assert_int_equal(key_event(st, 0, 0, 0), ERR_AGAIN);
    type(1, EV_KEY, KEY_ENTER, 1);
    type(1, EV_SYN, SYN_REPORT, 0);
    type(2, EV_KEY, KEY_ENTER, 2);
    type(3, EV_KEY, KEY_ENTER, 0);
    type(4, EV_KEY, KEY_A, 1);
    type(4, EV_SYN, SYN_DROPPED, 0);
    type(4, EV_KEY, KEY_A, 1); // part of an incomplete report
    type(4, EV_SYN, SYN_REPORT, 0);
    type(5, EV_KEY, KEY_A, 1);
    assert_int_equal(key_event(st, 1000250000, 1, 0), OK);
    assert_int_equal(key_event(st, 4000250000, 2, 0), OK);
    assert_int_equal(key_event(st, 5000250000, 3, 1), OK);
    type(6, EV_KEY, KEY_A, 1);
    assert_int_equal(key_event(st, 6000250000, 4, 0), OK);
    assert_int_equal(key_event(st, 0, 0, 0), ERR_AGAIN);
    assert_false(readable(trigger_evdev.fd(st)));
    input.read_errno = ENODEV;
    assert_int_equal(key_event(st, 0, 0, 0), ERR_LOST);
    input.read_errno = EIO;
    assert_int_equal(key_event(st, 0, 0, 0), ERR_IO);
    trigger_evdev.close(st);
    input.read_errno = 0;
    assert_int_equal(trigger_evdev_open_with(st, "evdev:/dev/input/event0,key=28", &input_sys), OK);
    type(1, EV_KEY, KEY_A, 1);
    type(2, EV_KEY, KEY_ENTER, 1);
    assert_int_equal(key_event(st, 2000250000, 1, 0), OK);
    trigger_evdev.close(st);
    free(st);
}

static void refuse_key(const char *uri, err_t code, const char *says)
{
    void *st = malloc(trigger_evdev.state_bytes);
    assert_non_null(st);
    assert_int_equal(trigger_evdev_open_with(st, uri, &input_sys), code);
    if (!strstr(err_text(), says))
        print_message("%s\n", err_text());
    assert_non_null(strstr(err_text(), says));
    free(st);
}

static void test_refused_keys(void **state)
{
    (void)state;
    memset(&input, 0, sizeof input);
    refuse_key("evdev:", ERR_ARG, "a path of 0 bytes");
    refuse_key("gpio:/dev/input/event0", ERR_ARG, "does not begin with");
    refuse_key("evdev:/dev/input/event0,key=0", ERR_ARG, "in 1..767");
    refuse_key("evdev:/dev/input/event0,key=768", ERR_ARG, "in 1..767");
    refuse_key("evdev:/dev/input/event0,key=30", ERR_ARG, "has no key 30");
    input.keyless = true;
    refuse_key("evdev:/dev/input/event0", ERR_UNSUPPORTED, "has no keys");
    input.bit_errno = ENOTTY;
    refuse_key("evdev:/dev/input/event0", ERR_UNSUPPORTED, "not an input device");
    input.bit_errno = 0;
    input.clock_errno = ENODEV;
    refuse_key("evdev:/dev/input/event0", ERR_LOST, "no such input device");
    input.open_errno = EACCES;
    refuse_key("evdev:/dev/input/event0", ERR_IO, "group \"input\"");
    input.open_errno = ENOENT;
    refuse_key("evdev:/dev/input/event0", ERR_LOST, "no such input device");
}

/* ---- timer ---- */

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void test_timer(void **state)
{
    static const char *const bad[] = {"timer:",     "timer:0.009", "timer:1000001", "timer:nan",
                                      "timer:1,2",  "timer:x",     "timer:-1",      "timer",
                                      "gpio:timer", "timer:1s",    "timer:inf",     ""};
    struct trigger_event a, b;
    void *st = malloc(trigger_timer.state_bytes);
    (void)state;
    assert_non_null(st);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        assert_int_equal(trigger_timer.open(st, bad[i]), ERR_ARG);
    int64_t start = now_ns();
    assert_int_equal(trigger_timer.open(st, "timer:0.01"), OK);
    struct pollfd p = {.fd = trigger_timer.fd(st), .events = POLLIN};
    assert_int_equal(poll(&p, 1, 10000), 1);
    assert_int_equal(trigger_timer.next(st, &a), OK);
    assert_true(a.time_ns <= now_ns() && a.time_ns >= start + 9 * ms && a.count == 1);
    nanosleep(&(struct timespec){.tv_nsec = 45 * ms}, NULL);
    assert_int_equal(trigger_timer.next(st, &b), OK);
    assert_true(b.count == 2 && b.lost >= 2);
    assert_int_equal(b.time_ns - a.time_ns, 10 * ms * (b.lost + 1)); // no drift
    trigger_timer.close(st);
    assert_int_equal(trigger_timer.open(st, "timer:1e6"), OK);
    assert_int_equal(trigger_timer.next(st, &a), ERR_AGAIN);
    trigger_timer.close(st);
    free(st);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_uri),
        cmocka_unit_test(test_lookup),
        cmocka_unit_test(test_request),
        cmocka_unit_test(test_press),
        cmocka_unit_test(test_bounce),
        cmocka_unit_test(test_burst),
        cmocka_unit_test(test_lost_before_release),
        cmocka_unit_test(test_lengths),
        cmocka_unit_test(test_refused_lines),
        cmocka_unit_test(test_chip_removed),
        cmocka_unit_test(test_every_failure),
        cmocka_unit_test(test_keys),
        cmocka_unit_test(test_lengths_of_keys),
        cmocka_unit_test(test_refused_keys),
        cmocka_unit_test(test_timer),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
