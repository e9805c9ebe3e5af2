/* Two passes over the pool. The first computes queries, keys and values of ATTENTION_KEYS tokens
 * of a sequence at a time and stores them. The second runs attention and the rest of the block on
 * BLOCK_ROWS tokens at a time, of any sequences, so that everything between the two norms stays in
 * the worker's scratch. */
#include "core/net/block.h"

#include "core/base/num.h"
#include "core/net/attention.h"
#include "core/net/layer.h"

#include <string.h>

enum { BLOCK_ROWS = ATTENTION_ROWS, MLP = 4 };

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
    struct attention a;
    struct worker *worker; // (threads)
};

static size_t wide_floats(const struct block *b)
{
    size_t attention = (size_t)ATTENTION_KEYS * 3, mlp = (size_t)BLOCK_ROWS * MLP;
    return (attention > mlp ? attention : mlp) * (size_t)b->width;
}

static struct attention shape_of(const struct block *b)
{
    return (struct attention){.seqs = b->global ? 1 : b->n_views,
                              .len = b->global ? b->n_views * b->view_tokens : b->view_tokens,
                              .heads = b->heads,
                              .width = b->width / b->heads,
                              .floats = b->floats & NET_FLOAT_ATTENTION};
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
    p->a = shape_of(p->b);
    err_t e = arena_alloc(tmp, (size_t)threads, sizeof *p->worker, &p->worker);
    for (int i = 0; !e && i < threads; i++) {
        struct worker w;
        e = worker_init(&w, p->b, tmp);
        if (!e && !tmp->counts)
            p->worker[i] = w;
    }
    return e ? e : attention_init(&p->a, tmp);
}

void block_plan(struct plan *p, const struct block *b)
{
    struct pass pass = {.b = b};
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

/* Norms, capture and rotation of the queries and keys of n tokens from `first` on. */
static void rotate_heads(const struct pass *p, int first, int n, float *qkv)
{
    const struct block *b = p->b;
    size_t c = (size_t)b->width, w = c / (size_t)b->heads;
    size_t tokens = (size_t)b->n_views * (size_t)b->view_tokens;
    struct head_rotary q = {.n = (int)w, .gamma = b->w->q_g, .beta = b->w->q_b}, k = q;
    k.gamma = b->w->k_g;
    k.beta = b->w->k_b;
    for (int i = 0; i < n; i++) {
        size_t token = (size_t)(first + i), angle = token % (size_t)b->view_tokens * (w / 2);
        q.cosine = k.cosine = b->cosine ? b->cosine + angle : NULL;
        q.sine = k.sine = b->cosine ? b->sine + angle : NULL;
        for (size_t h = 0; h < (size_t)b->heads; h++) {
            float *at = qkv + (size_t)i * 3 * c + h * w;
            q.before = b->q ? b->q + (h * tokens + token) * w : NULL;
            k.before = b->k ? b->k + (h * tokens + token) * w : NULL;
            p->r->k->net.head_rotary(&q, at);
            p->r->k->net.head_rotary(&k, at + c);
        }
    }
}

static err_t store_chunk(void *ctx, int chunk, int worker)
{
    const struct pass *p = ctx;
    const struct block *b = p->b;
    struct worker *w = p->worker + worker;
    int per_seq = (p->a.len + ATTENTION_KEYS - 1) / ATTENTION_KEYS;
    struct attention_span s = {.seq = chunk / per_seq, .first = chunk % per_seq * ATTENTION_KEYS};
    s.n = num_min(ATTENTION_KEYS, p->a.len - s.first);
    int first = s.seq * p->a.len + s.first;
    err_t e = run_check(p->r, "backbone");
    if (e)
        return e;
    normalise_rows(p, b->w->norm1_g, b->w->norm1_b, first, s.n, w->rows);
    multiply_rows(p, &b->w->qkv, first, (struct layer_in){.x = w->rows, .m = s.n},
                  (struct layer_out){.out = w->wide, .ldo = 3 * (size_t)b->width}, &w->layer);
    if (b->w->q_g || b->cosine || b->q)
        rotate_heads(p, first, s.n, w->wide);
    attention_store(&p->a, &s, w->wide, &w->attention);
    return OK;
}

/* ---- second pass ---- */

/* Attention of n tokens from `first` on, each over its own sequence, into w->rows. */
static err_t attend_rows(const struct pass *p, int first, int n, struct worker *w)
{
    size_t c = (size_t)p->b->width;
    struct attention_span s;
    for (int i = 0; i < n; i += s.n) {
        s.seq = (first + i) / p->a.len;
        s.first = (first + i) % p->a.len;
        s.n = num_min(n - i, p->a.len - s.first);
        for (int h = 0; h < p->a.heads; h++) {
            err_t e = run_check(p->r, "backbone");
            if (e)
                return e;
            attention_head(&p->a, &s, h, w->rows + (size_t)i * c + (size_t)(h * p->a.width), c,
                           &w->attention);
        }
    }
    return OK;
}

static err_t finish_chunk(void *ctx, int chunk, int worker)
{
    const struct pass *p = ctx;
    const struct block *b = p->b;
    struct worker *w = p->worker + worker;
    size_t c = (size_t)b->width;
    int first = chunk * BLOCK_ROWS, n = num_min(BLOCK_ROWS, b->n_views * b->view_tokens - first);
    float *x = b->x + (size_t)first * c;
    err_t e = attend_rows(p, first, n, w);
    if (e)
        return e;
    const struct layer_in rows = {.x = w->rows, .m = n}, wide = {.x = w->wide, .m = n};
    multiply_rows(p, &b->w->proj, first, rows,
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

err_t block_run(const struct run *r, const struct block *b)
{
    struct pass p = {.r = r, .b = b};
    int tokens = b->n_views * b->view_tokens;
    size_t mark = arena_mark(r->tmp);
    err_t e = layout(&p, r->tmp, pool_size(r->pool));
    int stores = p.a.seqs * ((p.a.len + ATTENTION_KEYS - 1) / ATTENTION_KEYS);
    p.a.k = &r->k->net;
    if (!e)
        e = pool_for(r->pool, stores, store_chunk, &p);
    if (!e)
        e = pool_for(r->pool, (tokens + BLOCK_ROWS - 1) / BLOCK_ROWS, finish_chunk, &p);
    arena_reset(r->tmp, mark);
    return e;
}
