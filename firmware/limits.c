/* Each loop keeps 12 independent sums in registers, enough to hide the latency of an FMA on every
 * core we know. The target attributes let one file hold the loops of all levels; a level is run
 * only if the processor has it. */
#include "firmware/limits.h"

#include "firmware/engine.h"

#include "core/base/cpu.h"

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

enum { SUMS = 12, ROUNDS = 1 << 20, TRIES = 5, TRIAD_CHUNK = 1 << 18 };

typedef float flops_fn(int rounds); // returns what it computed, so that it is computed

struct level {
    unsigned cpu; // needed
    int width;    // floats
    flops_fn *fn;
};

#if defined(__x86_64__)

#define FLOPS(name, isa, type, set, step, lane)                                                    \
    __attribute__((target(isa))) static float name(int rounds)                                     \
    {                                                                                              \
        const type half = set(0.5f), one = set(1.0f);                                              \
        type s[SUMS];                                                                              \
        for (int k = 0; k < SUMS; k++)                                                             \
            s[k] = set((float)k);                                                                  \
        for (int i = 0; i < rounds; i++) {                                                         \
            _Pragma("GCC unroll 12") for (int k = 0; k < SUMS; k++) s[k] = step;                   \
        }                                                                                          \
        for (int k = 1; k < SUMS; k++)                                                             \
            s[0] += s[k];                                                                          \
        return lane;                                                                               \
    }

FLOPS(flops_sse2, "sse2", __m128, _mm_set1_ps, _mm_add_ps(_mm_mul_ps(s[k], half), one),
      _mm_cvtss_f32(s[0]))
FLOPS(flops_avx2, "avx2,fma", __m256, _mm256_set1_ps, _mm256_fmadd_ps(s[k], half, one),
      _mm256_cvtss_f32(s[0]))
FLOPS(flops_avx512, "avx512f", __m512, _mm512_set1_ps, _mm512_fmadd_ps(s[k], half, one),
      _mm512_cvtss_f32(s[0]))

static const struct level levels[] = {{CPU_AVX512, 16, flops_avx512},
                                      {CPU_AVX2, 8, flops_avx2},
                                      {0, 4, flops_sse2}}; // SSE4.1 has no wider arithmetic
#elif defined(__aarch64__)

static float flops_neon(int rounds)
{
    const float32x4_t half = vdupq_n_f32(0.5f), one = vdupq_n_f32(1.0f);
    float32x4_t s[SUMS];
    for (int k = 0; k < SUMS; k++)
        s[k] = vdupq_n_f32((float)k);
    for (int i = 0; i < rounds; i++) {
#pragma GCC unroll 12
        for (int k = 0; k < SUMS; k++)
            s[k] = vfmaq_f32(one, s[k], half);
    }
    for (int k = 1; k < SUMS; k++)
        s[0] = vaddq_f32(s[0], s[k]);
    return vaddvq_f32(s[0]);
}

static const struct level levels[] = {{0, 4, flops_neon}};
#else

static float flops_c(int rounds)
{
    float s[SUMS] = {0}, sum = 0;
    for (int i = 0; i < rounds; i++)
        for (int k = 0; k < SUMS; k++)
            s[k] = s[k] * 0.5f + 1.0f;
    for (int k = 0; k < SUMS; k++)
        sum += s[k];
    return sum;
}

static const struct level levels[] = {{0, 1, flops_c}};
#endif

struct flops {
    const struct level *level;
    float sums[64]; // one per worker
};

static err_t flops_chunk(void *ctx, int chunk, int worker)
{
    struct flops *f = ctx;
    (void)worker;
    f->sums[chunk] = f->level->fn(ROUNDS);
    return OK;
}

double limits_flops(struct pool *pool, unsigned cpu)
{
    struct flops f = {.level = levels};
    while ((f.level->cpu & cpu) != f.level->cpu)
        f.level++;
    int n = pool_size(pool);
    double best = 0, work = 2.0 * SUMS * ROUNDS * f.level->width * n;
    for (int i = 0; i < TRIES; i++) {
        double start = engine_seconds();
        if (pool_for(pool, n, flops_chunk, &f) != OK)
            return 0;
        double rate = work / (engine_seconds() - start);
        best = rate > best ? rate : best;
    }
    return best;
}

static err_t triad_chunk(void *ctx, int chunk, int worker)
{
    (void)worker;
    const size_t third = LIMITS_TRIAD_FLOATS / 3 / TRIAD_CHUNK * TRIAD_CHUNK;
    float *a = (float *)ctx + (size_t)chunk * TRIAD_CHUNK;
    const float *b = a + third, *c = b + third;
    for (int i = 0; i < TRIAD_CHUNK; i++)
        a[i] = b[i] + 0.5f * c[i];
    return OK;
}

double limits_bandwidth(struct pool *pool, float *work)
{
    const int chunks = LIMITS_TRIAD_FLOATS / 3 / TRIAD_CHUNK;
    const double bytes = 3.0 * sizeof(float) * chunks * TRIAD_CHUNK;
    double best = 0;
    for (size_t i = 0; i < LIMITS_TRIAD_FLOATS; i++)
        work[i] = 1.0f;
    for (int i = 0; i < TRIES; i++) {
        double start = engine_seconds();
        if (pool_for(pool, chunks, triad_chunk, work) != OK)
            return 0;
        double rate = bytes / (engine_seconds() - start);
        best = rate > best ? rate : best;
    }
    return best;
}
