/* Two passes over the pool. The first computes queries, keys and values of ATTENTION_KEYS tokens
 * of a sequence at a time and stores them. The second runs attention and the rest of the block on
 * BLOCK_ROWS tokens at a time, of any sequences, so that everything between the two norms stays in
 * the worker's scratch.
 * In a team, keys and values of a global block travel head by head between the two passes: what
 * has arrived is attended to while the next heads are on their way. */
#include "core/net/block.h"

#include "core/base/num.h"
#include "core/net/attention.h"
#include "core/net/deal.h"
#include "core/net/layer.h"

#include <string.h>

enum {
    BLOCK_ROWS = ATTENTION_ROWS,
    MLP = 4,
    AHEAD = 4 // heads on their way while one is attended to
};

/* Scratch of one worker. */
struct worker {
    struct layer_workspace layer;
    struct attention_workspace attention;
    float *rows; // (ATTENTION_KEYS, C) normalised rows, then results of attention
    float *wide; // (ATTENTION_KEYS, 3 C) q, k, v, or (BLOCK_ROWS, 4 C) of the MLP
};

struct pass {
    const struct run *r;
    const struct block *b;
    struct deal deal;
    int first, n; // tokens of this rank: where they begin in the sequence, and T
    struct attention a;
    struct worker *worker; // (threads)
    bool gathers;          // keys and values come from other ranks, too
    int head;              // that is attended to
    float *attended;       // (T, C) results of attention where gathers, else NULL
};

static size_t wide_floats(const struct block *b)
{
    size_t attention = (size_t)ATTENTION_KEYS * 3, mlp = (size_t)BLOCK_ROWS * MLP;
    return (attention > mlp ? attention : mlp) * (size_t)b->width;
}

static struct pass pass_of(const struct block *b, const struct team *t)
{
    struct pass p = {.b = b, .deal = deal_of(t, b->n_views, b->view_tokens)};
    p.n = deal_own(&p.deal);
    p.first = b->global ? p.deal.token[p.deal.rank] : 0;
    p.gathers = b->global && t;
    p.a = (struct attention){.seqs = b->global ? 1 : p.n / b->view_tokens,
                             .len = b->global ? b->n_views * b->view_tokens : b->view_tokens,
                             .q_first = p.first,
                             .q_len = b->global ? p.n : b->view_tokens,
                             .heads = b->heads,
                             .width = b->width / b->heads,
                             .floats = b->floats & NET_FLOAT_ATTENTION};
    return p;
}

size_t block_rows(const struct team *t, int n_views, int view_tokens)
{
    const struct deal d = deal_of(t, n_views, view_tokens);
    return (size_t)(deal_own(&d) + deal_borrowed(&d));
}

static err_t worker_init(struct worker *w, const struct block *b, struct arena *a)
{
    err_t e = layer_workspace_init(&w->layer, a, MLP * b->width);
    if (!e)
        e = attention_workspace_init(&w->attention, b->width / b->heads, a);
    if (!e)
        e = arena_alloc(a, (size_t)ATTENTION_KEYS * (size_t)b->width, sizeof(float), &w->rows);
    if (!e)
        e = arena_alloc(a, wide_floats(b), sizeof(float), &w->wide);
    return e;
}

static err_t layout(struct pass *p, struct arena *tmp, int threads)
{
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *p->worker, &p->worker);
    for (int i = 0; !e && i < threads; i++) {
        struct worker w;
        e = worker_init(&w, p->b, tmp);
        if (!e && !tmp->counts)
            p->worker[i] = w;
    }
    if (!e)
        e = attention_init(&p->a, tmp);
    if (!e && p->gathers)
        e = arena_alloc(tmp, (size_t)p->n * (size_t)p->b->width, sizeof(float), &p->attended);
    return e;
}

