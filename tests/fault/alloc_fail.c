#include "tests/fault/alloc_fail.h"

#include <errno.h>
#include <malloc.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

/* glibc's own allocator under its second name. */
void *__libc_malloc(size_t size);
void *__libc_calloc(size_t n, size_t size);
void *__libc_realloc(void *p, size_t size);
void *__libc_memalign(size_t align, size_t size);
void __libc_free(void *p);

static atomic_long alive;            // blocks
static atomic_long until_fails = -1; // allocations before the failing one; below 0: none fails

static bool fails(void)
{
    if (atomic_load(&until_fails) < 0 || atomic_fetch_sub(&until_fails, 1) != 0)
        return false;
    errno = ENOMEM;
    return true;
}

static void *counted(void *p)
{
    if (p)
        atomic_fetch_add(&alive, 1);
    return p;
}

void *malloc(size_t size)
{
    return fails() ? NULL : counted(__libc_malloc(size));
}

void *calloc(size_t n, size_t size)
{
    return fails() ? NULL : counted(__libc_calloc(n, size));
}

void *realloc(void *p, size_t size)
{
    if (!p)
        return malloc(size);
    if (size == 0) {
        free(p);
        return NULL;
    }
    return fails() ? NULL : __libc_realloc(p, size);
}

void *reallocarray(void *p, size_t n, size_t size)
{
    size_t bytes;
    if (__builtin_mul_overflow(n, size, &bytes)) {
        errno = ENOMEM;
        return NULL;
    }
    return realloc(p, bytes);
}

void *aligned_alloc(size_t align, size_t size)
{
    return fails() ? NULL : counted(__libc_memalign(align, size));
}

void *memalign(size_t align, size_t size)
{
    return aligned_alloc(align, size);
}

int posix_memalign(void **out, size_t align, size_t size)
{
    void *p = aligned_alloc(align, size);
    if (!p)
        return ENOMEM;
    *out = p;
    return 0;
}

void free(void *p)
{
    if (p)
        atomic_fetch_sub(&alive, 1);
    __libc_free(p);
}

/* One run with allocation n failing; n < 0: none. *ended: the run did not reach it. */
static bool run_is_clean(alloc_fail_fn *fn, void *ctx, long n, err_t *e, bool *ended)
{
    long before = atomic_load(&alive);
    *e = err_fail(OK, "%s", "");
    atomic_store(&until_fails, n);
    *e = fn(ctx);
    *ended = atomic_exchange(&until_fails, -1) >= 0 || n < 0;
    long left = atomic_load(&alive) - before;
    bool silent = *e && !*err_text(), refused_for_nothing = *e && *ended;
    if (!silent && !refused_for_nothing && (left == 0 || n < 0))
        return true;
    fprintf(stderr, "allocation %ld failed: error %d \"%s\", %ld blocks left\n", n, *e, err_text(),
            left);
    return false;
}

int alloc_fail_sweep(alloc_fail_fn *fn, void *ctx)
{
    err_t e;
    bool ended;
    if (!run_is_clean(fn, ctx, -1, &e, &ended)) // fills what libraries keep for ever
        return -1;
    int refused = 0;
    for (long n = 0;; n++) {
        if (!run_is_clean(fn, ctx, n, &e, &ended))
            return -1;
        if (ended)
            return refused;
        refused += e != OK;
    }
}
