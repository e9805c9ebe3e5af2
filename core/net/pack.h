/* pack.h - products of a checkpoint brought into the order of a weights file (core/net/model.h).
 * I8: each output has the scale max|w| / 127 and integers by the rule of kernels/gemm.h. BF16:
 * round to nearest even, saturating. Pure computation; thread: any. */
#ifndef NET_PACK_H
#define NET_PACK_H

#include "core/net/model.h"

/* Panels of product t and bytes of one of them. */
int pack_panels(const struct tensor_spec *t);
size_t pack_panel_bytes(const struct tensor_spec *t, enum precision type);

/* Pack panel p.
 * in:   the whole tensor in the order of the checkpoint, finite.
 * row:  scratch, (k) floats.
 * out:  pack_panel_bytes; scale: of I8, those of the panel's outputs below n, from scale[0] on. */
void pack_panel(const struct tensor_spec *t, enum precision type, int p, const float *in,
                float *row, void *out, float *scale);

#endif
