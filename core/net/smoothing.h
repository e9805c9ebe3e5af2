/* smoothing.h - moves outliers of activations into the weights that read them, before both become
 * integers (Xiao et al. 2023, SmoothQuant, with strength 1/2). Channel c of an activation is
 * divided by s_c = sqrt(a_c / w_c), the weights that read it are multiplied by it; a_c and w_c are
 * the largest values on both sides. The function of the network stays as it is.
 * Three activations of a transformer block and one of a DPT trunk allow it without cost at run
 * time, and their a_c follows from the weights alone, so that no pictures are needed:
 *   norm1 -> qkv, norm2 -> fc1, norm -> projects   a layer norm has |x_c| <~ 3 |gain_c| + |bias_c|
 *   v -> proj                                      attention averages rows of W_v norm1(x) + b
 * Pure computation; thread: any. */
#ifndef NET_SMOOTHING_H
#define NET_SMOOTHING_H

#include <stdbool.h>
#include <stddef.h>

/* The factors of a block; a trunk has those of its norm, SMOOTHING_NORM1, only. */
enum smoothing_factors { SMOOTHING_NORM1, SMOOTHING_VALUE, SMOOTHING_NORM2, SMOOTHING_FACTORS };

/* How a tensor takes part. */
struct smoothing_use {
    enum smoothing_factors factors;
    bool divided;  // entries or rows by their factor, else columns are multiplied
    bool value;    // only the last third of the rows
    bool block;    // in a transformer block, else in a DPT trunk
    size_t prefix; // bytes of its name that all names of the block or trunk begin with
};

enum { SMOOTHING_USES_MAX = 2 };

/* The ways in which the tensor `name` takes part, in the order to apply them; returns how many. */
int smoothing_uses(const char *name, struct smoothing_use out[SMOOTHING_USES_MAX]);

/* A layer norm over c channels. */
struct smoothing_source {
    const float *gain, *bias;
    int c;
};

/* A matrix that reads it, row-major. */
struct smoothing_reader {
    const float *w; // (rows, c)
    size_t rows;
};

/* Factors s (c) of a layer norm that n matrices read. scratch: (2, c). */
void smoothing_norm(const struct smoothing_source *norm, const struct smoothing_reader *reader,
                    int n, float *scratch, float *s);

/* Factors s (c) of the values of an attention: the rows of v in w (c, c) and b (c), behind the
 * norm, which proj (c, c) reads. scratch: (2, c). */
void smoothing_value(const struct smoothing_source *norm, const float *w, const float *b,
                     const float *proj, float *scratch, float *s);

/* Apply the factors s (c) to the n values x of a tensor. */
void smoothing_apply(const struct smoothing_use *u, const float *s, int c, float *x, size_t n);

#endif
