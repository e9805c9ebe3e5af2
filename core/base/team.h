/* team.h - the processes (ranks) that work on one job together, on one machine or on several.
 * Every rank runs the whole job on the same photographs and takes the same decisions. Where a step
 * says so, its work is dealt out, each rank computes its own part, and the parts are exchanged:
 * after that all ranks hold the same bytes, those of a single process.
 * Functions are collective: all ranks make the same calls in the same order.
 * A team of NULL is a single process: its calls succeed and move nothing.
 * A rank that fails alone does not answer any more: its program ends the others (ERR_LOST there).
 * thread: the one that runs the job. */
#ifndef BASE_TEAM_H
#define BASE_TEAM_H

#include "core/base/err.h"

#include <stddef.h>
#include <stdint.h>

enum {
    TEAM_MAX = 64,      // ranks
    TEAM_SHARE_MAX = 8, // of the fastest rank
    TEAM_PENDING = 64   // transfers begun and not yet waited for
};

/* What carries the bytes. Errors: ERR_LOST (a rank is gone), ERR_CANCELLED, ERR_LIMIT. */
struct team_ops {
    /* Begin to send bytes [at[rank], at[rank + 1]) of data to all and to receive the others. */
    err_t (*begin)(void *ctx, void *data, const size_t *at);
    /* Until the oldest transfer that was begun is complete. */
    err_t (*wait)(void *ctx);
    /* out: bytes [out_at[i], out_at[i + 1]) go to rank i; in: those of rank i come to
     * [in_at[i], in_at[i + 1]). */
    err_t (*exchange)(void *ctx, const void *out, const size_t *out_at, void *in,
                      const size_t *in_at);
};

struct team {
    int rank, size;      // size 2..TEAM_MAX
    int share[TEAM_MAX]; // speed of each rank, 1..TEAM_SHARE_MAX; the same on all ranks. Refinement
                         // that goes on from a state takes those of the state
    const struct team_ops *ops;
    void *ctx;
    uint64_t sent, received; // bytes, of this rank
    double waited_s;         // for the others, by the transport
};

static inline int team_size(const struct team *t)
{
    return t ? t->size : 1;
}

static inline int team_rank(const struct team *t)
{
    return t ? t->rank : 0;
}

/* First of n items that are dealt to `rank`, in proportion to the shares; those of the last rank
 * end with n = team_first(t, n, team_size(t)). A rank may have none. */
int team_first(const struct team *t, int n, int rank);

/* How many of n items are dealt to this rank. */
static inline int team_own(const struct team *t, int n)
{
    return team_first(t, n, team_rank(t) + 1) - team_first(t, n, team_rank(t));
}

/* data: bytes [at[i], at[i + 1]) are those of rank i; all ranks pass the same `at` of size + 1
 * numbers. At most TEAM_PENDING may be on their way; data and the bytes of other ranks must not be
 * touched until the wait. at is copied. */
MUST_USE err_t team_begin(struct team *t, void *data, const size_t *at);

/* Until the oldest transfer that was begun is complete. */
MUST_USE err_t team_wait(struct team *t);

/* Both: data is complete on all ranks. */
MUST_USE err_t team_spread(struct team *t, void *data, const size_t *at);

/* n items of `item` bytes, dealt by team_first: complete on all ranks. */
MUST_USE err_t team_gather(struct team *t, void *data, size_t item, int n);

/* data: (size) items of `item` bytes, one of each rank: complete on all ranks. */
MUST_USE err_t team_collect(struct team *t, void *data, size_t item);

/* data of rank 0 on all ranks. */
MUST_USE err_t team_copy(struct team *t, void *data, size_t bytes);

/* See team_ops. A rank's own bytes are copied, too. */
MUST_USE err_t team_exchange(struct team *t, const void *out, const size_t *out_at, void *in,
                             const size_t *in_at);

#endif
