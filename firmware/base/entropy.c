#include "firmware/base/entropy.h"

#include <sys/random.h>

err_t entropy_fill(void *p, size_t n)
{
    return getrandom(p, n, 0) == (ssize_t)n ? OK : err_fail(ERR_IO, "no random numbers");
}
