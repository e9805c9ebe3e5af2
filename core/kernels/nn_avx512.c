#define SIMD_AVX512
#include "core/kernels/nn_body.h"

void nn_avx512(struct gemm_kernels *k)
{
    nn_fill(k);
}
