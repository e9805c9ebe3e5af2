/* some_of.h - many alike cases. Sanitizers look at what code does, are five times slower, and need
 * not see all of them. */
#ifndef UNIT_SOME_OF_H
#define UNIT_SOME_OF_H

/* The step through cases: 1, with sanitizers n. */
static inline int some_of(int n)
{
#ifdef SANITIZED
    return n;
#else
    (void)n;
    return 1;
#endif
}

#endif
