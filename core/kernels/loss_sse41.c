#define SIMD_SSE41
#include "core/kernels/loss_body.h"

void loss_sse41(struct kernels *k)
{
    loss_fill(k);
}
