/* For each head all logits of a block of queries, their softmax over all keys, summed into the mean
 * over heads. */
#include "core/net/shared_attention.h"

#include <math.h>
#include <string.h>

#define HEAD_SCALE 0.125f // whatever the width of a head, core/net/README.md 2.7

struct shared_attention shared_attention_shape(const struct net_dims *d, int n_views, int grid)
{
    const int m = grid * grid, keys = n_views * (m + NET_SPECIAL);
    return (struct shared_attention){.heads = d->heads,
                                     .head = d->embed / d->heads,
                                     .m = m,
                                     .keys = keys,
                                     .key_panels = (keys + PANEL - 1) / PANEL};
}

size_t shared_attention_pitch(const struct shared_attention *a)
{
    return (size_t)a->key_panels * PANEL;
}

static size_t panel_floats(const struct shared_attention *a)
{
    return (size_t)a->heads * shared_attention_pitch(a) * (size_t)a->head;
}

err_t shared_attention_layout(struct shared_attention *a, struct arena *arena)
{
    return arena_alloc(arena, panel_floats(a), sizeof(float), &a->panels);
}

/* Keys of one head to panels; keys beyond the last are zero. */
static err_t pack_keys(void *ctx, int head, int worker)
{
    const struct shared_attention *a = ctx;
    const size_t width = (size_t)a->head, pitch = shared_attention_pitch(a);
    const float *k = a->t->k + (size_t)head * (size_t)a->keys * width;
    float *out = a->panels + (size_t)head * pitch * width;
    (void)worker;
    memset(out + (pitch - PANEL) * width, 0, PANEL * width * sizeof *out);
    for (size_t j = 0; j < (size_t)a->keys; j++)
        for (size_t i = 0; i < width; i++)
            out[j / PANEL * PANEL * width + i * PANEL + j % PANEL] = k[j * width + i];
    return OK;
}

err_t shared_attention_init(const struct run *r, const struct tokens *t, struct shared_attention *a)
{
    a->r = r;
    a->t = t;
    return pool_for(r->pool, a->heads, pack_keys, a);
}

err_t shared_attention_workspace_init(const struct shared_attention *a, struct arena *arena,
                                      struct shared_attention_workspace *out)
{
    const size_t n = SHARED_ATTENTION_ROWS * shared_attention_pitch(a);
    err_t e = arena_alloc(arena, n, sizeof(float), &out->logits);
    return e ? e : arena_alloc(arena, n, sizeof(float), &out->sum);
}

/* Softmax of one head for `rows` queries from token row `at` on, added to room->sum. */
static void add_head(const struct shared_attention *a, int head, size_t at, int rows,
                     const struct shared_attention_workspace *room)
{
    const struct gemm_kernels *k = &a->r->k->net;
    const size_t queries = (size_t)a->t->n_own * (size_t)a->t->n_tokens;
    float scale[SHARED_ATTENTION_ROWS], top[SHARED_ATTENTION_ROWS], sum[SHARED_ATTENTION_ROWS],
        rescale[SHARED_ATTENTION_ROWS], weigh[SHARED_ATTENTION_ROWS];
    const size_t width = (size_t)a->head, pitch = shared_attention_pitch(a);
    for (int i = 0; i < rows; i++) {
        scale[i] = HEAD_SCALE;
        top[i] = -INFINITY;
        sum[i] = 0;
    }
    const struct gemm_f32 g = {.m = rows,
                               .panels = a->key_panels,
                               .segs = 1,
                               .seg = a->head,
                               .a = a->t->q + ((size_t)head * queries + at) * width,
                               .lda = width,
                               .w = a->panels + (size_t)head * pitch * width,
                               .ldw = PANEL * width,
                               .c = room->logits,
                               .ldc = pitch};
    const struct attend_block b = {.m = rows,
                                   .n = a->keys,
                                   .sf = room->logits,
                                   .lds = pitch,
                                   .row_scale = scale,
                                   .top = top,
                                   .sum = sum,
                                   .pf = room->logits,
                                   .ldp = pitch,
                                   .rescale = rescale,
                                   .weigh = weigh};
    k->f32(&g);
    k->attend_block(&b);
    for (int i = 0; i < rows; i++) {
        rescale[i] = 1;
        weigh[i] = 1 / ((float)a->heads * sum[i]);
    }
    k->attend_add(&(struct attend_add){.m = rows,
                                       .n = a->keys,
                                       .cf = room->logits,
                                       .ldc = pitch,
                                       .rescale = rescale,
                                       .weigh = weigh,
                                       .o = room->sum,
                                       .ldo = pitch});
}

err_t shared_attention_rows(const struct shared_attention *a, int view, int first, int rows,
                            const struct shared_attention_workspace *room)
{
    const size_t at = (size_t)view * (size_t)(a->m + NET_SPECIAL) + NET_SPECIAL + (size_t)first;
    memset(room->sum, 0, (size_t)rows * shared_attention_pitch(a) * sizeof(float));
    for (int head = 0; head < a->heads; head++) {
        err_t e = run_check(a->r, "network");
        if (e)
            return e;
        add_head(a, head, at, rows, room);
    }
    return OK;
}

