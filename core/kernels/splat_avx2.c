#define SIMD_AVX2
#include "core/kernels/splat_body.h"

void splat_avx2(struct kernels *k)
{
    splat_fill(k);
    k->name = "avx2";
}
