/* clocks.h - the same moment on the clocks of the system.
 * thread: any. */
#ifndef DEVICE_CLOCKS_H
#define DEVICE_CLOCKS_H

#include <stdbool.h>
#include <stdint.h>

struct clocks { // ns
    int64_t monotonic_ns, boottime_ns, realtime_ns;
};

int64_t clocks_now(void); // CLOCK_MONOTONIC, ns

/* A moment of CLOCK_MONOTONIC on all clocks, as they stand to each other now. */
struct clocks clocks_at(int64_t monotonic_ns);

/* Whether something keeps CLOCK_REALTIME right: the kernel knows, else systemd-timesyncd. */
bool clocks_synced(void);

/* Whether the kernel says by how much CLOCK_REALTIME may be wrong: chrony, ntpd and phc2sys tell it
 * (maxerror of adjtimex).
 * out:  *within_ns. */
bool clocks_bound(int64_t *within_ns);

#endif
