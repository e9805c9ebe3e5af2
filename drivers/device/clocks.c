#include "drivers/device/clocks.h"

#include <sys/timex.h>
#include <time.h>
#include <unistd.h>

static int64_t read_clock(clockid_t id)
{
    struct timespec t;
    clock_gettime(id, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t clocks_now(void)
{
    return read_clock(CLOCK_MONOTONIC);
}

struct clocks clocks_at(int64_t monotonic_ns)
{
    int64_t now = clocks_now();
    int64_t boot = read_clock(CLOCK_BOOTTIME), real = read_clock(CLOCK_REALTIME);
    return (struct clocks){monotonic_ns, boot + monotonic_ns - now, real + monotonic_ns - now};
}

bool clocks_synced(void)
{
    struct timex t = {0};
    int state = adjtimex(&t);
    if (state < 0) // a sandbox may forbid it
        return access("/run/systemd/timesync/synchronized", F_OK) == 0;
    return state != TIME_ERROR && !(t.status & STA_UNSYNC);
}

bool clocks_bound(int64_t *within_ns)
{
    struct timex t = {0};
    const int state = adjtimex(&t);
    *within_ns = (int64_t)t.maxerror * 1000; // us
    return state >= 0 && state != TIME_ERROR && !(t.status & STA_UNSYNC);
}
