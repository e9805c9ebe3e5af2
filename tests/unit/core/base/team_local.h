/* team_local.h - a team of threads of one process: each rank is a thread with its own struct team.
 * team_local_run starts them, and waits. */
#ifndef BASE_TEAM_LOCAL_H
#define BASE_TEAM_LOCAL_H

#include "core/base/team.h"

#include <pthread.h>
#include <stdbool.h>
#include <string.h>

typedef err_t team_local_fn(void *ctx, struct team *t);

struct team_local_post {
    char *data;
    const char *out;
    size_t at[TEAM_MAX + 1];
};

struct team_local {
    int size, waiting;
    unsigned turn;
    bool broken; // a rank ended with an error
    pthread_mutex_t lock;
    pthread_cond_t wake;
    struct team_local_post post[TEAM_MAX];
    team_local_fn *fn;
    void *ctx;
};

struct team_local_rank {
    struct team team;
    struct team_local *all;
    pthread_t thread;
    err_t result;
    char text[256];
};

/* Until all ranks have come here; ERR_LOST if one never will. */
static inline err_t team_local_meet(struct team_local *l)
{
    pthread_mutex_lock(&l->lock);
    const unsigned turn = l->turn;
    if (++l->waiting == l->size) {
        l->waiting = 0;
        l->turn++;
        pthread_cond_broadcast(&l->wake);
    }
    while (turn == l->turn && !l->broken)
        pthread_cond_wait(&l->wake, &l->lock);
    const bool lost = turn == l->turn;
    pthread_mutex_unlock(&l->lock);
    return lost ? err_fail(ERR_LOST, "a rank is gone") : OK;
}

static inline err_t team_local_begin(void *ctx, void *data, const size_t *at)
{
    struct team_local_rank *me = ctx;
    struct team_local *l = me->all;
    const int rank = me->team.rank;
    l->post[rank] = (struct team_local_post){.data = data};
    err_t e = team_local_meet(l);
    for (int i = 0; i < l->size && !e; i++)
        if (i != rank)
            memcpy((char *)data + at[i], l->post[i].data + at[i], at[i + 1] - at[i]);
    return e ? e : team_local_meet(l);
}

static inline err_t team_local_wait(void *ctx)
{
    (void)ctx; // complete when begun
    return OK;
}

static inline err_t team_local_exchange(void *ctx, const void *out, const size_t *out_at, void *in,
                                        const size_t *in_at)
{
    struct team_local_rank *me = ctx;
    struct team_local *l = me->all;
    const int rank = me->team.rank;
    struct team_local_post *p = &l->post[rank];
    p->out = out;
    memcpy(p->at, out_at, (size_t)(l->size + 1) * sizeof *out_at);
    err_t e = team_local_meet(l);
    for (int i = 0; i < l->size && !e; i++) {
        const struct team_local_post *from = &l->post[i];
        if (from->at[rank + 1] - from->at[rank] != in_at[i + 1] - in_at[i])
            return err_fail(ERR_ARG, "rank %d sends another number of bytes", i);
        memcpy((char *)in + in_at[i], from->out + from->at[rank], in_at[i + 1] - in_at[i]);
    }
    return e ? e : team_local_meet(l);
}

static const struct team_ops team_local_ops = {team_local_begin, team_local_wait,
                                               team_local_exchange};

static inline void *team_local_main(void *arg)
{
    struct team_local_rank *me = arg;
    struct team_local *l = me->all;
    me->result = l->fn(l->ctx, &me->team);
    if (me->result) {
        strncpy(me->text, err_text(), sizeof me->text - 1);
        pthread_mutex_lock(&l->lock);
        l->broken = true;
        pthread_cond_broadcast(&l->wake);
        pthread_mutex_unlock(&l->lock);
    }
    return NULL;
}

/* fn on `size` ranks (1: with no team); share: NULL, or speed of each. results: NULL, or (size).
 * returns: the error of the lowest rank that failed. */
static inline err_t team_local_run(int size, const int *share, team_local_fn *fn, void *ctx,
                                   err_t *results)
{
    static struct team_local_rank rank[TEAM_MAX];
    static struct team_local l;
    err_t e = OK;
    if (size == 1)
        return fn(ctx, NULL);
    l = (struct team_local){.size = size,
                            .lock = PTHREAD_MUTEX_INITIALIZER,
                            .wake = PTHREAD_COND_INITIALIZER,
                            .fn = fn,
                            .ctx = ctx};
    for (int i = 0; i < size; i++) {
        rank[i] = (struct team_local_rank){.all = &l};
        rank[i].team =
            (struct team){.rank = i, .size = size, .ops = &team_local_ops, .ctx = &rank[i]};
        for (int k = 0; k < size; k++)
            rank[i].team.share[k] = share ? share[k] : 1;
        pthread_create(&rank[i].thread, NULL, team_local_main, &rank[i]);
    }
    for (int i = 0; i < size; i++)
        pthread_join(rank[i].thread, NULL);
    for (int i = size - 1; i >= 0; i--) {
        if (rank[i].result)
            e = err_fail(rank[i].result, "%s", rank[i].text);
        if (results)
            results[i] = rank[i].result;
    }
    return e;
}

#endif
