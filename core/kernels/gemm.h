/* gemm.h - the contract of the inner loops of the network; part of kernels.h.
 * Products: rows of activations times packed weights (core/net/model.h), one run of rows and a few
 * panels at a time. Blocking, threads and scratch are in core/net/layer.c.
 * Integer kernels are exact: every variant gives the bits of the C reference. Float kernels differ
 * in the order of sums only.
 *
 * Quantisation, defined here once: symmetric, scale = max|x| / 127, integer = round half to even of
 * x * (127 / max|x|), in -127..127, 0 for NaN; where max|x| is below FLT_MIN all integers and the
 * scale are 0. Where 127 / max|x| is infinite, only signs remain. A value that is not finite
 * makes the scale and all results of its row not finite. Activations keep them so, and an overflow
 * reaches the check in core/net/finite.h. */
#ifndef KERNELS_GEMM_H
#define KERNELS_GEMM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { PANEL = 16 }; // outputs side by side in packed weights

/* c(i, 16 p + j) = sum over s < segs, l < seg of a[i lda + s seg_stride + l] w(p, s seg + l, j).
 * k = segs seg. Convolutions on (h, w, c) maps are products of this form: a row of output pixels,
 * seg = kw channels, seg_stride = a row of the padded map, lda = stride channels.
 * Bound of the sums: |a| <= 127, |w| <= 128, k <= 131072 fit in int32. */
struct gemm_s8 {
    int m, panels;   // rows >= 0; panels >= 1
    int segs, seg;   // runs >= 1; inputs of a run, a multiple of 4
    const int8_t *a; // -127..127
    size_t lda, seg_stride;
    const int8_t *w; // panels of (k/4, 16, 4)
    size_t ldw;      // from one panel to the next, >= 16 k
    int32_t *c;      // (m, 16 panels), overwritten
    size_t ldc;      // >= 16 panels
};
typedef void gemm_s8_fn(const struct gemm_s8 *g);

/* The same with floats; panels of (k, 16), seg >= 1 of any parity. */
struct gemm_f32 {
    int m, panels, segs, seg;
    const float *a;
    size_t lda, seg_stride;
    const float *w;
    size_t ldw;
    float *c;
    size_t ldc;
    bool add; // c += instead of c =
};
typedef void gemm_f32_fn(const struct gemm_f32 *g);

/* Inputs [0, k) of a panel as floats, (k, 16). I8: k is a multiple of 4, without scale. */
typedef void unpack_s8_fn(const int8_t *w, int k, float *out);
typedef void unpack_bf16_fn(const uint16_t *w, int k, float *out);

/* max |x| over n floats, 0 for n = 0; NaN if one of them is. */
typedef float absmax_fn(const float *x, size_t n);

/* n floats to integers with inverse scale inv = 127 / max, 0 for a zero row (see above). */
typedef void quant_fn(const float *x, size_t n, float inv, int8_t *out);

/* Rotate each run of `block` floats: negate those whose index i has an odd number of ones in
 * i & i >> 1 (Rudin and Shapiro's sequence), then multiply by the Hadamard matrix of that size over
 * sqrt(block), in place. Without the signs the mean of a run, times sqrt(block), would end in one
 * number; with them no number gets more than sqrt(2) of it.
 * block is a power of two >= 4, n a multiple of it. Every variant gives the bits of C. */
typedef void hadamard_fn(float *x, int n, int block);

/* y = (x - mean) / sqrt(var + eps) * gamma + beta over n values; gamma and beta NULL: 1 and 0.
 * For |x| < 1e15 within 1e-6 (1 + |y|), also where the mean is 1e6 times the deviation.
 * y may be x. */
struct norm {
    int n;
    float eps;
    const float *gamma, *beta; // (n)
};
typedef void norm_fn(const struct norm *s, const float *x, float *y);

/* As in core/net/README.md 1.1. */
enum activation { ACT_NONE, ACT_RELU, ACT_GELU, ACT_SILU };

/* Applied to a block of a product's sums: v = act(sum * row_scale * scale + bias); then
 * out = v, or out += gamma v (gamma NULL: 1) when `add`. GELU of v is within 5e-7 |v|. */
struct epilogue {
    int m, n;          // rows, columns that count
    const int32_t *ci; // (m, n) sums of gemm_s8, or NULL
    const float *cf;   // (m, n) sums of gemm_f32 if ci is NULL
    size_t ldc;
    const float *row_scale; // (m) or NULL: 1
    const float *scale;     // (n) or NULL: 1
    const float *bias;      // (n) or NULL: 0
    const float *gamma;     // (n) or NULL: 1; only with add
    enum activation act;
    bool add;
    float *out;
    size_t ldo;
};
typedef void epilogue_fn(const struct epilogue *e);

