/* arena.h - memory planned before the work, carved while it runs.
 * One block per arena; allocations are pointer bumps, released together by arena_reset.
 * thread: one arena belongs to one thread at a time. */
#ifndef BASE_ARENA_H
#define BASE_ARENA_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>

#define ARENA_ALIGN 64 // bytes; alignment of every allocation

struct arena {
    unsigned char *base;
    size_t size, used, peak; // bytes
    const char *name;        // for sentences; not owned
    bool counts;             // has no block: allocations are only added up
};

/* Reserve `size` bytes.
 * own:  arena_free.
 * err:  ERR_NOMEM. */
MUST_USE err_t arena_init(struct arena *a, const char *name, size_t size);

/* An arena that only counts, for planning: the code that will allocate from a real arena allocates
 * from it, and its peak is the size that the real one needs; SIZE_MAX where that overflows. It is
 * never full. Its pointers may be stored and offset, but not dereferenced. */
struct arena arena_counter(void);

/* Count what was counted before: `bytes` that stay, or that a step takes above the present level
 * and gives back. */
void arena_hold(struct arena *a, size_t bytes);
void arena_step(struct arena *a, size_t bytes);

/* Accepts a zeroed arena. */
void arena_free(struct arena *a);

/* Carve n elements of `elem` bytes, not zeroed, aligned to ARENA_ALIGN.
 * out:  *out, valid until arena_reset below this point or arena_free; NULL on error.
 * err:  ERR_NOMEM if n*elem overflows or the arena is full (the sentence has name, request and
 *       free bytes). */
MUST_USE err_t arena_alloc(struct arena *a, size_t n, size_t elem, void *out);

/* As arena_alloc, zeroed. */
MUST_USE err_t arena_zalloc(struct arena *a, size_t n, size_t elem, void *out);

/* Bytes that arena_alloc(n, elem) takes, alignment included; SIZE_MAX if that overflows. */
size_t arena_need(size_t n, size_t elem);

/* Sum of two needs, SIZE_MAX on overflow. */
size_t arena_add(size_t a, size_t b);

/* Remember and restore a level: everything allocated after the mark is released. */
size_t arena_mark(const struct arena *a);
void arena_reset(struct arena *a, size_t mark);

#endif
