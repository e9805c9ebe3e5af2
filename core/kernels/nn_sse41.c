#define SIMD_SSE41
#include "core/kernels/nn_body.h"

void nn_sse41(struct gemm_kernels *k)
{
    nn_fill(k);
}
