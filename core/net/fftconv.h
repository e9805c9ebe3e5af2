/* fftconv.h - convolutions of stride 1 in the frequency domain, in float arithmetic for all types
 * of weights. With tiles of 16 x 16 a 7 x 7 kernel takes 3.8 products per output where the direct
 * form takes 49: faster than int8 products wherever these are less than about ten times as fast as
 * float ones, and exact. Called by layer_conv_run, with the same contract. */
#ifndef NET_FFTCONV_H
#define NET_FFTCONV_H

#include "core/base/plan.h"
#include "core/net/conv.h"

/* Whether this form exists for c: kernels 5 to 9 px wide, outputs and channels multiples of 16. */
bool fftconv_possible(const struct layer_conv *c);

/* Count the memory of fftconv_run. */
void fftconv_plan(struct plan *p, const struct layer_conv *c);

MUST_USE err_t fftconv_run(const struct run *r, const struct layer_conv *c,
                           const struct layer_out *out);

#endif
