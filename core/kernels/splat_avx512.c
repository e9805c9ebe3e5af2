#define SIMD_AVX512
#include "core/kernels/splat_body.h"

void splat_avx512(struct kernels *k)
{
    splat_fill(k);
    k->name = "avx512";
}
