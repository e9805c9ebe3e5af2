/* guard.h - memory and calls for functions that must stay inside their arrays. Every block lies
 * against an inaccessible page, behind its end or before its start, with a canary on the other
 * side; a call that hits such a page, or an instruction that this machine lacks, is caught.
 * For tests only; one thread. */
#ifndef KERNELS_GUARD_H
#define KERNELS_GUARD_H

#include <setjmp.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

enum {
    GUARD_BLOCKS = 112,
    GUARD_BYTES = 1 << 21, // largest block
    GUARD_MARGIN = 256     // bytes of canary on the open side
};

#define GUARD_CANARY 0x7fa5a5a5u // a NaN that no arithmetic makes

struct guard_block {
    uint8_t *room, *data; // room has GUARD_MARGIN + GUARD_BYTES, rounded up to pages
    size_t bytes;
};

static struct guard_block guard_blocks[GUARD_BLOCKS];
static int guard_used;
static bool guard_at_end;
static size_t guard_room;

static inline void guard_open(void)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    guard_room = (GUARD_BYTES + GUARD_MARGIN + page - 1) / page * page;
    for (int i = 0; i < GUARD_BLOCKS; i++) {
        uint8_t *p =
            mmap(NULL, guard_room + 2 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (p == MAP_FAILED || mprotect(p + page, guard_room, PROT_READ | PROT_WRITE) != 0) {
            perror("guarded memory");
            exit(1);
        }
        guard_blocks[i].room = p + page;
    }
}

/* Forget all blocks; new ones end (or start) at the inaccessible page. */
static inline void guard_reset(bool at_end)
{
    guard_used = 0;
    guard_at_end = at_end;
}

static inline void guard_fill(uint8_t *p, size_t bytes)
{
    const uint32_t word = GUARD_CANARY;
    for (size_t i = 0; i < bytes; i++)
        p[i] = (uint8_t)(word >> 8 * (i % 4));
}

/* A block filled with the canary, aligned no better than its size. */
static inline void *guard_alloc(size_t n, size_t elem)
{
    struct guard_block *b = &guard_blocks[guard_used++];
    b->bytes = n * elem;
    if (guard_used > GUARD_BLOCKS || b->bytes > GUARD_BYTES) {
        fprintf(stderr, "guard_alloc: block %d of %zu bytes\n", guard_used, b->bytes);
        exit(1);
    }
    b->data = guard_at_end ? b->room + guard_room - b->bytes : b->room;
    guard_fill(guard_at_end ? b->data - GUARD_MARGIN : b->data, b->bytes + GUARD_MARGIN);
    return b->data;
}

static inline bool guard_is_canary(const float *p)
{
    uint32_t word;
    memcpy(&word, p, sizeof word);
    return word == GUARD_CANARY;
}

/* Whether the open side of every block is as it was. */
static inline bool guard_intact(void)
{
    uint8_t want[GUARD_MARGIN];
    for (int i = 0; i < guard_used; i++) {
        const struct guard_block *b = &guard_blocks[i];
        size_t phase = guard_at_end ? 0 : b->bytes % 4;
        guard_fill(want, sizeof want);
        const uint8_t *side = guard_at_end ? b->data - GUARD_MARGIN : b->data + b->bytes - phase;
        if (memcmp(side + phase, want + phase, GUARD_MARGIN - phase) != 0)
            return false;
    }
    return true;
}

static sigjmp_buf guard_jump;
static volatile sig_atomic_t guard_armed;

static inline void guard_signal(int number)
{
    if (!guard_armed) {
        signal(number, SIG_DFL);
        raise(number);
        return;
    }
    guard_armed = 0;
    siglongjmp(guard_jump, number);
}

static inline void guard_trap(void)
{
    const int numbers[] = {SIGSEGV, SIGBUS, SIGILL, SIGFPE};
    struct sigaction action = {.sa_handler = guard_signal};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (sigaction(numbers[i], &action, NULL) != 0) {
            perror("sigaction");
            exit(1);
        }
}

/* fn(ctx); returns the signal that ended it, 0 if none. */
static inline int guard_call(void (*fn)(const void *ctx), const void *ctx)
{
    int number = sigsetjmp(guard_jump, 1);
    if (number)
        return number;
    guard_armed = 1;
    fn(ctx);
    guard_armed = 0;
    return 0;
}

#endif
