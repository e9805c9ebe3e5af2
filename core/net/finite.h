/* finite.h - outputs of a stage of the network must be in the range that the next one can process.
 * Where weights are within CONVERT_WEIGHT_MAX (firmware/recon/convert.c), nothing inside a
 * transformer block overflows as long as its inputs are within FINITE_MAX. Maps of convolutions
 * keep overflowed values (core/kernels/gemm.h) until their stage ends, where this check finds them.
 * thread: any. */
#ifndef NET_FINITE_H
#define NET_FINITE_H

#include "core/base/types.h"

/* The sum of 8192 squares, for the widest norm, is below FLT_MAX. */
#define FINITE_MAX 0x1p57f

/* Check that the n output floats of `stage` are within +-most, FINITE_MAX where a norm may follow.
 * err:  ERR_FORMAT names the stage, the element and the bound. */
MUST_USE err_t finite_check(const struct run *r, const char *stage, float most, const float *x,
                            size_t n);

#endif
