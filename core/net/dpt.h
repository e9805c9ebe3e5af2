/* dpt.h - the trunk of a dense prediction transformer that the depth and the Gaussian head share:
 * kept tokens of one view become a map of eight pixels per patch edge (core/net/README.md 2.5).
 * Pure computation on the pool inside struct run.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_DPT_H
#define NET_DPT_H

#include "core/base/plan.h"
#include "core/net/graph.h"
#include "core/net/layer.h"

/* One view of one head. */
struct dpt_job {
    const struct net *net;
    const struct dpt_weights *w;
    const struct tokens *tokens;
    int view;         // of all; its tokens must be here
    const char *head; // first part of the names of its tapped tensors
};

/* Edge of the trunk's map, px. */
static inline int dpt_edge(int grid)
{
    return 8 * grid;
}

/* Count the memory of dpt_run. */
void dpt_plan(struct plan *p, const struct dpt_weights *w, int grid);

/* The trunk of core/net/README.md 2.5, before its map is brought to full size.
 * out:  (edge, edge, feat / 2), edge = dpt_edge.
 * err:  ERR_NOMEM (r->tmp, see dpt_plan), ERR_CANCELLED. */
MUST_USE err_t dpt_run(const struct run *r, const struct dpt_job *j, float *out);

/* Position code of a square map of n x n and `channels` (a multiple of 4), times 0.1. It has a
 * part for the column and one for the row, both from one table.
 * out:  (n, channels / 2): channel c of pixel (y, x) gets out[x][c] for c < channels / 2, else
 *       out[y][c - channels / 2]. */
void dpt_code(int n, int channels, float *out);

/* A coarse map resized to full size, plus the maps that the graph adds to it. */
struct dpt_blend {
    struct layer_resize map; // out_h = out_w where there is a code
    const float *plus;       // (out_h, out_w, c) or NULL
    const float *code;       // dpt_code(out_w, c) or NULL
};

/* The layer_fetch_fn of a struct dpt_blend: resized map + plus + code. */
layer_fetch_fn dpt_blend_fetch;

/* The whole blend as a map.
 * out:  (out_h, out_w, c), with relu after a ReLU; must not overlap the inputs.
 * err:  ERR_CANCELLED. */
MUST_USE err_t dpt_blend_run(const struct run *r, const struct dpt_blend *b, bool relu, float *out);

#endif
