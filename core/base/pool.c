#include "core/base/pool.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { POOL_MAX = 64 };

/* A job is published by raising `epoch` under the lock; workers leave it by lowering `busy` under the lock. Workers
 * look at the epoch for a short while before they sleep: a refinement step is made of many jobs of under a millisecond. */
struct pool {
    int size;
    pthread_t thread[POOL_MAX];
    int n_started;
    pthread_mutex_t lock;
    pthread_cond_t wake, idle;
    atomic_uint epoch;
    atomic_int busy, next;
    bool quit;
    pool_fn *fn;
    void *ctx;
    int n_chunks;
    atomic_int failed; // lowest failed chunk, n_chunks if none
    err_t code;
    char text[512];
};

struct worker_arg {
    struct pool *p;
    int worker;
};

enum { SPIN_TURNS = 4000 };

static _Thread_local bool pool_inside;

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
    pool_inside = true;
    for (;;) {
        int c = atomic_fetch_add(&p->next, 1);
        if (c >= p->n_chunks || c > atomic_load(&p->failed))
            break;
        err_t e = p->fn(p->ctx, c, worker);
        if (e)
            note_failure(p, c, e);
    }
    pool_inside = false;
}

static void *worker_main(void *v)
{
    struct worker_arg arg = *(struct worker_arg *)v;
    free(v);
    struct pool *p = arg.p;
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
        take_chunks(p, arg.worker);
        pthread_mutex_lock(&p->lock);
        if (atomic_fetch_sub(&p->busy, 1) == 1)
            pthread_cond_signal(&p->idle);
        pthread_mutex_unlock(&p->lock);
    }
}

static err_t start_worker(struct pool *p, int worker)
{
    struct worker_arg *arg = malloc(sizeof *arg);
    if (!arg)
        return err_fail(ERR_NOMEM, "pool: no memory for thread %d", worker);
    *arg = (struct worker_arg){p, worker};
    if (pthread_create(&p->thread[p->n_started], NULL, worker_main, arg) != 0) {
        free(arg);
        return err_fail(ERR_LIMIT, "pool: the system gives no thread %d of %d", worker + 1, p->size);
    }
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
        return err_fail(ERR_ARG, "pool: %d threads asked, allowed are 1 to %d", threads, POOL_MAX);
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

static err_t run_inline(int n_chunks, pool_fn *fn, void *ctx)
{
    for (int c = 0; c < n_chunks; c++) {
        err_t e = fn(ctx, c, 0);
        if (e)
            return e;
    }
    return OK;
}

err_t pool_for(struct pool *p, int n_chunks, pool_fn *fn, void *ctx)
{
    if (!p || p->n_started == 0 || n_chunks <= 1 || pool_inside)
        return run_inline(n_chunks, fn, ctx);
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
