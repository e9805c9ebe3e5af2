#include "core/net/attention.h"

#include "core/base/num.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define LARGEST                                                                                    \
    1e15f // bound of a quantised query or key: its square times 128 channels is below FLT_MAX

/* Parts of a stored block of keys; those from key_scale on only for s8. */
struct stored {
    void *key;          // (128 / 16, width, 16), s8: (.., width / 4, 16, 4)
    void *value;        // (width / 16, 128, 16), s8: (.., 32, 16, 4)
    float *key_scale;   // (128)
    float *value_scale; // (width)
    int32_t *shift;     // (width) 127 times the sum of the values
};

static size_t elem_of(const struct attention *a)
{
    return a->floats ? sizeof(float) : 1;
}

/* ---- memory ---- */

int attention_blocks(const struct attention *a)
{
    return (a->len + ATTENTION_KEYS - 1) / ATTENTION_KEYS;
}

size_t attention_block_bytes(const struct attention *a)
{
    const size_t w = (size_t)a->width;
    const size_t scales = ATTENTION_KEYS * sizeof(float) + w * (sizeof(float) + sizeof(int32_t));
    return 2 * ATTENTION_KEYS * w * elem_of(a) + (a->floats ? 0 : scales);
}

/* The block that begins with key `first`; head: among all sequences. */
static struct stored block_at(const struct attention *a, size_t head, int first)
{
    const size_t w = (size_t)a->width, half = ATTENTION_KEYS * w * elem_of(a);
    const size_t block = head * (size_t)attention_blocks(a) + (size_t)(first / ATTENTION_KEYS);
    char *at = a->blocks + block * attention_block_bytes(a), *scales = at + 2 * half;
    return (struct stored){.key = at,
                           .value = at + half,
                           .key_scale = (void *)scales,
                           .value_scale = (void *)(scales + ATTENTION_KEYS * sizeof(float)),
                           .shift = (void *)(scales + (ATTENTION_KEYS + w) * sizeof(float))};
}

