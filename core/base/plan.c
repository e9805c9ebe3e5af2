#include "core/base/plan.h"

#include <stdint.h>

struct plan plan_begin(int threads)
{
    return (struct plan){arena_counter(), arena_counter(), threads};
}

void plan_refuse(struct plan *p)
{
    p->keep.peak = p->tmp.peak = SIZE_MAX;
}
