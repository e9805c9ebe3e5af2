/* attention.h - softmax attention of many sequences of tokens at once, streamed over blocks of keys
 * so that no matrix of tokens by tokens exists (Milakov and Gimelshein 2018; Dao et al. 2022).
 * Queries, keys and values are stored once in the form of the products; then any rows can be
 * computed. In s8 (gemm.h): q and k with a scale per token and head, v per block of keys, head and
 * channel; else in floats. A block of keys lies in one piece, which may come from elsewhere.
 * A call writes only data of its own tokens, so calls may run in parallel. */
#ifndef NET_ATTENTION_H
#define NET_ATTENTION_H

#include "core/kernels/kernels.h"

enum {
    ATTENTION_ROWS = 64, // query rows at a time at most
    ATTENTION_KEYS = 128 // keys of a block
};

struct attention {
    const struct gemm_kernels *k;
    int seqs, len;      // sequences; tokens of each
    int q_first, q_len; // tokens of a sequence whose queries are stored
    int heads, width;   // width of a head: a multiple of 16, at most 128
    bool floats;
    /* carved by attention_init; elements are s8 unless floats */
    void *q;            // (seqs q_len, heads, width)
    float *query_scale; // (seqs, heads, q_len) with 1 / sqrt(width)
    char *blocks;       // (seqs, heads, attention_blocks) of attention_block_bytes each
};

/* Scratch of one worker. */
struct attention_workspace {
    union {
        int32_t *s; // (ROWS, KEYS) logits
        float *sf;  // for floats; become weights in place
    };
    int8_t *p; // (ROWS, KEYS) weights
    union {
        int32_t *c; // (ROWS, width) sums
        float *cf;  // for floats
    };
    float *top, *sum, *rescale, *weigh; // (ROWS)
    float *transposed;                  // (width, KEYS) values, transposed
    int8_t *q;                          // (max(width, KEYS)) integers of a key or a channel
};

/* Tokens [first, first + n) of sequence seq. */
struct attention_span {
    int seq, first, n;
};

/* Blocks of keys of a sequence, the last one with the rest of them, and bytes of one. */
int attention_blocks(const struct attention *a);
size_t attention_block_bytes(const struct attention *a);

/* Carve the arrays of *a, whose shape the caller has set. */
MUST_USE err_t attention_init(struct attention *a, struct arena *arena);
MUST_USE err_t attention_workspace_init(struct attention_workspace *room, int width,
                                        struct arena *arena);

/* Store queries of tokens from q_first to q_first + q_len. qkv: (n, 3, heads, width). */
void attention_store_queries(const struct attention *a, const struct attention_span *s,
                             const float *qkv);

/* Store a block of keys and values: first is a multiple of ATTENTION_KEYS, and n is ATTENTION_KEYS
 * or the rest of the sequence. */
void attention_store_block(const struct attention *a, const struct attention_span *s,
                           const float *qkv, struct attention_workspace *room);

/* Attention of the tokens of s (at most ATTENTION_ROWS) over their whole sequence, one head. Their
 * queries and all blocks of the head must be there. out: (n, width) from row to row ldo. */
void attention_head(const struct attention *a, const struct attention_span *s, int head, float *out,
                    size_t ldo, struct attention_workspace *room);

#endif
