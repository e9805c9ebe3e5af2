#include "core/base/team.h"

#include <string.h>

int team_first(const struct team *t, int n, int rank)
{
    int64_t before = 0, all = 0;
    if (!t)
        return rank > 0 ? n : 0;
    for (int i = 0; i < t->size; i++) {
        all += t->share[i];
        before += i < rank ? t->share[i] : 0;
    }
    return (int)((int64_t)n * before / all);
}

err_t team_begin(struct team *t, void *data, const size_t *at)
{
    if (!t)
        return OK;
    const size_t own = at[t->rank + 1] - at[t->rank], all = at[t->size] - at[0];
    t->sent += (uint64_t)own * (uint64_t)(t->size - 1);
    t->received += all - own;
    return t->ops->begin(t->ctx, data, at);
}

err_t team_wait(struct team *t)
{
    return t ? t->ops->wait(t->ctx) : OK;
}

err_t team_spread(struct team *t, void *data, const size_t *at)
{
    err_t e = team_begin(t, data, at);
    return e ? e : team_wait(t);
}

err_t team_gather(struct team *t, void *data, size_t item, int n)
{
    size_t at[TEAM_MAX + 1];
    if (!t)
        return OK;
    for (int i = 0; i <= t->size; i++)
        at[i] = item * (size_t)team_first(t, n, i);
    return team_spread(t, data, at);
}

err_t team_collect(struct team *t, void *data, size_t item)
{
    size_t at[TEAM_MAX + 1];
    if (!t)
        return OK;
    for (int i = 0; i <= t->size; i++)
        at[i] = item * (size_t)i;
    return team_spread(t, data, at);
}

err_t team_copy(struct team *t, void *data, size_t bytes)
{
    size_t at[TEAM_MAX + 1];
    if (!t)
        return OK;
    for (int i = 0; i <= t->size; i++)
        at[i] = i > 0 ? bytes : 0;
    return team_spread(t, data, at);
}

err_t team_exchange(struct team *t, const void *out, const size_t *out_at, void *in,
                    const size_t *in_at)
{
    if (!t) {
        memcpy((char *)in + in_at[0], (const char *)out + out_at[0], out_at[1] - out_at[0]);
        return OK;
    }
    const size_t own = in_at[t->rank + 1] - in_at[t->rank];
    t->sent += out_at[t->size] - out_at[0] - own;
    t->received += in_at[t->size] - in_at[0] - own;
    return t->ops->exchange(t->ctx, out, out_at, in, in_at);
}
