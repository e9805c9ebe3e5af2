/* num.h - the smaller and the larger of two numbers, the middle of many. thread: any. */
#ifndef BASE_NUM_H
#define BASE_NUM_H

#include <stddef.h>

static inline int num_min(int a, int b)
{
    return a < b ? a : b;
}

static inline size_t num_max_size(size_t a, size_t b)
{
    return a > b ? a : b;
}

/* Upper median of n finite numbers, which are sorted; 0 if there are none. */
float num_median(float *v, size_t n);

#endif
