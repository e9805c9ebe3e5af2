#include "core/base/num.h"

#include <stdlib.h>

static int ascending(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

float num_of_sorted(const float *v, size_t n, float share)
{
    const size_t i = (size_t)((double)share * (double)n);
    return n == 0 ? 0 : v[i < n ? i : n - 1];
}

float num_quantile(float *v, size_t n, float share)
{
    if (n > 0)
        qsort(v, n, sizeof *v, ascending);
    return num_of_sorted(v, n, share);
}
