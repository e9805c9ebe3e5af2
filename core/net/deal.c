#include "core/net/deal.h"

#include "core/base/num.h"
#include "core/net/attention.h"

struct deal deal_of(const struct team *t, int n_views, int view_tokens)
{
    struct deal d = {.size = team_size(t), .rank = team_rank(t)};
    for (int i = 0; i <= d.size; i++) {
        d.token[i] = team_first(t, n_views, i) * view_tokens;
        d.block[i] = (d.token[i] + ATTENTION_KEYS - 1) / ATTENTION_KEYS;
    }
    return d;
}

int deal_own(const struct deal *d)
{
    return d->token[d->rank + 1] - d->token[d->rank];
}

/* Tokens of rank `from` in a block of rank `to`: its first ones, and of no other rank than `to`. */
static int count_lent(const struct deal *d, int from, int to)
{
    const bool any = from > to && d->block[to + 1] > d->block[to];
    const int end = any ? ATTENTION_KEYS * d->block[to + 1] : 0;
    return num_max(0, num_min(d->token[from + 1], end) - d->token[from]);
}

int deal_borrowed(const struct deal *d)
{
    int n = 0;
    for (int i = d->rank + 1; i < d->size; i++)
        n += count_lent(d, i, d->rank);
    return n;
}

err_t deal_borrow(const struct deal *d, struct team *t, void *x, size_t row)
{
    size_t out_at[TEAM_MAX + 1] = {0}, in_at[TEAM_MAX + 1] = {0};
    for (int i = 0; i < d->size; i++) {
        out_at[i + 1] = out_at[i] + row * (size_t)count_lent(d, d->rank, i);
        in_at[i + 1] = in_at[i] + row * (size_t)count_lent(d, i, d->rank);
    }
    return team_exchange(t, x, out_at, (char *)x + row * (size_t)deal_own(d), in_at);
}
