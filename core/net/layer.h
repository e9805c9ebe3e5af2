/* layer.h - matrix products and convolutions of the network on blocks of rows, in the precision
 * of their weights: floats stay floats; with I8 weights each row of activations (of a convolution:
 * each tile) is quantised to s8 with its own scale (gemm.h), unless the caller requests floats.
 * Maps have channels last: (h, w, c). Pure computation.
 * Invariant: results do not depend on the number of threads. */
#ifndef NET_LAYER_H
#define NET_LAYER_H

#include "core/base/plan.h"
#include "core/net/conv.h"

enum {
    LAYER_ROWS = 64,   // rows that a worker takes through a product at a time
    LAYER_TILE_W = 64, // px, tile of a convolution
    LAYER_TILE_H = 16
};

/* Scratch of one worker. */
struct layer_workspace {
    int8_t *q;      // (LAYER_ROWS, k) quantised rows, or a quantised tile
    float *rotated; // (k) a row on its way through the Hadamard transform
    float *scale;   // (LAYER_ROWS)
    union {
        int32_t *c; // (LAYER_ROWS, 4 PANEL) sums
        float *cf;  // for floats
    };
    float *panel; // weights as floats, some panels and inputs at a time
};

/* A room for products of at most k inputs. */
MUST_USE err_t layer_workspace_init(struct layer_workspace *room, struct arena *a, int k);

/* Rooms for all workers of the pool. */
MUST_USE err_t layer_workspaces_init(struct arena *a, int threads, int k,
                                     struct layer_workspace **out);

/* Rows of activations. */
struct layer_in {
    const float *x; // (m, k)
    size_t ldx;
    int m;       // any
    bool floats; // do not quantise, whatever the weights
};

/* One product on the calling thread. x and out must not overlap. */
void layer_rows(const struct gemm_kernels *k, const struct weight *w, const struct layer_in *in,
                const struct layer_out *out, struct layer_workspace *room);

/* The same over the pool, LAYER_ROWS rows a chunk.
 * err:  ERR_NOMEM (r->tmp, see layer_plan), ERR_CANCELLED. */
MUST_USE err_t layer_run(const struct run *r, const struct weight *w, const struct layer_in *in,
                         const struct layer_out *out);

/* Count the memory of layer_run for products of k inputs. */
void layer_plan(struct plan *p, int k);

/* out->out: (out_h, out_w, n) with ldo from pixel to pixel; `add` as above.
 * err:  ERR_NOMEM (r->tmp, see layer_conv_plan), ERR_CANCELLED. */
MUST_USE err_t layer_conv_run(const struct run *r, const struct layer_conv *c,
                              const struct layer_out *out);

/* Count the memory of layer_conv_run. */
void layer_conv_plan(struct plan *p, const struct layer_conv *c);

/* A fetch for a plain map: ctx is a struct layer_map. */
struct layer_map {
    const float *px; // (h, w, c)
    int w, c;
    bool relu;
};
layer_fetch_fn layer_map_fetch;

/* Bilinear resize of a (h, w, c) map seen as a map of (out_h, out_w); ctx of layer_resize_fetch.
 * align: corners fall on corners; else pixel centres are spread evenly (core/net/README.md 1.1). */
struct layer_resize {
    const float *px;
    int h, w, c, out_h, out_w;
    bool align;
};
layer_fetch_fn layer_resize_fetch;

#endif
