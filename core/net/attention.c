#include "core/net/attention.h"

#include "core/base/num.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define LARGEST                                                                                    \
    1e15f // bound of a quantised query or key: its square times 128 channels is below FLT_MAX

static size_t count_blocks(const struct attention *a)
{
    return ((size_t)a->len + ATTENTION_KEYS - 1) / ATTENTION_KEYS;
}

/* Elements of all keys, and of all values. */
static size_t count_keys(const struct attention *a)
{
    return (size_t)a->seqs * (size_t)a->heads * count_blocks(a) * ATTENTION_KEYS;
}

static size_t elem_of(const struct attention *a)
{
    return a->floats ? sizeof(float) : 1;
}

/* ---- memory ---- */

err_t attention_init(struct attention *a, struct arena *arena)
{
    size_t keys = count_keys(a), heads = (size_t)a->seqs * (size_t)a->heads, w = (size_t)a->width;
    err_t e = arena_alloc(arena, heads * (size_t)a->len * w, elem_of(a), &a->q);
    if (!e)
        e = arena_alloc(arena, keys * w, elem_of(a), &a->key);
    if (!e)
        e = arena_alloc(arena, keys * w, elem_of(a), &a->value);
    if (!e)
        e = arena_alloc(arena, heads * (size_t)a->len, sizeof(float), &a->query_scale);
    a->key_scale = a->value_scale = NULL;
    a->shift = NULL;
    if (!e && !a->floats)
        e = arena_alloc(arena, keys, sizeof(float), &a->key_scale);
    if (!e && !a->floats)
        e = arena_alloc(arena, keys / ATTENTION_KEYS * w, sizeof(float), &a->value_scale);
    if (!e && !a->floats)
        e = arena_alloc(arena, keys / ATTENTION_KEYS * w, sizeof(int32_t), &a->shift);
    return e;
}

static size_t strip_bytes(int width)
{
    return (size_t)(width > ATTENTION_KEYS ? width : ATTENTION_KEYS);
}

err_t attention_workspace_init(struct attention_workspace *room, int width, struct arena *arena)
{
    float **row[] = {&room->top, &room->sum, &room->rescale, &room->weigh};
    size_t w = (size_t)width;
    err_t e = arena_alloc(arena, ATTENTION_ROWS * ATTENTION_KEYS, sizeof(int32_t), &room->s);
    if (!e)
        e = arena_alloc(arena, ATTENTION_ROWS * ATTENTION_KEYS, 1, &room->p);
    if (!e)
        e = arena_alloc(arena, ATTENTION_ROWS * w, sizeof(int32_t), &room->c);
    for (int i = 0; !e && i < 4; i++)
        e = arena_alloc(arena, ATTENTION_ROWS, sizeof(float), row[i]);
    if (!e)
        e = arena_alloc(arena, w * ATTENTION_KEYS, sizeof(float), &room->transposed);
    if (!e)
        e = arena_alloc(arena, strip_bytes(width), 1, &room->q);
    return e;
}

/* ---- storing ---- */

/* Quantise the part of a token that belongs to one head. Values beyond `most` are cut off: LARGEST
 * for queries and keys, so that logits are always finite. returns: the scale. */
static float quantise_part(const struct gemm_kernels *k, const float *x, int n, float most,
                           int8_t *out)
{
    float top = fminf(k->absmax(x, (size_t)n), most);
    k->quant(x, (size_t)n, top < FLT_MIN ? 0 : 127 / top, out);
    return top < FLT_MIN ? 0 : top / 127;
}

/* A block of tokens of one head. */
struct block {
    const struct attention *a;
    size_t head;     // among all sequences: seq heads + head
    int seq, in_seq; // sequence; head of it
    int first, n;    // tokens of the sequence
    const float *q, *k, *v;
    size_t ld; // from token to token
};

static void store_queries(const struct block *b)
{
    const struct attention *a = b->a;
    const float unit = 1 / sqrtf((float)a->width);
    float *scale = a->query_scale + b->head * (size_t)a->len + b->first;
    for (int i = 0; i < b->n; i++) {
        size_t token = (size_t)b->seq * (size_t)a->len + (size_t)(b->first + i);
        size_t at = (token * (size_t)a->heads + (size_t)b->in_seq) * (size_t)a->width;
        const float *q = b->q + (size_t)i * b->ld;
        scale[i] = unit;
        if (a->floats)
            memcpy((float *)a->q + at, q, (size_t)a->width * sizeof *q);
        else
            scale[i] *= quantise_part(a->k, q, a->width, LARGEST, (int8_t *)a->q + at);
    }
}

