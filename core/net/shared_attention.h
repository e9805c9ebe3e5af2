/* shared_attention.h - the attention that appearance shares with geometry (core/net/README.md 2.7):
 * softmax over all keys of all views, mean over the heads, from q and k of one block before rotary
 * embedding. Streamed by blocks of query rows, so that no matrix of tokens by tokens exists.
 * Pure computation on the pool inside struct run. */
#ifndef NET_SHARED_ATTENTION_H
#define NET_SHARED_ATTENTION_H

#include "core/base/plan.h"
#include "core/net/graph.h"

enum { SHARED_ATTENTION_ROWS = 32 }; // queries at a time at most

struct shared_attention {
    const struct run *r;
    const struct tokens *t;
    int heads, head; // number and width of heads
    int m, keys;     // patches of a view; tokens of all views
    int key_panels;
    float *panels; // per head (key_panels, head, PANEL)
};

/* Scratch of one worker. */
struct shared_attention_workspace {
    float *logits; // (SHARED_ATTENTION_ROWS, pitch) of one head
    float *sum; // (SHARED_ATTENTION_ROWS, pitch) mean over the heads: column v (m + NET_SPECIAL) +
                // NET_SPECIAL + i is patch i of view v, those before it are special tokens
};

/* Shape of the attention of n_views views of grid x grid patches. */
struct shared_attention shared_attention_shape(const struct net_dims *d, int n_views, int grid);

/* Floats from row to row of shared_attention_workspace. */
size_t shared_attention_pitch(const struct shared_attention *a);

/* Carve the panels of a shared_attention_shape; fill them; carve a room.
 * err:  ERR_NOMEM, ERR_CANCELLED */
MUST_USE err_t shared_attention_layout(struct shared_attention *a, struct arena *arena);
MUST_USE err_t shared_attention_init(const struct run *r, const struct tokens *t,
                                     struct shared_attention *a);
MUST_USE err_t shared_attention_workspace_init(const struct shared_attention *a,
                                               struct arena *arena,
                                               struct shared_attention_workspace *out);

/* Attention of the queries [first, first + rows) of a view of this rank, into room->sum.
 * err:  ERR_CANCELLED. */
MUST_USE err_t shared_attention_rows(const struct shared_attention *a, int view, int first,
                                     int rows, const struct shared_attention_workspace *room);

/* For every patch its best tokens in every other view, with their share of the attention that goes
 * to that view; in a team gathered.
 * out:  lives in r->keep.
 * err:  ERR_NOMEM (see shared_attention_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t shared_attention_run(const struct run *r, const struct net_dims *d,
                                    const struct tokens *t, struct correspondence *out);
void shared_attention_plan(struct plan *p, const struct net_dims *d, int n_views, int size);

#endif
