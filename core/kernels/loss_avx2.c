#define SIMD_AVX2
#include "core/kernels/loss_body.h"

void loss_avx2(struct kernels *k)
{
    loss_fill(k);
}
