#define SIMD_SSE41
#include "core/kernels/fft_body.h"

void fft_sse41(struct gemm_kernels *k)
{
    fft_fill(k);
}
