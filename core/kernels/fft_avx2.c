#define SIMD_AVX2
#include "core/kernels/fft_body.h"

void fft_avx2(struct gemm_kernels *k)
{
    fft_fill(k);
}
