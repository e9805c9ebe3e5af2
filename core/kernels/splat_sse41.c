#define SIMD_SSE41
#include "core/kernels/splat_body.h"

void splat_sse41(struct kernels *k)
{
    splat_fill(k);
    k->name = "sse4.1";
}
