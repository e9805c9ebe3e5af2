#include "core/net/finite.h"

#include <math.h>
#include <string.h>

enum { CHUNK = 1 << 18 }; // floats

struct job {
    const char *stage;
    float most;
    const float *x;
    size_t n;
};

/* Without their sign, floats compare like their bits as integers; infinities and NaN are last. */
static bool any_beyond(float most, const float *x, size_t n)
{
    int32_t limit, beyond = 0;
    memcpy(&limit, &most, sizeof limit);
    for (size_t i = 0; i < n; i++) {
        int32_t bits;
        memcpy(&bits, x + i, sizeof bits);
        beyond |= (bits & INT32_MAX) > limit;
    }
    return beyond != 0;
}

static err_t check_chunk(void *ctx, int chunk, int worker)
{
    const struct job *j = ctx;
    size_t at = (size_t)chunk * CHUNK, end = j->n - at < CHUNK ? j->n : at + CHUNK;
    (void)worker;
    if (!any_beyond(j->most, j->x + at, end - at))
        return OK;
    while (fabsf(j->x[at]) <= j->most)
        at++;
    return err_fail(ERR_FORMAT,
                    "the network overflows: element %zu of its %s is %g, allowed are %g to %g; its "
                    "weights are damaged or of another network: convert them again, or take "
                    "another model",
                    at, j->stage, (double)j->x[at], -(double)j->most, (double)j->most);
}

err_t finite_check(const struct run *r, const char *stage, float most, const float *x, size_t n)
{
    struct job j = {stage, most, x, n};
    return pool_for(r->pool, (int)((n + CHUNK - 1) / CHUNK), check_chunk, &j);
}
