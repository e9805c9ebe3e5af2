#define SIMD_C
#include "core/kernels/splat_body.h"

void splat_c(struct kernels *k)
{
    splat_fill(k);
    k->name = "plain C";
}
