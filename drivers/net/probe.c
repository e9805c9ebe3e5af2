#include "drivers/net/probe.h"

#include "drivers/device/clocks.h"

#include <errno.h>
#include <netdb.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { SLICE_MS = 100 };

/* Whether somebody listens there: 0, or an errno. */
static int probe_address(const struct addrinfo *a, bool (*is_over)(void *ctx), void *ctx)
{
    int fd = socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd < 0)
        return errno;
    int why = connect(fd, a->ai_addr, a->ai_addrlen) == 0 ? 0 : errno;
    int64_t end = clocks_now() + (int64_t)PROBE_MS * 1000000;
    while (why == EINPROGRESS) {
        struct pollfd p = {.fd = fd, .events = POLLOUT};
        int error = 0;
        socklen_t n = sizeof error;
        if (poll(&p, 1, SLICE_MS) > 0)
            why = getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &n) == 0 ? error : errno;
        else if (clocks_now() >= end || is_over(ctx))
            why = ETIMEDOUT;
    }
    close(fd);
    return why;
}

const char *probe_host(const char *host, int port, bool (*is_over)(void *ctx), void *ctx,
                       char address[PROBE_ADDRESS_CAP])
{
    const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_NUMERICSERV};
    struct addrinfo *list = NULL;
    char service[16];
    address[0] = 0;
    snprintf(service, sizeof service, "%d", port);
    int rc = getaddrinfo(host, service, &hints, &list), why = EHOSTUNREACH;
    if (rc)
        return rc == EAI_SYSTEM ? strerror(errno) : gai_strerror(rc);
    for (const struct addrinfo *a = list; a && why && !is_over(ctx); a = a->ai_next) {
        why = probe_address(a, is_over, ctx);
        if (!why && getnameinfo(a->ai_addr, a->ai_addrlen, address, PROBE_ADDRESS_CAP, NULL, 0,
                                NI_NUMERICHOST) != 0)
            why = EAFNOSUPPORT;
    }
    freeaddrinfo(list);
    return why ? strerror(why) : NULL;
}