err_t attention_init(struct attention *a, struct arena *arena)
{
    size_t heads = (size_t)a->seqs * (size_t)a->heads, queries = heads * (size_t)a->q_len;
    err_t e = arena_alloc(arena, queries * (size_t)a->width, elem_of(a), &a->q);
    if (!e)
        e = arena_alloc(arena, queries, sizeof(float), &a->query_scale);
    return e ? e
             : arena_alloc(arena, heads * (size_t)attention_blocks(a), attention_block_bytes(a),
                           &a->blocks);
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

/* Tokens of one head. */
struct block {
    const struct attention *a;
    size_t head;     // among all sequences: seq heads + head
    int seq, in_seq; // sequence; head of it
    int first, n;    // tokens of the sequence
    const float *q, *k, *v;
    size_t ld; // from token to token
};

static struct block block_of(const struct attention *a, const struct attention_span *s, int head,
                             const float *qkv)
{
    const size_t c = (size_t)a->heads * (size_t)a->width;
    const float *q = qkv + (size_t)head * (size_t)a->width;
    return (struct block){.a = a,
                          .head = (size_t)s->seq * (size_t)a->heads + (size_t)head,
                          .seq = s->seq,
                          .in_seq = head,
                          .first = s->first,
                          .n = s->n,
                          .q = q,
                          .k = q + c,
                          .v = q + 2 * c,
                          .ld = 3 * c};
}

/* Where the query of a token lies. */
static size_t query_at(const struct block *b, int token)
{
    const struct attention *a = b->a;
    size_t row = (size_t)b->seq * (size_t)a->q_len + (size_t)(token - a->q_first);
    return (row * (size_t)a->heads + (size_t)b->in_seq) * (size_t)a->width;
}

static float *query_scale_at(const struct block *b, int token)
{
    const struct attention *a = b->a;
    return a->query_scale + b->head * (size_t)a->q_len + (token - a->q_first);
}

static void store_queries(const struct block *b)
{
    const struct attention *a = b->a;
    const float unit = 1 / sqrtf((float)a->width);
    float *scale = query_scale_at(b, b->first);
    for (int i = 0; i < b->n; i++) {
        size_t at = query_at(b, b->first + i);
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
    const struct stored stored = block_at(a, b->head, b->first);
    int padded = (b->n + PANEL - 1) / PANEL * PANEL, w = a->width;
    for (int i = 0; i < padded; i++) {
        const float *k = b->k + (size_t)i * b->ld;
        size_t panel = (size_t)(i / PANEL * PANEL) * (size_t)w;
        if (a->floats) {
            float *to = (float *)stored.key + panel + i % PANEL;
            for (int c = 0; c < w; c++)
                to[c * PANEL] = i < b->n ? k[c] : 0;
            continue;
        }
        int8_t *to = (int8_t *)stored.key + panel + 4 * (i % PANEL);
        if (i < b->n)
            stored.key_scale[i] = quantise_part(a->k, k, w, LARGEST, room->q);
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
    const struct stored stored = block_at(a, b->head, b->first);
    if (a->floats) {
        store_float_values(b, stored.value);
        return;
    }
    for (int i = 0; i < b->n; i++)
        for (int c = 0; c < a->width; c++)
            room->transposed[c * ATTENTION_KEYS + i] = b->v[(size_t)i * b->ld + (size_t)c];
    int8_t *to = stored.value;
    memset(room->q, 0, ATTENTION_KEYS);
    for (int c = 0; c < a->width; c++) {
        int8_t *panel = to + c / PANEL * PANEL * ATTENTION_KEYS + 4 * (c % PANEL);
        stored.value_scale[c] =
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
                                 .c = stored.shift,
                                 .ldc = (size_t)a->width};
    a->k->s8(&sums);
}

void attention_store_queries(const struct attention *a, const struct attention_span *s,
                             const float *qkv)
{
    for (int h = 0; h < a->heads; h++) {
        const struct block b = block_of(a, s, h, qkv);
        store_queries(&b);
    }
}

void attention_store_block(const struct attention *a, const struct attention_span *s,
                           const float *qkv, struct attention_workspace *room)
{
    for (int h = 0; h < a->heads; h++) {
        const struct block b = block_of(a, s, h, qkv);
        store_keys(&b, room);
        store_values(&b, room);
    }
}

/* ---- rows ---- */

/* Logits of a stored block of n keys. */
static void block_logits(const struct block *b, const struct stored *of, int n,
                         struct attention_workspace *room)
{
    const struct attention *a = b->a;
    size_t at = query_at(b, b->first), w = (size_t)a->width;
    int panels = (n + PANEL - 1) / PANEL;
    if (a->floats) {
        const struct gemm_f32 g = {.m = b->n,
                                   .panels = panels,
                                   .segs = 1,
                                   .seg = a->width,
                                   .a = (const float *)a->q + at,
                                   .lda = (size_t)a->heads * w,
                                   .w = of->key,
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
                                  .w = of->key,
                                  .ldw = w * PANEL,
                                  .c = room->s,
                                  .ldc = ATTENTION_KEYS};
        a->k->s8(&g);
    }
}

static void softmax_weights(const struct block *b, const struct stored *of, int n,
                            struct attention_workspace *room)
{
    const bool floats = b->a->floats;
    const struct attend_block t = {.m = b->n,
                                   .n = n,
                                   .si = floats ? NULL : room->s,
                                   .sf = room->sf,
                                   .lds = ATTENTION_KEYS,
                                   .row_scale = query_scale_at(b, b->first),
                                   .key_scale = floats ? NULL : of->key_scale,
                                   .top = room->top,
                                   .sum = room->sum,
                                   .pi = room->p,
                                   .pf = room->sf,
                                   .ldp = ATTENTION_KEYS,
                                   .rescale = room->rescale,
                                   .weigh = room->weigh};
    b->a->k->attend_block(&t);
}

/* Sums of weights times values of a stored block of n. */
static void weighted_values(const struct block *b, const struct stored *of, int n,
                            struct attention_workspace *room)
{
    const struct attention *a = b->a;
    if (a->floats) {
        const struct gemm_f32 g = {.m = b->n,
                                   .panels = a->width / PANEL,
                                   .segs = 1,
                                   .seg = n,
                                   .a = room->sf,
                                   .lda = ATTENTION_KEYS,
                                   .w = of->value,
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
                                  .w = of->value,
                                  .ldw = ATTENTION_KEYS * PANEL,
                                  .c = room->c,
                                  .ldc = (size_t)a->width};
        a->k->s8(&g);
    }
}

void attention_head(const struct attention *a, const struct attention_span *s, int head, float *out,
                    size_t ldo, struct attention_workspace *room)
{
    const struct block b = {.a = a,
                            .head = (size_t)s->seq * (size_t)a->heads + (size_t)head,
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
        const int n = num_min(ATTENTION_KEYS, a->len - first);
        const struct stored of = block_at(a, b.head, first);
        block_logits(&b, &of, n, room);
        softmax_weights(&b, &of, n, room);
        weighted_values(&b, &of, n, room);
        const struct attend_add add = {.m = s->n,
                                       .n = a->width,
                                       .ci = a->floats ? NULL : room->c,
                                       .cf = room->cf,
                                       .ldc = (size_t)a->width,
                                       .rescale = room->rescale,
                                       .weigh = room->weigh,
                                       .value_scale = a->floats ? NULL : of.value_scale,
                                       .shift = a->floats ? NULL : of.shift,
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
