/* conv.h - what a convolution is asked for, whichever way it is done (layer.h, fftconv.h). */
#ifndef NET_CONV_H
#define NET_CONV_H

#include "core/kernels/kernels.h"
#include "core/net/model.h"

/* Where results go: act(W x + b), stored, or with add: out += gamma act(W x + b). */
struct layer_out {
    float *out; // (m, n)
    size_t ldo;
    enum activation act;
    bool add;
    const float *gamma; // (n) or NULL: 1; only with add
};

/* Writes n pixels of the input map from (y, x) on, (n, channels); always inside the map.
 * thread: any. */
typedef void layer_fetch_fn(const void *ctx, int y, int x, int n, float *out);

/* A convolution with zero padding. Output (y, x) sees inputs from (y stride - pad, x stride - pad).
 * The input is asked for tile by tile, so that what makes it (a resize, a sum, a ReLU) needs no map
 * of its own; pixels at tile borders are asked for more than once. */
struct layer_conv {
    const struct weight *w; // segs = kh, seg = kw channels
    int kh, kw, stride, pad, channels;
    int h, w_px; // of the input
    layer_fetch_fn *fetch;
    const void *ctx;
    bool floats;
};

/* Size of its output: floor((in + 2 pad - kernel) / stride) + 1. */
static inline int conv_size(int in, int kernel, int stride, int pad)
{
    return (in + 2 * pad - kernel) / stride + 1;
}

#endif
