/* attend.h - the attention that geometry lends to appearance (model-spec 2.7): softmax over all
 * keys of all views, mean over the heads, from q and k of one block before rotary embedding.
 * Streamed by blocks of query rows, so that no matrix of tokens by tokens exists.
 * Pure computation on the pool inside struct run. */
#ifndef NET_ATTEND_H
#define NET_ATTEND_H

#include "core/net/net.h"

enum { ATTEND_ROWS = 32 }; // queries at a time at most

struct attend {
    const struct run *r;
    const struct tokens *t;
    int heads, head; // number and width of heads
    int m, keys;     // patches of a view; tokens of all views
    int key_panels;
    float *panels; // per head (key_panels, head, PANEL)
};

/* Scratch of one worker. */
struct attend_room {
    float *logits; // (ATTEND_ROWS, pitch) of one head
    float *sum;    // (ATTEND_ROWS, pitch) mean over the heads: column v (m + NET_SPECIAL) +
                   // NET_SPECIAL + i is patch i of view v, those before it are special tokens
};

/* Shape of the attention of n_views views of grid x grid patches. */
struct attend attend_shape(const struct net_dims *d, int n_views, int grid);

/* Floats from row to row of attend_room. */
size_t attend_pitch(const struct attend *a);

/* Carve and fill the panels of an attend_shape, a room; bytes of them.
 * err:  ERR_NOMEM, ERR_CANCELLED */
MUST_USE err_t attend_init(const struct run *r, const struct tokens *t, struct attend *a);
MUST_USE err_t attend_room_init(const struct attend *a, struct arena *arena,
                                struct attend_room *out);
size_t attend_need(const struct attend *a);
size_t attend_room_need(const struct attend *a);

/* Attention of the queries [first, first + rows) of a view, into room->sum.
 * err:  ERR_CANCELLED. */
MUST_USE err_t attend_rows(const struct attend *a, int view, int first, int rows,
                           const struct attend_room *room);

/* For every patch its best tokens in every other view, with their share of the attention that goes
 * to that view.
 * out:  lives in r->keep.
 * err:  ERR_NOMEM (see attend_plan), ERR_CANCELLED. On error *out is zeroed. */
MUST_USE err_t attend_run(const struct run *r, const struct net_dims *d, const struct tokens *t,
                          struct correspondence *out);
void attend_plan(const struct net_dims *d, int n_views, int size, int threads, size_t *keep,
                 size_t *tmp);

#endif
