/* tap.h - passes intermediate tensors to run.tap, under the names of the golden sets. Without a tap
 * it does nothing. thread: any. */
#ifndef NET_TAP_H
#define NET_TAP_H

#include "core/base/types.h"

static inline bool tap_on(const struct run *r)
{
    return r->tap != NULL;
}

/* Hand over t; data or ints is the first element of the piece. Strides that are all zero mean C
 * order of the whole tensor. parts = 0 counts as 1. */
void tap_put(const struct run *r, const struct tap_tensor *t);

/* A map of one view, hwc[0] x hwc[1] with hwc[2] channels last, as piece `view` of the tensor
 * (n_views, channels, h, w). */
void tap_map(const struct run *r, const char *name, int view, int n_views, const int hwc[3],
             const float *px);

#endif
