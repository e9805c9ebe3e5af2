/* When the frames of a take began, and whether that was together. */
#include "firmware/rig/conductor_inner.h"

#include <stdio.h>
#include <string.h>

double conductor_starts_s(const struct message_order *o)
{
    double sum = 0;
    for (int i = 0; i < o->n_times; i++)
        sum += o->time_s[i];
    return sum;
}

int64_t conductor_starts_skew(const struct conductor_take *t)
{
    int64_t most = 0;
    for (int i = 0; i < BRACKET_EXPOSURES_MAX; i++)
        if (t->has_start[i] && t->last_ns[i] - t->first_ns[i] > most)
            most = t->last_ns[i] - t->first_ns[i];
    return most;
}

/* Which two members are farthest apart. */
static void describe_skew(const struct conductor_take *t, char *out, size_t cap)
{
    for (int i = 0; i < BRACKET_EXPOSURES_MAX; i++)
        if (t->has_start[i] && t->last_ns[i] - t->first_ns[i] == conductor_starts_skew(t)) {
            snprintf(out, cap, "%s began exposure %d %.3g ms after %s",
                     t->order.member[t->last_of[i]], i + 1, (double)conductor_starts_skew(t) * 1e-6,
                     t->order.member[t->first_of[i]]);
            return;
        }
}

bool conductor_starts_add(struct conductor_take *t, int k, const struct message_report *r)
{
    const int64_t from = t->order.start_ns - CONDUCTOR_EARLY_NS;
    const int64_t to =
        t->order.start_ns + (int64_t)(conductor_starts_s(&t->order) * 1e9) + CONDUCTOR_LATE_NS;
    for (int i = 0; i < r->n_starts; i++) {
        const struct message_start *s = &r->start[i];
        const int x = s->index;
        if (s->common_ns < from || s->common_ns > to)
            return false;
        if (!t->has_start[x] || s->common_ns < t->first_ns[x]) {
            t->first_ns[x] = s->common_ns;
            t->first_of[x] = k;
        }
        if (!t->has_start[x] || s->common_ns > t->last_ns[x]) {
            t->last_ns[x] = s->common_ns;
            t->last_of[x] = k;
        }
        t->has_start[x] = true;
        t->within_ns = s->within_ns > t->within_ns ? s->within_ns : t->within_ns;
    }
    return true;
}

void conductor_starts_list(struct conductor *c, const struct conductor_take *t, int k,
                           const struct message_report *r)
{
    struct conductor_starts *l = &c->starts;
    const int most = (int)(sizeof l->v / sizeof l->v[0]);
    for (int i = 0; i < r->n_starts && l->n < most && l->serial == t->order.serial; i++) {
        struct conductor_start *s = &l->v[l->n++];
        memcpy(s->member, t->order.member[k], sizeof s->member);
        s->camera = r->start[i].camera;
        s->index = r->start[i].index;
        s->common_ns = r->start[i].common_ns;
    }
}

bool conductor_starts_apart(const struct conductor *c, const struct conductor_take *t,
                            char why[TAKE_TEXT])
{
    const int64_t limit = c->cfg.set->bracket_skew_ms * INT64_C(1000000);
    char apart[160];
    if (!limit || conductor_starts_skew(t) <= limit)
        return false;
    describe_skew(t, apart, sizeof apart);
    snprintf(why, TAKE_TEXT, "%s, bracket.skew_ms allows %d", apart, c->cfg.set->bracket_skew_ms);
    return true;
}
