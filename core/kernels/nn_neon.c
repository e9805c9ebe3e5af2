#define SIMD_NEON
#include "core/kernels/nn_body.h"

void nn_neon(struct gemm_kernels *k)
{
    nn_fill(k);
}
