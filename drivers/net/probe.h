/* probe.h - which address of a host answers. Libraries try them one after the other and wait for
 * minutes for one that is silent, without an end from outside.
 * thread: any; a resolver may take its time. */
#ifndef NET_PROBE_H
#define NET_PROBE_H

#include <stdbool.h>

enum { PROBE_ADDRESS_CAP = 1025, PROBE_MS = 3000 };

/* Connect to the addresses of `host` in turn, for PROBE_MS at most, until one accepts; that
 * connection is closed again. `is_over` is asked ten times a second and ends it.
 * out:  address, numeric. returns: NULL, or why there is none, until the thread's next call of
 *       strerror. */
const char *probe_host(const char *host, int port, bool (*is_over)(void *ctx), void *ctx,
                       char address[PROBE_ADDRESS_CAP]);

#endif
