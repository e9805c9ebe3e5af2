/* Events carry the planned times, start + k * period, no matter when they are read. */
#include "drivers/device/clocks.h"
#include "drivers/device/trigger.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

static const char scheme[] = "timer:";

struct state {
    int fd;
    int64_t next_ns, period_ns;
    uint32_t count;
};

static err_t parse_uri(const char *uri, int64_t *period_ns)
{
    size_t skip = sizeof scheme - 1;
    const char *text = uri + skip;
    char *end = NULL;
    double s = strncmp(uri, scheme, skip) == 0 ? strtod(text, &end) : NAN;
    if (!(s >= 0.01 && s <= 1e6) || end == text || *end != '\0')
        return err_fail(ERR_ARG, "%.64s: not \"timer:\" and a number of seconds in 0.01..1e6", uri);
    *period_ns = llrint(s * 1e9);
    return OK;
}

static struct timespec timespec_of(int64_t ns)
{
    return (struct timespec){(time_t)(ns / 1000000000), (long)(ns % 1000000000)};
}

static err_t timer_open(void *st, const char *uri)
{
    struct state *s = st;
    memset(s, 0, sizeof *s);
    err_t e = parse_uri(uri, &s->period_ns);
    if (e)
        return e;
    s->fd = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    if (s->fd < 0)
        return err_fail(ERR_IO, "%s: no timer: %s", uri, strerror(errno));
    s->next_ns = clocks_now() + s->period_ns;
    struct itimerspec t = {timespec_of(s->period_ns), timespec_of(s->next_ns)};
    if (timerfd_settime(s->fd, TFD_TIMER_ABSTIME, &t, NULL) == 0)
        return OK;
    e = err_fail(ERR_IO, "%s: the timer is refused: %s", uri, strerror(errno));
    close(s->fd);
    return e;
}

static void timer_close(void *st)
{
    close(((struct state *)st)->fd);
}

static int timer_fd(const void *st)
{
    return ((const struct state *)st)->fd;
}

static err_t timer_next(void *st, struct trigger_event *out)
{
    struct state *s = st;
    uint64_t n = 0; // expiries since the last read
    if (read(s->fd, &n, sizeof n) != sizeof n || n == 0)
        return errno == EAGAIN || errno == EINTR ? ERR_AGAIN
                                                 : err_fail(ERR_IO, "timer: %s", strerror(errno));
    int64_t at = s->next_ns + (int64_t)(n - 1) * s->period_ns;
    *out = (struct trigger_event){at, ++s->count, (uint32_t)(n - 1), 0};
    s->next_ns = at + s->period_ns;
    return OK;
}

const struct trigger_ops trigger_timer = {.name = "timer",
                                          .state_bytes = sizeof(struct state),
                                          .open = timer_open,
                                          .close = timer_close,
                                          .fd = timer_fd,
                                          .next = timer_next};
