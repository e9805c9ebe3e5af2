/* conv.h - description of a convolution for both implementations (layer.h, fftconv.h). */
#ifndef NET_CONV_H
#define NET_CONV_H

#include "core/kernels/kernels.h"
#include "core/net/model.h"

/* Destination of results: act(W x + b), stored, or with add: out += gamma act(W x + b). */
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

/* A convolution with zero padding. Output (y, x) reads inputs from (y stride - pad, x stride -
 * pad). The input is fetched tile by tile, so that a resize, a sum or a ReLU before it needs no map
 * of its own; pixels at tile borders are fetched more than once. */
struct layer_conv {
    const struct weight *w; // segs = kh, seg = kw channels
    int kh, kw, stride, pad, channels;
    int h, w_px; // input size
    layer_fetch_fn *fetch;
    const void *ctx;
    bool floats;
};

/* The 3 x 3 convolution of w over a map of (h, w_px), padded by 1; the caller sets the rest. */
static inline struct layer_conv conv_3x3(const struct weight *w, int h, int w_px, int stride)
{
    return (struct layer_conv){.w = w,
                               .kh = 3,
                               .kw = 3,
                               .stride = stride,
                               .pad = 1,
                               .channels = w->seg / 3,
                               .h = h,
                               .w_px = w_px};
}

/* Size of its output: floor((in + 2 pad - kernel) / stride) + 1. */
static inline int conv_size(int in, int kernel, int stride, int pad)
{
    return (in + 2 * pad - kernel) / stride + 1;
}

#endif
