/* block.h - one transformer block over the tokens of all views (core/net/README.md 1.1, 2.1, 2.3):
 * x += gamma1 attention(norm1 x); x += gamma2 mlp(norm2 x).
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_BLOCK_H
#define NET_BLOCK_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* V = n_views, P = view_tokens, C = width; a head is C / heads wide. */
struct block {
    const struct block_weights *w;
    int n_views, view_tokens, width, heads;
    bool global;                // all views are one sequence; else each view is its own
    unsigned floats;            // NET_FLOAT_ bits
    float eps;                  // in both norms
    const float *cosine, *sine; // (P, C / heads / 2) for head_rotary; NULL: no rotary embedding
    float *x;                   // (V P, C), in place
    float *q, *k;               // out: (heads, V P, C / heads) after their norms, or NULL
    float *copy;                // out: a copy of the result, from row to row ld_copy, or NULL
    size_t ld_copy;
};

/* Count the memory of block_run. */
void block_plan(struct plan *p, const struct block *b);

/* err:  ERR_NOMEM, ERR_CANCELLED. */
MUST_USE err_t block_run(const struct run *r, const struct block *b);

#endif
