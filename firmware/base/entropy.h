/* entropy.h - random bytes for secrets, from the kernel.
 * thread: any. */
#ifndef BASE_ENTROPY_H
#define BASE_ENTROPY_H

#include "core/base/err.h"

#include <stddef.h>

/* n: at most 256. err: ERR_IO */
MUST_USE err_t entropy_fill(void *p, size_t n);

#endif
