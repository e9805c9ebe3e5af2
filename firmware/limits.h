/* limits.h - what this machine can do at best: floating-point operations and memory traffic.
 * The yardsticks that `hdrig bench` holds its figures against. */
#ifndef FIRMWARE_LIMITS_H
#define FIRMWARE_LIMITS_H

#include "core/base/pool.h"

/* Operations per second in single precision, registers only, all threads of the pool together; a
 * fused multiply-add counts as two. cpu: highest level of these bits (cpu.h) is used. */
double limits_flops(struct pool *pool, unsigned cpu);

/* Multiply-accumulates per second with the instructions of the products that the kernels name so
 * (gemm.h: s8_name, f32_name), registers only, all threads of the pool together; 0 for an unknown
 * name. The processor must have them. */
double limits_s8(struct pool *pool, const char *isa);
double limits_f32(struct pool *pool, const char *isa);

enum { LIMITS_TRIAD_FLOATS = 64 << 20 }; // 256 MB in all

/* Bytes per second of a[i] = b[i] + s c[i] over `work`, two reads and one write per element.
 * work: LIMITS_TRIAD_FLOATS floats, overwritten. */
double limits_bandwidth(struct pool *pool, float *work);

#endif
