#include "core/base/plan.h"

#include <stdint.h>

struct plan plan_begin(int threads)
{
    return (struct plan){.keep = arena_counter(), .tmp = arena_counter(), .threads = threads};
}

void plan_refuse(struct plan *p)
{
    p->keep.peak = p->tmp.peak = SIZE_MAX;
}
