#include "core/base/num.h"

#include <stdlib.h>

static int ascending(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

float num_quantile(float *v, size_t n, float share)
{
    const size_t i = (size_t)((double)share * (double)n);
    if (n == 0)
        return 0;
    qsort(v, n, sizeof *v, ascending);
    return v[i < n ? i : n - 1];
}
