/* connections.h - connections of the status page, bounded so that one client cannot lock the others
 * out. Each address (IPv6: each network of 64 bits) has a few, and there is a bound for all. One
 * more takes the place of the oldest that waits for a request, and is refused if all are being
 * answered. A request must be complete within CONNECTIONS_WAIT_S. To end a connection its socket is
 * shut down: the code that serves it sees the end and closes it. thread: one. */
#ifndef DAEMON_CONNECTIONS_H
#define DAEMON_CONNECTIONS_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/socket.h>

/* A browser opens six at a time, and a telephone beside it as many. */
enum { CONNECTIONS_MAX = 64, CONNECTIONS_EACH = 16, CONNECTIONS_WAIT_S = 10 };

struct connection {
    int fd;        // not owned; -1: free
    bool answered; // a request of it is complete and not yet answered
    bool ended;
    int64_t since_ns; // CLOCK_MONOTONIC: it waits for a request
    uint64_t network; // network of the other side
};

struct connections {
    struct connection v[CONNECTIONS_MAX];
};

void connections_init(struct connections *c);

/* NULL: refused; fd is shut down then. */
struct connection *connections_add(struct connections *c, int fd, const struct sockaddr *from,
                                   int64_t now_ns);

/* Note that a request is complete, that it is answered, that the connection is closed. k may be
 * NULL. */
void connections_begin(struct connection *k);
void connections_end(struct connection *k, int64_t now_ns);
void connections_remove(struct connection *k);

/* End connections that wait for too long. Returns the time of the next call; INT64_MAX: none. */
int64_t connections_expire(struct connections *c, int64_t now_ns);

#endif
