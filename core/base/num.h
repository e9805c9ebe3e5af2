/* num.h - the smaller and the larger of two numbers. thread: any. */
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

#endif
