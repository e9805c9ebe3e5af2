/* net_world.h - a small network with all that a run of it needs: kernels, arenas, pool. */
#ifndef NET_NET_WORLD_H
#define NET_NET_WORLD_H

#include "core/base/cpu.h"
#include "core/base/plan.h"
#include "core/net/net.h"
#include "tests/unit/small_model.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

struct net_world {
    struct small_model model;
    struct net net;
    struct kernels kernels;
    struct arena keep, tmp;
    size_t keep_plan, tmp_plan;
    struct pool *pool;
    atomic_bool cancel;
    struct run r;
};

static inline void net_world_bind(struct net_world *w, const struct net_dims *d,
                                  enum precision precision, unsigned floats)
{
    memset(w, 0, sizeof *w);
    small_model_init(&w->model, d, precision);
    assert_int_equal(net_bind(&w->model.model, floats, &w->net), OK);
    kernels_init(&w->kernels, cpu_detect());
}

/* Memory and threads as planned; rgb: n bytes of noise. */
static inline void net_world_reserve(struct net_world *w, const struct plan *plan, uint8_t *rgb,
                                     size_t n)
{
    w->keep_plan = plan->keep.peak;
    w->tmp_plan = plan->tmp.peak;
    assert_int_equal(arena_init(&w->keep, "keep", w->keep_plan), OK);
    assert_int_equal(arena_init(&w->tmp, "tmp", w->tmp_plan), OK);
    assert_int_equal(pool_open(&w->pool, plan->threads), OK);
    w->r = (struct run){
        .k = &w->kernels, .pool = w->pool, .keep = &w->keep, .tmp = &w->tmp, .cancel = &w->cancel};
    for (size_t i = 0; i < n; i++)
        rgb[i] = (uint8_t)(i * 2654435761u >> 24);
}

static inline void net_world_close(struct net_world *w)
{
    pool_close(w->pool);
    arena_free(&w->keep);
    arena_free(&w->tmp);
    small_model_free(&w->model);
}

/* FNV-1a of the bytes, from h on. */
static inline uint64_t net_world_hash(const void *p, size_t bytes, uint64_t h)
{
    const unsigned char *b = p;
    for (size_t i = 0; i < bytes; i++)
        h = (h ^ b[i]) * 0x100000001B3u;
    return h;
}

#endif
