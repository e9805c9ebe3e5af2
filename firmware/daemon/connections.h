/* connections.h - who is connected to the status page, so that nobody locks the others out. Each
 * address (IPv6: each network of 64 bits) has a few connections, and all have a bound; who wants
 * one more gets it at the cost of the oldest that waits for a request, and is refused if all are
 * being answered. A request must be complete within CONNECTIONS_WAIT_S.
 * To end a connection its socket is shut down: whoever serves it sees the end and closes it.
 * thread: one. */
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
    uint64_t network; // of the other side
};

struct connections {
    struct connection v[CONNECTIONS_MAX];
};

void connections_init(struct connections *c);

/* NULL: refused, which shuts fd down too. */
struct connection *connections_add(struct connections *c, int fd, const struct sockaddr *from,
                                   int64_t now_ns);

/* A request is complete; it is answered; the connection is closed. k may be NULL. */
void connections_begin(struct connection *k);
void connections_end(struct connection *k, int64_t now_ns);
void connections_remove(struct connection *k);

/* End those that wait for too long. Returns when to look again, INT64_MAX: not at all. */
int64_t connections_expire(struct connections *c, int64_t now_ns);

#endif
