/* finite.h - what a stage of the network gives must be numbers that the next one can work with.
 * Where weights are within CONVERT_WEIGHT_MAX (firmware/recon/convert.c), nothing inside a
 * transformer block overflows as long as what goes in is within FINITE_MAX; maps of convolutions
 * keep what overflowed (core/kernels/gemm.h) until their stage ends. So it is seen here.
 * thread: any. */
#ifndef NET_FINITE_H
#define NET_FINITE_H

#include "core/base/types.h"

/* The squares of 8192 of them, the widest norm, are together below FLT_MAX. */
#define FINITE_MAX 0x1p57f

/* Whether the n floats that `stage` gives are within +-most, FINITE_MAX where a norm may follow.
 * err:  ERR_FORMAT names the stage, the element and the bound. */
MUST_USE err_t finite_check(const struct run *r, const char *stage, float most, const float *x,
                            size_t n);

#endif
