#include "core/base/arena.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__SANITIZE_ADDRESS__) // gcc
#define ARENA_ASAN 1
#elif defined(__has_feature) // clang
#if __has_feature(address_sanitizer)
#define ARENA_ASAN 1
#endif
#endif

#if defined(ARENA_ASAN)
#include <sanitizer/asan_interface.h>
#define POISON(p, n) ASAN_POISON_MEMORY_REGION(p, n)
#define UNPOISON(p, n) ASAN_UNPOISON_MEMORY_REGION(p, n)
#define REDZONE ARENA_ALIGN // poisoned bytes after each allocation
#else
#define POISON(p, n) ((void)(p), (void)(n))
#define UNPOISON(p, n) ((void)(p), (void)(n))
#define REDZONE 0
#endif

err_t arena_init(struct arena *a, const char *name, size_t size)
{
    memset(a, 0, sizeof *a);
    a->name = name;
    size_t rounded = arena_need(size, 1);
    if (rounded == SIZE_MAX)
        return err_fail(ERR_NOMEM, "%s: %zu bytes overflow the address space", name, size);
    a->base = aligned_alloc(ARENA_ALIGN, rounded ? rounded : ARENA_ALIGN);
    if (!a->base)
        return err_fail(ERR_NOMEM, "%s: the system refused %zu bytes", name, size);
    a->size = rounded;
    POISON(a->base, a->size);
    return OK;
}

struct arena arena_counter(void)
{
    return (struct arena){.size = SIZE_MAX, .name = "plan", .counts = true};
}

void arena_step(struct arena *a, size_t bytes)
{
    size_t top = arena_add(a->used, bytes);
    if (top > a->peak)
        a->peak = top;
}

void arena_free(struct arena *a)
{
    if (a->base)
        UNPOISON(a->base, a->size);
    free(a->base);
    memset(a, 0, sizeof *a);
}

size_t arena_need(size_t n, size_t elem)
{
    size_t bytes;
    if (__builtin_mul_overflow(n, elem, &bytes) || bytes > SIZE_MAX - ARENA_ALIGN - REDZONE)
        return SIZE_MAX;
    return (bytes + ARENA_ALIGN - 1) / ARENA_ALIGN * ARENA_ALIGN + REDZONE;
}

size_t arena_add(size_t a, size_t b)
{
    return a > SIZE_MAX - b ? SIZE_MAX : a + b;
}

void arena_hold(struct arena *a, size_t bytes)
{
    arena_step(a, bytes);
    a->used = arena_add(a->used, bytes);
}

/* *out points to the middle of the address space, where nothing is mapped. */
static err_t count_allocation(struct arena *a, size_t need, void *out)
{
    uintptr_t nowhere = UINTPTR_MAX / 2 + 1;
    memcpy(out, &nowhere, sizeof nowhere);
    arena_hold(a, need);
    return OK;
}

err_t arena_alloc(struct arena *a, size_t n, size_t elem, void *out)
{
    size_t need = arena_need(n, elem);
    if (a->counts)
        return count_allocation(a, need, out);
    memset(out, 0, sizeof(void *));
    if (need > a->size - a->used)
        return err_fail(ERR_NOMEM, "%s arena: %zu x %zu bytes requested, %zu of %zu are free",
                        a->name, n, elem, a->size - a->used, a->size);
    void *p = a->base + a->used;
    a->used += need;
    if (a->used > a->peak)
        a->peak = a->used;
    UNPOISON(p, n * elem);
    memcpy(out, &p, sizeof p);
    return OK;
}

err_t arena_zalloc(struct arena *a, size_t n, size_t elem, void *out)
{
    err_t e = arena_alloc(a, n, elem, out);
    if (e || a->counts)
        return e;
    void *p;
    memcpy(&p, out, sizeof p);
    memset(p, 0, n * elem);
    return OK;
}

size_t arena_mark(const struct arena *a)
{
    return a->used;
}

void arena_reset(struct arena *a, size_t mark)
{
    if (mark >= a->used)
        return;
    if (!a->counts)
        POISON(a->base + mark, a->used - mark);
    a->used = mark;
}
