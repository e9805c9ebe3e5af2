/* rigclock.h - what a member knows of the rig's common clock: the conductor's time, which begins
 * at its CLOCK_REALTIME and then follows its CLOCK_MONOTONIC, so that it never steps. Bounds
 * instead of estimates: each exchange proves an interval for the offset to the member's
 * CLOCK_MONOTONIC, and intervals intersect. The wall clocks of boards may be wrong by years; where
 * the kernels of both say how well they are kept, that is one more interval, unless exchanges
 * contradict it.
 * Pure; one thread. */
#ifndef RIG_RIGCLOCK_H
#define RIG_RIGCLOCK_H

#include <stdbool.h>
#include <stdint.h>

enum { RIGCLOCK_SAMPLES = 16 };

/* Rates of two boards differ by no more: crystals of 50 ppm each, (1 + 50e-6) / (1 - 50e-6). */
#define RIGCLOCK_DRIFT 100.01e-6

struct rigclock_interval { // bounds of common - monotonic at some time, ns
    int64_t at_ns, low_ns, high_ns;
};

struct rigclock { // zeroed: nothing is known
    int n, next;
    struct rigclock_interval exchange[RIGCLOCK_SAMPLES];
    bool has_kernel;
    struct rigclock_interval kernel;
};

struct rigclock_state {
    int64_t offset_ns;        // common = CLOCK_MONOTONIC + offset,
    int64_t within_ns;        // within this
    bool by_kernel;           // the kernels' discipline makes it narrower than exchanges alone
    int64_t contradiction_ns; // by how much exchanges contradict the kernels; 0: they agree
};

/* An exchange: sent and back on the member's CLOCK_MONOTONIC, got and replied on the common clock.
 * low = replied - back, high = got - sent and what the clocks drift until back: a message cannot
 * arrive before it is sent (as NTP, RFC 5905 section 8, without assuming that both ways take
 * equally long). Impossible stamps (back < sent, replied < got, high < low) are left out. */
void rigclock_exchange(struct rigclock *c, int64_t sent_ns, int64_t got_ns, int64_t replied_ns,
                       int64_t back_ns);

/* Both kernels keep CLOCK_REALTIME within bounds (adjtimex): then common - monotonic was offset_ns
 * at at_ns within within_ns. */
void rigclock_kernel(struct rigclock *c, int64_t at_ns, int64_t offset_ns, int64_t within_ns);

/* What is known at now_ns of CLOCK_MONOTONIC. false: nothing. */
bool rigclock_read(const struct rigclock *c, int64_t now_ns, struct rigclock_state *out);

#endif
