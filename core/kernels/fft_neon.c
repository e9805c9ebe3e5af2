#define SIMD_NEON
#include "core/kernels/fft_body.h"

void fft_neon(struct gemm_kernels *k)
{
    fft_fill(k);
}