/* q or k of one token and head, in place: layer norm over the n channels if gamma is not NULL
 * (eps 1e-5), copied to `before` unless NULL, then rotary embedding unless cosine is NULL: the
 * first half of the channels rotates with the row position, the second with the column; inside each
 * half pairs (i, i + n/4) (core/net/README.md 2.3).
 * cosine, sine: (n/2) row angles (n/4), then column angles (n/4). */
struct head_rotary {
    int n; // width of a head, a multiple of 16, at most 128
    const float *gamma, *beta;
    const float *cosine, *sine;
    float *before;
};
typedef void head_rotary_fn(const struct head_rotary *t, float *x);

/* One block of keys of streaming softmax attention (Milakov and Gimelshein 2018), rows independent.
 * Logits x_ij = s_ij row_scale_i key_scale_j. State per row: top = largest logit so far, sum =
 * sum of exp(x - top).
 * I8 (si not NULL): p = round(254 exp(x - max of this block's row) - 127), so that a byte carries
 * 254 steps; attend_add puts the 127 back. The sum adds the rounded values, so that rounding does
 * not change the total weight. p is within 0.55 of the exact number, so variants differ by at most
 * 1. Logits must be finite; beyond 4e4 only the largest ones count.
 * F32: p = exp(x - new top).
 * out: rescale_i multiplies the sums accumulated before; weigh_i multiplies the sums of p and v of
 *      this block (1 for F32). */
struct attend_block {
    int m, n;          // rows; keys of this block, >= 1
    const int32_t *si; // (m, n) q k^T of integers, or NULL
    const float *sf;   // (m, n) of floats; may be pf
    size_t lds;
    const float *row_scale; // (m), >= 0, with 1/sqrt(width) in it
    const float *key_scale; // (n) or NULL: 1
    float *top, *sum;       // (m), -INFINITY and 0 at the start
    int8_t *pi;             // (m, n) if si; the columns up to the next multiple of 4 become 0
    float *pf;              // (m, n) if sf
    size_t ldp;
    float *rescale, *weigh; // (m)
};
typedef void attend_block_fn(const struct attend_block *b);

/* o_ij = o_ij rescale_i + weigh_i value_scale_j (c_ij + shift_j); value_scale NULL: 1. ci or cf as
 * above. */
struct attend_add {
    int m, n;
    const int32_t *ci;
    const float *cf;
    size_t ldc;
    const float *rescale, *weigh, *value_scale;
    const int32_t *shift; // (n) with ci: 127 times the sum of the block's integers of v
    float *o;
    size_t ldo;
};
typedef void attend_add_fn(const struct attend_add *a);

/* Fourier transform of 16 x 16 tiles, one per channel, for convolutions (core/net/fftconv.h).
 * A real tile has FFT_BINS complex frequencies and FFT_REALS real ones. In `planes` frequency b is
 * at plane 3 b + {0, 1, 2} and real one r at plane 3 FFT_BINS + r. */
enum { FFT_EDGE = 16, FFT_BINS = 126, FFT_REALS = 4, FFT_PLANES = 3 * FFT_BINS + FFT_REALS };

struct fft_tile {
    int n;            // channels, a multiple of 16
    float *px;        // pixel (y, x), channel c at y row + x step + c
    size_t row, step; // elements
    int edge;         // inverse: rows and columns to write, from the first; <= FFT_EDGE
    float *planes;    // plane p, channel c at p plane + c
    size_t plane;
};
/* Planes of a frequency: real part, imaginary part, their sum. Reads px (FFT_EDGE^2). */
typedef void fft_forward_fn(const struct fft_tile *t);
/* Planes of a frequency: y0, y1, y2 with real part y2 - y1, imaginary part y2 + y0 (the three
 * products of Gauss's complex multiplication). Not divided by 256. Writes px (edge^2). */
typedef void fft_inverse_fn(const struct fft_tile *t);

struct gemm_kernels {
    const char *s8_name, *f32_name; // instruction sets of the two products
    gemm_s8_fn *s8;
    gemm_f32_fn *f32;
    unpack_s8_fn *unpack_s8;
    unpack_bf16_fn *unpack_bf16;
    absmax_fn *absmax;
    quant_fn *quant;
    hadamard_fn *hadamard;
    norm_fn *norm;
    epilogue_fn *epilogue;
    head_rotary_fn *head_rotary;
    attend_block_fn *attend_block;
    attend_add_fn *attend_add;
    bool s8_beats_fft; // products in s8 are over ten times as fast as in floats (fftconv.h)
    fft_forward_fn *fft_forward;
    fft_inverse_fn *fft_inverse;
};

#endif
