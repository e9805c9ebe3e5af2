#define SIMD_AVX512
#include "core/kernels/fft_body.h"

void fft_avx512(struct gemm_kernels *k)
{
    fft_fill(k);
}