/* Missing keys of the last panel are zero: their products are defined but not used. */
static void store_keys(const struct block *b, struct attention_workspace *room)
{
    const struct attention *a = b->a;
    size_t key = b->head * count_blocks(a) * ATTENTION_KEYS + (size_t)b->first;
    size_t from = key * (size_t)a->width;
    int padded = (b->n + PANEL - 1) / PANEL * PANEL, w = a->width;
    for (int i = 0; i < padded; i++) {
        const float *k = b->k + (size_t)i * b->ld;
        size_t panel = from + (size_t)(i / PANEL * PANEL) * (size_t)w;
        if (a->floats) {
            float *to = (float *)a->key + panel + i % PANEL;
            for (int c = 0; c < w; c++)
                to[c * PANEL] = i < b->n ? k[c] : 0;
            continue;
        }
        int8_t *to = (int8_t *)a->key + panel + 4 * (i % PANEL);
        if (i < b->n)
            a->key_scale[key + (size_t)i] = quantise_part(a->k, k, w, LARGEST, room->q);
        else
            memset(room->q, 0, (size_t)w);
        for (int c = 0; c < w; c += 4)
            memcpy(to + c * PANEL, room->q + c, 4);
    }
}

static void store_float_values(const struct block *b, float *to)
{
    for (int i = 0; i < b->n; i++)
        for (int c = 0; c < b->a->width; c += PANEL)
            memcpy(to + (size_t)c * ATTENTION_KEYS + i * PANEL, b->v + (size_t)i * b->ld + c,
                   PANEL * sizeof *to);
}

/* Missing keys up to the next multiple of 4 are zero. */
static void store_values(const struct block *b, struct attention_workspace *room)
{
    const struct attention *a = b->a;
    size_t block = b->head * count_blocks(a) + (size_t)(b->first / ATTENTION_KEYS);
    size_t from = block * ATTENTION_KEYS * (size_t)a->width;
    if (a->floats) {
        store_float_values(b, (float *)a->value + from);
        return;
    }
    for (int i = 0; i < b->n; i++)
        for (int c = 0; c < a->width; c++)
            room->transposed[c * ATTENTION_KEYS + i] = b->v[(size_t)i * b->ld + (size_t)c];
    float *scale = a->value_scale + block * (size_t)a->width;
    int8_t *to = (int8_t *)a->value + from;
    memset(room->q, 0, ATTENTION_KEYS);
    for (int c = 0; c < a->width; c++) {
        int8_t *panel = to + c / PANEL * PANEL * ATTENTION_KEYS + 4 * (c % PANEL);
        scale[c] =
            quantise_part(a->k, room->transposed + c * ATTENTION_KEYS, b->n, INFINITY, room->q);
        for (int i = 0; i < b->n; i += 4)
            memcpy(panel + i * PANEL, room->q + i, 4);
    }
    memset(room->q, 127, ATTENTION_KEYS);
    const struct gemm_s8 sums = {.m = 1,
                                 .panels = a->width / PANEL,
                                 .segs = 1,
                                 .seg = (b->n + 3) / 4 * 4,
                                 .a = room->q,
                                 .w = to,
                                 .ldw = ATTENTION_KEYS * PANEL,
                                 .c = a->shift + block * (size_t)a->width,
                                 .ldc = (size_t)a->width};
    a->k->s8(&sums);
}

void attention_store(const struct attention *a, const struct attention_span *s, const float *qkv,
                     struct attention_workspace *room)
{
    size_t c = (size_t)a->heads * (size_t)a->width;
    for (int h = 0; h < a->heads; h++) {
        const float *q = qkv + (size_t)h * (size_t)a->width;
        struct block b = {.a = a,
                          .head = (size_t)s->seq * (size_t)a->heads + (size_t)h,
                          .seq = s->seq,
                          .in_seq = h,
                          .first = s->first,
                          .n = s->n,
                          .q = q,
                          .k = q + c,
                          .v = q + 2 * c,
                          .ld = 3 * c};
        store_queries(&b);
        store_keys(&b, room);
        store_values(&b, room);
    }
}

/* ---- rows ---- */

