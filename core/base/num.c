#include "core/base/num.h"

#include <stdlib.h>

static int compare_floats(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

float num_sorted_quantile(const float *v, size_t n, float share)
{
    const size_t i = (size_t)((double)share * (double)n);
    return n == 0 ? 0 : v[i < n ? i : n - 1];
}

float num_quantile(float *v, size_t n, float share)
{
    if (n > 0)
        qsort(v, n, sizeof *v, compare_floats);
    return num_sorted_quantile(v, n, share);
}