/* ---- best tokens ---- */

struct search {
    struct shared_attention a;
    struct shared_attention_workspace *rooms;
    struct correspondence *out;
};

static int blocks_of_view(const struct shared_attention *a)
{
    return (a->m + SHARED_ATTENTION_ROWS - 1) / SHARED_ATTENTION_ROWS;
}

/* The largest of n weights, in order, and their share of the sum; the first of equal ones. */
static void pick_best(const float *weight, int n, int16_t *token, float *share)
{
    double all = 0;
    int found = 0;
    for (int i = 0; i < n; i++) {
        int at = found;
        all += (double)weight[i];
        while (at > 0 && weight[i] > weight[token[at - 1]])
            at--;
        if (at == CORRESPONDENCE_BEST)
            continue;
        found += found < CORRESPONDENCE_BEST;
        for (int k = found - 1; k > at; k--)
            token[k] = token[k - 1];
        token[at] = (int16_t)i;
    }
    for (int k = 0; k < CORRESPONDENCE_BEST; k++) {
        share[k] = k < found && all > 0 ? (float)((double)weight[token[k]] / all) : 0;
        if (k >= found)
            token[k] = -1;
    }
}

static err_t search_block(void *ctx, int chunk, int worker)
{
    const struct search *s = ctx;
    const struct shared_attention *a = &s->a;
    const struct shared_attention_workspace *room = s->rooms + worker;
    const int view = chunk / blocks_of_view(a),
              first = chunk % blocks_of_view(a) * SHARED_ATTENTION_ROWS;
    const int rows = a->m - first < SHARED_ATTENTION_ROWS ? a->m - first : SHARED_ATTENTION_ROWS;
    const int n_views = s->out->n_views, m = a->m, first_query = (a->t->first + view) * m + first;
    err_t e = shared_attention_rows(a, view, first, rows, room);
    for (int i = 0; i < rows && !e; i++)
        for (int v = 0; v < n_views; v++) {
            const size_t query = (size_t)(first_query + i);
            const size_t at = (query * (size_t)n_views + (size_t)v) * CORRESPONDENCE_BEST;
            const float *weight = room->sum + (size_t)i * shared_attention_pitch(a) +
                                  (size_t)v * (size_t)(m + NET_SPECIAL) + NET_SPECIAL;
            pick_best(weight, m, s->out->token + at, s->out->share + at);
        }
    return e;
}

/* Of one view. */
static size_t count_entries(int n_views, int m)
{
    return (size_t)n_views * (size_t)m * CORRESPONDENCE_BEST;
}

static err_t layout_result(struct correspondence *out, struct arena *keep, int m)
{
    const size_t n = (size_t)out->n_views * count_entries(out->n_views, m);
    err_t e = arena_alloc(keep, n, sizeof *out->token, &out->token);
    return e ? e : arena_alloc(keep, n, sizeof *out->share, &out->share);
}

static err_t gather_result(struct team *t, const struct correspondence *out, int m)
{
    const size_t n = count_entries(out->n_views, m);
    err_t e = team_gather(t, out->token, n * sizeof *out->token, out->n_views);
    return e ? e : team_gather(t, out->share, n * sizeof *out->share, out->n_views);
}

static err_t layout(struct search *s, struct arena *tmp, int threads)
{
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *s->rooms, &s->rooms);
    for (int i = 0; i < threads && !e; i++) {
        struct shared_attention_workspace room;
        e = shared_attention_workspace_init(&s->a, tmp, &room);
        if (!e && !tmp->counts)
            s->rooms[i] = room;
    }
    return e ? e : shared_attention_layout(&s->a, tmp);
}

void shared_attention_plan(struct plan *p, const struct net_dims *d, int n_views, int size)
{
    struct correspondence out = {.n_views = n_views};
    struct search s = {.a = shared_attention_shape(d, n_views, size / NET_PATCH)};
    const size_t mark = arena_mark(&p->tmp);
    if (layout_result(&out, &p->keep, s.a.m) || layout(&s, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

err_t shared_attention_run(const struct run *r, const struct net_dims *d, const struct tokens *t,
                           struct correspondence *out)
{
    const size_t keep = arena_mark(r->keep), tmp = arena_mark(r->tmp);
    struct search s = {.a = shared_attention_shape(d, t->n_views, t->grid), .out = out};
    *out = (struct correspondence){.n_views = t->n_views, .grid = t->grid};
    err_t e = layout_result(out, r->keep, s.a.m);
    if (!e)
        e = layout(&s, r->tmp, pool_size(r->pool));
    if (!e)
        e = shared_attention_init(r, t, &s.a);
    if (!e)
        e = pool_for(r->pool, t->n_own * blocks_of_view(&s.a), search_block, &s);
    if (!e)
        e = gather_result(r->team, out, s.a.m);
    arena_reset(r->tmp, tmp);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    }
    return e;
}