void block_plan(struct plan *p, const struct block *b)
{
    struct pass pass = pass_of(b, p->team);
    const size_t mark = arena_mark(&p->tmp);
    if (layout(&pass, &p->tmp, p->threads))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static void normalise_rows(const struct pass *p, const float *gamma, const float *beta, int first,
                           int n, float *out)
{
    const struct norm s = {p->b->width, p->b->eps, gamma, beta};
    size_t c = (size_t)p->b->width;
    for (int i = 0; i < n; i++)
        p->r->k->net.norm(&s, p->b->x + (size_t)(first + i) * c, out + (size_t)i * c);
}

/* Number of tokens from `token` on, at most `left`, that are all special or all not special. */
static int kind_run(const struct block *b, int token, int left, bool *special)
{
    int at = token % b->view_tokens;
    *special = at < NET_SPECIAL;
    return num_min(left, (*special ? NET_SPECIAL : b->view_tokens) - at);
}

/* A product for the m tokens of `in` from `first` on; the special ones may stay in floats. */
static void multiply_rows(const struct pass *p, const struct weight *w, int first,
                          struct layer_in in, struct layer_out out, struct layer_workspace *room)
{
    const struct gemm_kernels *k = &p->r->k->net;
    int end = first + in.m;
    in.ldx = (size_t)weight_k(w);
    in.floats = p->b->floats & NET_FLOAT_BLOCKS;
    if (in.floats || !(p->b->floats & NET_FLOAT_SPECIAL)) {
        layer_rows(k, w, &in, &out, room);
        return;
    }
    for (int token = first; token < end; token += in.m) {
        in.m = kind_run(p->b, token, end - token, &in.floats);
        layer_rows(k, w, &in, &out, room);
        in.x += (size_t)in.m * in.ldx;
        out.out += (size_t)in.m * out.ldo;
    }
}

/* ---- first pass ---- */

/* Norms, capture and rotation of the queries and keys of n tokens from `first` on; what another
 * rank lends is not captured. */
static void rotate_heads(const struct pass *p, int first, int n, float *qkv)
{
    const struct block *b = p->b;
    size_t c = (size_t)b->width, w = c / (size_t)b->heads;
    size_t own = (size_t)p->n, all = (size_t)b->n_views * (size_t)b->view_tokens;
    struct head_rotary q = {.n = (int)w, .gamma = b->w->q_g, .beta = b->w->q_b}, k = q;
    k.gamma = b->w->k_g;
    k.beta = b->w->k_b;
    for (int i = 0; i < n; i++) {
        size_t token = (size_t)(first + i), angle = token % (size_t)b->view_tokens * (w / 2);
        q.cosine = k.cosine = b->cosine ? b->cosine + angle : NULL;
        q.sine = k.sine = b->cosine ? b->sine + angle : NULL;
        for (size_t h = 0; h < (size_t)b->heads; h++) {
            float *at = qkv + (size_t)i * 3 * c + h * w;
            q.before = b->q && token < own ? b->q + (h * own + token) * w : NULL;
            k.before = b->k && token < own ? b->k + (h * all + (size_t)p->first + token) * w : NULL;
            p->r->k->net.head_rotary(&q, at);
            p->r->k->net.head_rotary(&k, at + c);
        }
    }
}

/* Tokens of this rank that begin in the block of keys of another one: only their queries are
 * stored here. */
static err_t store_chunk(void *ctx, int chunk, int worker)
{
    const struct pass *p = ctx;
    const struct block *b = p->b;
    struct worker *w = p->worker + worker;
    const int block = p->first / ATTENTION_KEYS + chunk, per_seq = attention_blocks(&p->a);
    struct attention_span keys = {.seq = block / per_seq,
                                  .first = block % per_seq * ATTENTION_KEYS};
    keys.n = num_min(ATTENTION_KEYS, p->a.len - keys.first);
    const int end = p->a.q_first + p->a.q_len;
    const bool own = keys.first >= p->a.q_first;
    struct attention_span queries = {.seq = keys.seq, .first = num_max(keys.first, p->a.q_first)};
    queries.n = num_min(keys.first + keys.n, end) - queries.first;
    const int row = queries.seq * p->a.len + queries.first - p->first, n = own ? keys.n : queries.n;
    err_t e = run_check(p->r, "backbone");
    if (e)
        return e;
    normalise_rows(p, b->w->norm1_g, b->w->norm1_b, row, n, w->rows);
    multiply_rows(p, &b->w->qkv, row, (struct layer_in){.x = w->rows, .m = n},
                  (struct layer_out){.out = w->wide, .ldo = 3 * (size_t)b->width}, &w->layer);
    if (b->w->q_g || b->cosine || b->q)
        rotate_heads(p, row, n, w->wide);
    attention_store_queries(&p->a, &queries, w->wide);
    if (own)
        attention_store_block(&p->a, &keys, w->wide, &w->attention);
    return OK;
}

static err_t store_all(struct pass *p)
{
    const int end = p->first + p->n;
    int chunks = p->a.seqs * attention_blocks(&p->a);
    if (p->b->global)
        chunks = p->n ? (end + ATTENTION_KEYS - 1) / ATTENTION_KEYS - p->first / ATTENTION_KEYS : 0;
    return pool_for(p->r->pool, chunks, store_chunk, p);
}

/* ---- second pass ---- */

static int rows_of(const struct pass *p, int chunk)
{
    return num_min(BLOCK_ROWS, p->n - chunk * BLOCK_ROWS);
}

/* Attention of the tokens of a chunk, each over its own sequence, one head. out: (n, C). */
static err_t attend_head(const struct pass *p, int chunk, int head, float *out, struct worker *w)
{
    const size_t c = (size_t)p->b->width;
    const int first = p->first + chunk * BLOCK_ROWS, n = rows_of(p, chunk);
    struct attention_span s;
    for (int i = 0; i < n; i += s.n) {
        err_t e = run_check(p->r, "backbone");
        if (e)
            return e;
        s.seq = (first + i) / p->a.len;
        s.first = (first + i) % p->a.len;
        s.n = num_min(n - i, p->a.len - s.first);
        attention_head(&p->a, &s, head, out + (size_t)i * c + (size_t)(head * p->a.width), c,
                       &w->attention);
    }
    return OK;
}

static err_t attend_chunk(void *ctx, int chunk, int worker)
{
    const struct pass *p = ctx;
    float *out = p->attended + (size_t)chunk * BLOCK_ROWS * (size_t)p->b->width;
    return attend_head(p, chunk, p->head, out, p->worker + worker);
}

static err_t finish_chunk(void *ctx, int chunk, int worker)
{
    const struct pass *p = ctx;
    const struct block *b = p->b;
    struct worker *w = p->worker + worker;
    size_t c = (size_t)b->width;
    int first = chunk * BLOCK_ROWS, n = rows_of(p, chunk);
    float *x = b->x + (size_t)first * c;
    const float *attended = p->gathers ? p->attended + (size_t)first * c : w->rows;
    err_t e = OK;
    for (int h = 0; h < p->a.heads && !p->gathers && !e; h++)
        e = attend_head(p, chunk, h, w->rows, w);
    if (e)
        return e;
    const struct layer_in rows = {.x = w->rows, .m = n}, wide = {.x = w->wide, .m = n};
    multiply_rows(p, &b->w->proj, first, (struct layer_in){.x = attended, .m = n},
                  (struct layer_out){.out = x, .ldo = c, .add = true, .gamma = b->w->gamma1},
                  &w->layer);
    normalise_rows(p, b->w->norm2_g, b->w->norm2_b, first, n, w->rows);
    multiply_rows(p, &b->w->fc1, first, rows,
                  (struct layer_out){.out = w->wide, .ldo = MLP * c, .act = ACT_GELU}, &w->layer);
    multiply_rows(p, &b->w->fc2, first, wide,
                  (struct layer_out){.out = x, .ldo = c, .add = true, .gamma = b->w->gamma2},
                  &w->layer);
    for (int i = 0; b->copy && i < n; i++)
        memcpy(b->copy + (size_t)(first + i) * b->ld_copy, x + (size_t)i * c, c * sizeof *x);
    return OK;
}

/* ---- ranks ---- */

/* Begin to gather the blocks of one head. */
static err_t send_head(const struct pass *p, int head)
{
    const size_t bytes = attention_block_bytes(&p->a);
    size_t at[TEAM_MAX + 1];
    for (int i = 0; i <= p->deal.size; i++)
        at[i] = bytes * (size_t)p->deal.block[i];
    return team_begin(p->r->team, p->a.blocks + (size_t)head * at[p->deal.size], at);
}

/* Attention of this rank's tokens, head after head as they arrive. */
static err_t attend_arriving(struct pass *p, int chunks)
{
    const int heads = p->a.heads;
    err_t e = OK;
    for (int h = 0; h < heads + AHEAD && !e; h++) {
        p->head = h - AHEAD;
        if (h < heads)
            e = send_head(p, h);
        if (!e && p->head >= 0)
            e = team_wait(p->r->team);
        if (!e && p->head >= 0)
            e = pool_for(p->r->pool, chunks, attend_chunk, p);
    }
    return e;
}

err_t block_run(const struct run *r, const struct block *b)
{
    struct pass p = pass_of(b, r->team);
    const int chunks = (p.n + BLOCK_ROWS - 1) / BLOCK_ROWS;
    size_t mark = arena_mark(r->tmp);
    p.r = r;
    p.a.k = &r->k->net;
    err_t e = layout(&p, r->tmp, pool_size(r->pool));
    if (!e && p.gathers)
        e = deal_borrow(&p.deal, r->team, b->x, (size_t)b->width * sizeof *b->x);
    if (!e)
        e = store_all(&p);
    if (!e && p.gathers)
        e = attend_arriving(&p, chunks);
    if (!e)
        e = pool_for(r->pool, chunks, finish_chunk, &p);
    arena_reset(r->tmp, mark);
    return e;
}
