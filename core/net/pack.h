/* pack.h - products of a checkpoint brought into the order of a weights file (core/net/model.h).
 * I8: each output has the scale max|w| / 127 and integers by the rule of core/kernels/gemm.h; those
 * of a convolution's kernel pass their rounding error on to the next of the same input channel, so
 * that their sum is right. BF16: round to nearest even, saturating. Pure computation; thread: any.
 */
#ifndef NET_PACK_H
#define NET_PACK_H

#include "core/net/model.h"

/* Panels of product t and bytes of one of them. */
int pack_panels(const struct tensor_spec *t);
size_t pack_panel_bytes(const struct tensor_spec *t, enum precision type);

struct pack {
    float *row;   // scratch, (k)
    void *out;    // pack_panel_bytes of them
    float *scale; // I8: of the panel's outputs below n
};

/* Pack panel p of a tensor whose values are in the order of the checkpoint, finite. */
void pack_panel(const struct tensor_spec *t, enum precision type, int p, const float *in,
                const struct pack *to);

#endif
