#include "firmware/daemon/connections.h"

#include <netinet/in.h>
#include <stddef.h>
#include <string.h>

void connections_init(struct connections *c)
{
    memset(c, 0, sizeof *c);
    for (int i = 0; i < CONNECTIONS_MAX; i++)
        c->v[i].fd = -1;
}

static uint64_t network_of(const struct sockaddr *from)
{
    uint64_t n = 0;
    uint32_t v4 = 0;
    if (from->sa_family == AF_INET6) {
        const struct in6_addr *a = &((const struct sockaddr_in6 *)(const void *)from)->sin6_addr;
        memcpy(&n, a, sizeof n);
        memcpy(&v4, a->s6_addr + 12, sizeof v4);
        return IN6_IS_ADDR_V4MAPPED(a) ? v4 : n;
    }
    if (from->sa_family == AF_INET)
        memcpy(&v4, &((const struct sockaddr_in *)(const void *)from)->sin_addr, sizeof v4);
    return v4;
}

static void end_connection(struct connection *k)
{
    k->ended = true;
    shutdown(k->fd, SHUT_RDWR);
}

static bool awaits_request(const struct connection *k)
{
    return k->fd >= 0 && !k->answered && !k->ended;
}

/* Make room among the connections of one network, or of all (NULL), if there are `most`. */
static bool make_room(struct connections *c, const uint64_t *network, int most)
{
    struct connection *oldest = NULL;
    int n = 0;
    for (int i = 0; i < CONNECTIONS_MAX; i++) {
        struct connection *k = &c->v[i];
        if (k->fd < 0 || k->ended || (network && k->network != *network))
            continue;
        n++;
        if (awaits_request(k) && (!oldest || k->since_ns < oldest->since_ns))
            oldest = k;
    }
    if (n >= most && oldest)
        end_connection(oldest);
    return n < most || oldest;
}

struct connection *connections_add(struct connections *c, int fd, const struct sockaddr *from,
                                   int64_t now_ns)
{
    uint64_t network = network_of(from);
    bool room = make_room(c, &network, CONNECTIONS_EACH) && make_room(c, NULL, CONNECTIONS_MAX / 2);
    for (int i = 0; i < CONNECTIONS_MAX && room; i++)
        if (c->v[i].fd < 0) {
            c->v[i] = (struct connection){.fd = fd, .since_ns = now_ns, .network = network};
            return &c->v[i];
        }
    shutdown(fd, SHUT_RDWR);
    return NULL;
}

void connections_begin(struct connection *k)
{
    if (k)
        k->answered = true;
}

void connections_end(struct connection *k, int64_t now_ns)
{
    if (k) {
        k->answered = false;
        k->since_ns = now_ns;
    }
}

void connections_remove(struct connection *k)
{
    if (k)
        k->fd = -1;
}

int64_t connections_expire(struct connections *c, int64_t now_ns)
{
    const int64_t patience = CONNECTIONS_WAIT_S * INT64_C(1000000000);
    int64_t next = INT64_MAX;
    for (int i = 0; i < CONNECTIONS_MAX; i++) {
        struct connection *k = &c->v[i];
        if (!awaits_request(k))
            continue;
        if (now_ns - k->since_ns >= patience)
            end_connection(k);
        else if (k->since_ns + patience < next)
            next = k->since_ns + patience;
    }
    return next;
}