/* Logits of a block of n keys from `first` on. */
static void block_logits(const struct attention *a, const struct block *b, int first, int n,
                         struct attention_workspace *room)
{
    size_t token = (size_t)b->seq * (size_t)a->len + (size_t)b->first, w = (size_t)a->width;
    size_t at = (token * (size_t)a->heads + (size_t)b->in_seq) * w;
    size_t key = (b->head * count_blocks(a) * ATTENTION_KEYS + (size_t)first) * w;
    int panels = (n + PANEL - 1) / PANEL;
    if (a->floats) {
        const struct gemm_f32 g = {.m = b->n,
                                   .panels = panels,
                                   .segs = 1,
                                   .seg = a->width,
                                   .a = (const float *)a->q + at,
                                   .lda = (size_t)a->heads * w,
                                   .w = (const float *)a->key + key,
                                   .ldw = w * PANEL,
                                   .c = room->sf,
                                   .ldc = ATTENTION_KEYS};
        a->k->f32(&g);
    } else {
        const struct gemm_s8 g = {.m = b->n,
                                  .panels = panels,
                                  .segs = 1,
                                  .seg = a->width,
                                  .a = (const int8_t *)a->q + at,
                                  .lda = (size_t)a->heads * w,
                                  .w = (const int8_t *)a->key + key,
                                  .ldw = w * PANEL,
                                  .c = room->s,
                                  .ldc = ATTENTION_KEYS};
        a->k->s8(&g);
    }
}

static void softmax_weights(const struct attention *a, const struct block *b, int first, int n,
                            struct attention_workspace *room)
{
    size_t key = b->head * count_blocks(a) * ATTENTION_KEYS + (size_t)first;
    const struct attend_block t = {.m = b->n,
                                   .n = n,
                                   .si = a->floats ? NULL : room->s,
                                   .sf = room->sf,
                                   .lds = ATTENTION_KEYS,
                                   .row_scale =
                                       a->query_scale + b->head * (size_t)a->len + b->first,
                                   .key_scale = a->floats ? NULL : a->key_scale + key,
                                   .top = room->top,
                                   .sum = room->sum,
                                   .pi = room->p,
                                   .pf = room->sf,
                                   .ldp = ATTENTION_KEYS,
                                   .rescale = room->rescale,
                                   .weigh = room->weigh};
    a->k->attend_block(&t);
}

/* Sums of weights times values of the block that begins with key `first`. */
static void weighted_values(const struct attention *a, const struct block *b, int first, int n,
                            struct attention_workspace *room)
{
    size_t block = b->head * count_blocks(a) + (size_t)(first / ATTENTION_KEYS);
    size_t at = block * ATTENTION_KEYS * (size_t)a->width;
    if (a->floats) {
        const struct gemm_f32 g = {.m = b->n,
                                   .panels = a->width / PANEL,
                                   .segs = 1,
                                   .seg = n,
                                   .a = room->sf,
                                   .lda = ATTENTION_KEYS,
                                   .w = (const float *)a->value + at,
                                   .ldw = ATTENTION_KEYS * PANEL,
                                   .c = room->cf,
                                   .ldc = (size_t)a->width};
        a->k->f32(&g);
    } else {
        const struct gemm_s8 g = {.m = b->n,
                                  .panels = a->width / PANEL,
                                  .segs = 1,
                                  .seg = (n + 3) / 4 * 4,
                                  .a = room->p,
                                  .lda = ATTENTION_KEYS,
                                  .w = (const int8_t *)a->value + at,
                                  .ldw = ATTENTION_KEYS * PANEL,
                                  .c = room->c,
                                  .ldc = (size_t)a->width};
        a->k->s8(&g);
    }
}

void attention_head(const struct attention *a, const struct attention_span *s, int head, float *out,
                    size_t ldo, struct attention_workspace *room)
{
    const struct block b = {.head = (size_t)s->seq * (size_t)a->heads + (size_t)head,
                            .seq = s->seq,
                            .in_seq = head,
                            .first = s->first,
                            .n = s->n};
    for (int i = 0; i < s->n; i++) {
        room->top[i] = -INFINITY;
        room->sum[i] = 0;
        memset(out + (size_t)i * ldo, 0, (size_t)a->width * sizeof *out);
    }
    for (int first = 0; first < a->len; first += ATTENTION_KEYS) {
        int n = num_min(ATTENTION_KEYS, a->len - first);
        size_t at =
            (b.head * count_blocks(a) + (size_t)(first / ATTENTION_KEYS)) * (size_t)a->width;
        block_logits(a, &b, first, n, room);
        softmax_weights(a, &b, first, n, room);
        weighted_values(a, &b, first, n, room);
        const struct attend_add add = {.m = s->n,
                                       .n = a->width,
                                       .ci = a->floats ? NULL : room->c,
                                       .cf = room->cf,
                                       .ldc = (size_t)a->width,
                                       .rescale = room->rescale,
                                       .weigh = room->weigh,
                                       .value_scale = a->floats ? NULL : a->value_scale + at,
                                       .shift = a->floats ? NULL : a->shift + at,
                                       .o = out,
                                       .ldo = ldo};
        a->k->attend_add(&add);
    }
    for (int i = 0; i < s->n; i++) {
        const float unit = 1 / room->sum[i];
        for (int c = 0; c < a->width; c++)
            out[(size_t)i * ldo + (size_t)c] *= unit;
    }
}
