/* num.h - small mathematics for several rooms: pi, minimum and maximum, quantiles.
 * thread: any. */
#ifndef BASE_NUM_H
#define BASE_NUM_H

#include <math.h>
#include <stddef.h>

#define NUM_PI 3.14159265358979323846

static inline int num_min(int a, int b)
{
    return a < b ? a : b;
}

static inline int num_max(int a, int b)
{
    return a > b ? a : b;
}

static inline size_t num_max_size(size_t a, size_t b)
{
    return a > b ? a : b;
}

/* Quantile `share` (0..1) of n finite numbers, which it sorts; 0 if there are none. */
float num_quantile(float *v, size_t n, float share);

/* The same of numbers that are sorted already. */
float num_sorted_quantile(const float *v, size_t n, float share);

/* Upper median. */
static inline float num_median(float *v, size_t n)
{
    return num_quantile(v, n, 0.5f);
}

/* The x whose logistic function is v, 0 < v < 1. */
static inline double num_logit(double v)
{
    return log(v / (1 - v));
}

#endif
