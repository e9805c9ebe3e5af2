#define SIMD_AVX512
#include "core/kernels/loss_body.h"

void loss_avx512(struct kernels *k)
{
    loss_fill(k);
}
