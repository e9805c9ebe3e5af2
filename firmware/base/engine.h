/* engine.h - resources of a job: kernels for this machine, a pool of threads, two arenas, cancel
 * and progress. */
#ifndef BASE_ENGINE_H
#define BASE_ENGINE_H

#include "firmware/base/progress.h"

#include "core/base/sha256.h"
#include "core/base/types.h"
#include "core/kernels/kernels.h"

struct engine {
    unsigned cpu; // instruction sets in use, bits of cpu.h
    struct kernels kernels;
    struct pool *pool;
    struct arena keep, tmp;
    struct progress progress;
    struct run run; // points into this struct, which must not move
};

/* Set when the user wants to stop; every job looks at it. */
extern atomic_bool engine_cancel;

/* Choose kernels, within the levels that the environment's HDRIG_CPU_MASK names, and start the
 * pool. No memory yet. threads: 0 = one per core. Progress goes to stderr.
 * own:  engine_close.
 * err:  ERR_ARG (mask), ERR_NOMEM, ERR_LIMIT. On error *en is zeroed. */
MUST_USE err_t engine_open(struct engine *en, int threads);

/* Reserve both arenas, at once for the whole job.
 * other: bytes that the job takes elsewhere. max_mb: bound of the sum, MB (10^6 bytes).
 * err:  ERR_LIMIT (needs more than max_mb), ERR_NOMEM. */
MUST_USE err_t engine_reserve(struct engine *en, size_t other, size_t keep, size_t tmp, int max_mb);

/* Accepts a zeroed engine. */
void engine_close(struct engine *en);

/* Most memory that this process held so far, MB (10^6 bytes). */
double engine_peak_rss_mb(void);

/* SHA-256 of this program's file: another build may compute other numbers.
 * err:  ERR_IO. */
MUST_USE err_t engine_program(char hash[SHA256_HEX_CAP]);

/* Monotonic clock, seconds. */
double engine_seconds(void);

/* Processor time of all threads of this process, seconds: other programs do not count. */
double engine_busy_seconds(void);

#endif
