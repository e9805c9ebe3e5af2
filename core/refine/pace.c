#include "core/refine/pace.h"

int pace_level(int step, int steps, int levels)
{
    if (levels < 2 || 3 * step < steps)
        return levels - 1;
    return levels - 2 - (int)((3LL * step - steps) * (levels - 1) / (2LL * steps));
}

double pace_seconds(const struct pace *p, int from, int steps)
{
    double sum = 0;
    for (int i = from; i < steps; i++)
        sum += p->seconds[pace_level(i, steps, p->levels)];
    return sum;
}

/* A longer schedule may take less from a step on, as it sees small pictures for longer: so it is
 * shortened until it fits, not bisected. */
int pace_fit(const struct pace *p, int from, int steps, double seconds)
{
    while (steps > from && pace_seconds(p, from, steps) > seconds)
        steps -= 1 + (steps - from) / 64;
    return steps;
}
