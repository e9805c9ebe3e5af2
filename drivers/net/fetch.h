/* fetch.h - files of other boards by HTTP, through libcurl: several at a time, each continued where
 * an earlier attempt ended, each proved by its hash. No redirects and no proxies: the other board
 * is in the same network. A hostile server can write no more than the bytes that were announced,
 * into the files that were named.
 * A file is whole, proved and on the medium when fetch_files returns OK; after an error some are
 * not, and the next call continues them.
 * SIGPIPE must be ignored. thread: any, one at a time for one fetcher; fetch_files blocks. */
#ifndef NET_FETCH_H
#define NET_FETCH_H

#include "core/base/err.h"

#include <stdatomic.h>
#include <stdint.h>

enum { FETCH_PARALLEL_MAX = 16, FETCH_CONNECT_MS = 3000, FETCH_STALL_S = 10 };

struct fetch_item {
    const char *url;    // http or https
    const char *path;   // its folder exists; no link
    uint64_t bytes;     // of the whole file
    const char *sha256; // 64 hexadecimal digits
};

struct fetch_config {
    const char *token; // sent as "Authorization: Bearer TOKEN"; NULL: none
    int parallel;      // transfers at a time, 1 to FETCH_PARALLEL_MAX
    int stall_s;       // so long less than 1000 bytes/s (mean of 5 s) are a stall; 0: FETCH_STALL_S
    const atomic_bool *cancel; // looked at ten times a second; NULL: never
    void (*progress)(void *ctx, uint64_t done, uint64_t all); // bytes, if they changed; may be NULL
    void *ctx;
};

/* Keeps connections from one call to the next, until the other side ends them: a new one costs a
 * round trip, and a second where its first packet is lost (RFC 6298). */
struct fetcher;

/* own: fetch_close. err: ERR_NOMEM */
MUST_USE err_t fetch_open(struct fetcher **out);

/* Accepts NULL. */
void fetch_close(struct fetcher *f);

/* A file that is there is kept if its hash is right; a shorter one is continued; anything else, and
 * one whose hash is wrong after that, is fetched from the start.
 * err:  ERR_ARG (an item, parallel, or the token is refused), ERR_LOST (no connection, or it broke
 *       off), ERR_TIMEOUT (connecting, stall), ERR_BUSY (the server says so), ERR_FORMAT (other
 *       bytes than announced), ERR_LIMIT (no space), ERR_IO (no such file there, other refusals,
 *       disk), ERR_NOMEM, ERR_CANCELLED. The first error ends all transfers. */
MUST_USE err_t fetch_files(struct fetcher *f, const struct fetch_config *cfg,
                           const struct fetch_item *items, int n);

#endif
