/* alloc_fail.h - makes one allocation fail, whoever asks for it: ours, a library's, the C
 * library's. alloc_fail.c defines malloc and its family for the whole program (glibc allows that
 * and keeps the originals under other names), counts what is alive and fails the chosen one. */
#ifndef FAULT_ALLOC_FAIL_H
#define FAULT_ALLOC_FAIL_H

#include "core/base/err.h"

/* Does its work and releases everything again, whether it succeeds or fails. */
typedef err_t alloc_fail_fn(void *ctx);

/* Run fn undisturbed, then with the 1st, 2nd, 3rd ... allocation failing, until it no longer
 * reaches the failing one. Each run must leave as many blocks alive as it found. A run may succeed
 * all the same (the C library often has a second way); when it does not, it must leave a sentence.
 * Returns the number of runs that were refused; -1 after a breach, which is described on stderr. */
int alloc_fail_sweep(alloc_fail_fn *fn, void *ctx);

#endif
