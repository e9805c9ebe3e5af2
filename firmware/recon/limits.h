/* limits.h - what this machine can do at best: floating-point operations and memory traffic.
 * The yardsticks that `hdrig bench` holds its figures against. */
#ifndef RECON_LIMITS_H
#define RECON_LIMITS_H

#include "core/base/pool.h"

/* A loop that does nothing but arithmetic in registers. */
struct limits_loop {
    double per_step; // operations or multiply-accumulates in a step; 0: there is no such loop
    float (*floats)(int rounds);
    void (*ints)(int rounds);
};

/* Operations in single precision; a fused multiply-add counts as two. cpu: highest level of these
 * bits (cpu.h) is used. */
struct limits_loop limits_flops(unsigned cpu);

/* Multiply-accumulates with the instructions of the products that the kernels name so (gemm.h:
 * s8_name, f32_name). The processor must have them. */
struct limits_loop limits_s8(const char *isa);
struct limits_loop limits_f32(const char *isa);

/* What a loop does per second of processor time on all threads of the pool together, over about a
 * millisecond; 0 if there is none. The clock of a processor changes and other programs are in the
 * way: it is to take turns with what is held against it. */
double limits_now(struct pool *pool, const struct limits_loop *loop);

enum { LIMITS_TURNS = 256 };

/* Turns of a limit and of work. */
struct limits_turns {
    int n;
    double limit[LIMITS_TURNS], share[LIMITS_TURNS]; // work over limit, 0 where one is not known
};

/* Add a turn, up to LIMITS_TURNS; rate: of the work, in the limit's unit. */
void limits_add(struct limits_turns *t, double limit, double rate);

/* Medians, and the quartiles of the share; sorts the turns. */
struct limits_share {
    double limit, share, low, high;
};
struct limits_share limits_sum_up(struct limits_turns *t);

/* The same for one rate over all of the turns' limits. */
struct limits_share limits_share_of(const struct limits_turns *t, double rate);

enum { LIMITS_TRIAD_FLOATS = 64 << 20 }; // 256 MB in all

/* Bytes per second of a[i] = b[i] + s c[i] over `work`, two reads and one write per element.
 * work: LIMITS_TRIAD_FLOATS floats, overwritten. */
double limits_bandwidth(struct pool *pool, float *work);

#endif
