#define SIMD_NEON
#include "core/kernels/splat_body.h"

void splat_neon(struct kernels *k)
{
    splat_fill(k);
    k->name = "neon";
}
