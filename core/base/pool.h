/* pool.h - a fixed set of threads that share out numbered chunks of work.
 * Chunks are taken from an atomic counter, so big and little cores balance by themselves. A chunk
 * must write only its own output; then the result does not depend on the number of threads. */
#ifndef BASE_POOL_H
#define BASE_POOL_H

#include "core/base/err.h"

struct pool;

/* One chunk of work. worker is in [0, pool_size): use it to pick scratch memory, never to pick a
 * result. */
typedef err_t pool_fn(void *ctx, int chunk, int worker);

/* Start a pool of `threads` workers (1..64, the calling thread is one of them; 0 = one per online
 * core).
 * own:  pool_close.
 * err:  ERR_ARG, ERR_NOMEM, ERR_LIMIT (the system gives no more threads). */
MUST_USE err_t pool_open(struct pool **out, int threads);

/* Accepts NULL. No pool_for may be running. */
void pool_close(struct pool *p);

int pool_size(const struct pool *p);

/* Run fn for every chunk in [0, n_chunks) and wait. p may be NULL and n_chunks 0. Nested calls run
 * inline, with the worker number of the chunk around them when it is the same pool.
 * After a failure no new chunks start; the error and sentence of the lowest failed chunk are
 * returned.
 * thread: one caller at a time. */
MUST_USE err_t pool_for(struct pool *p, int n_chunks, pool_fn *fn, void *ctx);

#endif
