#define SIMD_C
#include "core/kernels/fft_body.h"

void fft_c(struct gemm_kernels *k)
{
    fft_fill(k);
}
