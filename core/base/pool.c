#include "core/base/pool.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { POOL_MAX = 64 };

struct worker_arg {
    struct pool *p;
    int worker;
};

/* A job is published by raising `epoch` under the lock; workers leave it by lowering `busy` under
 * the lock. Workers poll the epoch for a short while before they sleep: a refinement step is
 * made of many jobs of under a millisecond. */
struct pool {
    int size;
    pthread_t thread[POOL_MAX];
    struct worker_arg arg[POOL_MAX];
    int n_started;
    pthread_mutex_t lock;
    pthread_cond_t wake, idle;
    atomic_uint epoch;
    atomic_int busy;
    atomic_uint next; // unsigned: each worker adds 1 beyond n_chunks, which may be INT_MAX
    bool quit;
    pool_fn *fn;
    void *ctx;
    int n_chunks;
    atomic_int failed; // lowest failed chunk, n_chunks if none
    err_t code;
    char text[512];
};

enum { SPIN_TURNS = 4000 };

/* The pool whose chunk this thread runs now, and its worker number there. */
static _Thread_local const struct pool *inside;
static _Thread_local int inside_worker;

static void pause_cpu(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

static void note_failure(struct pool *p, int chunk, err_t code)
{
    pthread_mutex_lock(&p->lock);
    if (chunk < atomic_load(&p->failed)) {
        atomic_store(&p->failed, chunk);
        p->code = code;
        snprintf(p->text, sizeof p->text, "%s", err_text());
    }
    pthread_mutex_unlock(&p->lock);
}

static void take_chunks(struct pool *p, int worker)
{
    inside = p;
    inside_worker = worker;
    for (;;) {
        unsigned c = atomic_fetch_add(&p->next, 1);
        if (c >= (unsigned)p->n_chunks || c > (unsigned)atomic_load(&p->failed))
            break;
        err_t e = p->fn(p->ctx, (int)c, worker);
        if (e)
            note_failure(p, (int)c, e);
    }
    inside = NULL;
}

static void *worker_main(void *v)
{
    const struct worker_arg *arg = v;
    struct pool *p = arg->p;
    unsigned seen = 0;
    for (;;) {
        for (int i = 0; i < SPIN_TURNS && atomic_load(&p->epoch) == seen; i++)
            pause_cpu();
        pthread_mutex_lock(&p->lock);
        while (atomic_load(&p->epoch) == seen && !p->quit)
            pthread_cond_wait(&p->wake, &p->lock);
        seen = atomic_load(&p->epoch);
        bool quit = p->quit;
        pthread_mutex_unlock(&p->lock);
        if (quit)
            return NULL;
        take_chunks(p, arg->worker);
        pthread_mutex_lock(&p->lock);
        if (atomic_fetch_sub(&p->busy, 1) == 1)
            pthread_cond_signal(&p->idle);
        pthread_mutex_unlock(&p->lock);
    }
}

static err_t start_worker(struct pool *p, int worker)
{
    p->arg[worker] = (struct worker_arg){p, worker};
    if (pthread_create(&p->thread[p->n_started], NULL, worker_main, &p->arg[worker]) != 0)
        return err_fail(ERR_LIMIT, "pool: the system refused thread %d of %d", worker + 1, p->size);
    p->n_started++;
    return OK;
}

err_t pool_open(struct pool **out, int threads)
{
    *out = NULL;
    if (threads == 0) {
        long n = sysconf(_SC_NPROCESSORS_ONLN);
        threads = n < 1 ? 1 : n > POOL_MAX ? POOL_MAX : (int)n;
    }
    if (threads < 1 || threads > POOL_MAX)
        return err_fail(ERR_ARG, "pool: %d threads requested, allowed are 1 to %d", threads,
                        POOL_MAX);
    struct pool *p = calloc(1, sizeof *p);
    if (!p)
        return err_fail(ERR_NOMEM, "pool: no memory");
    p->size = threads;
    pthread_mutex_init(&p->lock, NULL);
    pthread_cond_init(&p->wake, NULL);
    pthread_cond_init(&p->idle, NULL);
    for (int i = 1; i < threads; i++) {
        err_t e = start_worker(p, i);
        if (e) {
            pool_close(p);
            return e;
        }
    }
    *out = p;
    return OK;
}

void pool_close(struct pool *p)
{
    if (!p)
        return;
    pthread_mutex_lock(&p->lock);
    p->quit = true;
    pthread_cond_broadcast(&p->wake);
    pthread_mutex_unlock(&p->lock);
    for (int i = 0; i < p->n_started; i++)
        pthread_join(p->thread[i], NULL);
    pthread_cond_destroy(&p->wake);
    pthread_cond_destroy(&p->idle);
    pthread_mutex_destroy(&p->lock);
    free(p);
}

int pool_size(const struct pool *p)
{
    return p ? p->size : 1;
}

/* A nested call keeps the worker number of the chunk around it: that worker's scratch memory is
 * free to use. */
static err_t run_inline(const struct pool *p, int n_chunks, pool_fn *fn, void *ctx)
{
    int worker = p && p == inside ? inside_worker : 0;
    for (int c = 0; c < n_chunks; c++) {
        err_t e = fn(ctx, c, worker);
        if (e)
            return e;
    }
    return OK;
}

err_t pool_for(struct pool *p, int n_chunks, pool_fn *fn, void *ctx)
{
    if (!p || p->n_started == 0 || n_chunks <= 1 || inside)
        return run_inline(p, n_chunks, fn, ctx);
    pthread_mutex_lock(&p->lock);
    p->fn = fn;
    p->ctx = ctx;
    p->n_chunks = n_chunks;
    p->code = OK;
    atomic_store(&p->failed, n_chunks);
    atomic_store(&p->next, 0);
    atomic_store(&p->busy, p->n_started);
    atomic_fetch_add(&p->epoch, 1);
    pthread_cond_broadcast(&p->wake);
    pthread_mutex_unlock(&p->lock);

    take_chunks(p, 0);

    for (int i = 0; i < SPIN_TURNS && atomic_load(&p->busy) > 0; i++)
        pause_cpu();
    pthread_mutex_lock(&p->lock);
    while (atomic_load(&p->busy) > 0)
        pthread_cond_wait(&p->idle, &p->lock);
    err_t e = p->code;
    pthread_mutex_unlock(&p->lock);
    return e ? err_fail(e, "%s", p->text) : OK;
}
