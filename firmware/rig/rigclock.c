#include "firmware/rig/rigclock.h"

#include <stddef.h>
#include <stdlib.h>

/* How far the clocks drift apart in a time, rounded up. */
static int64_t drift(int64_t ns)
{
    return (int64_t)((double)llabs(ns) * RIGCLOCK_DRIFT) + 1;
}

void rigclock_exchange(struct rigclock *c, int64_t sent_ns, int64_t got_ns, int64_t replied_ns,
                       int64_t back_ns)
{
    if (back_ns < sent_ns || replied_ns < got_ns)
        return;
    struct rigclock_interval x = {back_ns, replied_ns - back_ns, got_ns - sent_ns};
    x.high_ns += drift(back_ns - sent_ns); // it held when the message was sent
    if (x.high_ns < x.low_ns)
        return;
    c->exchange[c->next] = x;
    c->next = (c->next + 1) % RIGCLOCK_SAMPLES;
    c->n += c->n < RIGCLOCK_SAMPLES;
}

void rigclock_kernel(struct rigclock *c, int64_t at_ns, int64_t offset_ns, int64_t within_ns)
{
    c->has_kernel = true;
    c->kernel = (struct rigclock_interval){at_ns, offset_ns - within_ns, offset_ns + within_ns};
}

/* The interval at now_ns: the clocks may have drifted apart since. */
static struct rigclock_interval widen(const struct rigclock_interval *x, int64_t now_ns)
{
    const int64_t more = drift(now_ns - x->at_ns);
    return (struct rigclock_interval){now_ns, x->low_ns - more, x->high_ns + more};
}

/* Narrow *io by x. false: they exclude each other, *io stays. */
static bool intersect(struct rigclock_interval *io, const struct rigclock_interval *x)
{
    const int64_t low = x->low_ns > io->low_ns ? x->low_ns : io->low_ns;
    const int64_t high = x->high_ns < io->high_ns ? x->high_ns : io->high_ns;
    if (low > high)
        return false;
    io->low_ns = low;
    io->high_ns = high;
    return true;
}

bool rigclock_read(const struct rigclock *c, int64_t now_ns, struct rigclock_state *out)
{
    *out = (struct rigclock_state){0};
    if (!c->n)
        return false;
    // the newest first; one that excludes those after it was before a slew, and so are all older
    struct rigclock_interval known = {0};
    for (int i = 0; i < c->n; i++) {
        int k = (c->next - 1 - i + 2 * RIGCLOCK_SAMPLES) % RIGCLOCK_SAMPLES;
        struct rigclock_interval x = widen(&c->exchange[k], now_ns);
        if (i == 0)
            known = x;
        else if (!intersect(&known, &x))
            break;
    }
    if (c->has_kernel) {
        struct rigclock_interval x = widen(&c->kernel, now_ns);
        const int64_t before = known.high_ns - known.low_ns;
        if (intersect(&known, &x))
            out->by_kernel = known.high_ns - known.low_ns < before;
        else
            out->contradiction_ns =
                x.low_ns > known.high_ns ? x.low_ns - known.high_ns : known.low_ns - x.high_ns;
    }
    out->offset_ns = known.low_ns + (known.high_ns - known.low_ns) / 2;
    out->within_ns = (known.high_ns - known.low_ns) / 2 + 1;
    return true;
}
