/* smooth.h - moves outliers of activations into the weights that read them, before both become
 * integers (Xiao et al. 2023, SmoothQuant, with strength 1/2). Channel c of an activation is
 * divided by s_c = sqrt(a_c / w_c), the weights that read it are multiplied by it; a_c and w_c are
 * the largest values on both sides. The function of the network stays as it is.
 * Three activations of a transformer block and one of a DPT trunk allow it without cost at run
 * time, and their a_c follows from the weights alone, so that no pictures are needed:
 *   norm1 -> qkv, norm2 -> fc1, norm -> projects   a layer norm has |x_c| <~ 3 |gain_c| + |bias_c|
 *   v -> proj                                      attention averages rows of W_v norm1(x) + b
 * thread: one. */
#ifndef RECON_SMOOTH_H
#define RECON_SMOOTH_H

#include "drivers/format/modelwrite.h"

struct smooth_group;

struct smooth {
    const struct net_dims *dims;
    modelwrite_fetch *fetch; // fetches the weights as they are
    void *ctx;
    struct smooth_group *groups; // found so far; own: smooth_free
};

/* The values of t with the factors in them; ctx is a struct smooth.
 * err:  those of fetch, ERR_NOMEM. */
modelwrite_fetch smooth_fetch;

/* Accepts a zeroed struct. */
void smooth_free(struct smooth *s);

#endif
