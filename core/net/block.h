/* block.h - one transformer block over the tokens of all views (core/net/README.md 1.1, 2.1, 2.3):
 * x += gamma1 attention(norm1 x); x += gamma2 mlp(norm2 x).
 * In a team a rank has the tokens of the views that are dealt to it, and global blocks gather the
 * stored keys and values of all (core/net/README.md 2.13).
 * Invariant: results depend neither on the number of threads nor on the team. */
#ifndef NET_BLOCK_H
#define NET_BLOCK_H

#include "core/base/plan.h"
#include "core/net/graph.h"

/* V = n_views, P = view_tokens, C = width; a head is C / heads wide. T: tokens of this rank, V P
 * without a team. */
struct block {
    const struct block_weights *w;
    int n_views, view_tokens, width, heads;
    bool global;                // all views are one sequence; else each view is its own
    unsigned floats;            // NET_FLOAT_ bits
    float eps;                  // in both norms
    const float *cosine, *sine; // (P, C / heads / 2) for head_rotary; NULL: no rotary embedding
    float *x;                   // (T, C), in place, in room for block_rows rows
    float *q;                   // out: (heads, T, C / heads) after their norms, or NULL
    float *k;                   // out: those of this rank in (heads, V P, C / heads), or NULL
    float *copy;                // out: a copy of the result, from row to row ld_copy, or NULL
    size_t ld_copy;
};

/* T and the rows that global blocks of this rank borrow. */
size_t block_rows(const struct team *t, int n_views, int view_tokens);

/* Count the memory of block_run. */
void block_plan(struct plan *p, const struct block *b);

/* err:  ERR_NOMEM, ERR_CANCELLED, those of the team. */
MUST_USE err_t block_run(const struct run *r, const struct block *b);

#endif
