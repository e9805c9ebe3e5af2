#define SIMD_AVX2
#include "core/kernels/nn_body.h"

void nn_avx2(struct gemm_kernels *k)
{
    nn_fill(k);
}
