/* Each loop keeps 12 independent sums in registers, enough to hide the latency of an FMA on every
 * core we know. The target attributes let one file hold the loops of all levels; a level is run
 * only if the processor has it. */
#include "firmware/recon/limits.h"

#include "firmware/base/engine.h"

#include "core/base/cpu.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

enum { SUMS = 12, ROUNDS = 1 << 19, TRIES = 5, TRIAD_CHUNK = 1 << 18 };

typedef float flops_fn(int rounds); // returns what it computed, so that it is computed

struct level {
    unsigned cpu;    // needed
    const char *isa; // name of the kernels
    int width;       // floats
    flops_fn *fn;
};

typedef void s8_fn(int rounds);

struct s8_level {
    const char *isa;
    int macs; // in each of the SUMS steps of a round
    s8_fn *fn;
};

/* A loop over independent sums of one step in assembler, which no compiler can shorten: %0 is the
 * sum, %1 free, %2 and %3 the factors; `reg` is the constraint of a vector register. */
#define S8(name, options, type, reg, step)                                                         \
    options static void name(int rounds)                                                           \
    {                                                                                              \
        type s[SUMS] = {{0}}, t, a = {0}, b = {0};                                                 \
        for (int i = 0; i < rounds; i++) {                                                         \
            _Pragma("GCC unroll 12") for (int k = 0; k < SUMS; k++) __asm__ volatile(              \
                step : "+" reg(s[k]), "=&" reg(t) : reg(a), reg(b));                               \
        }                                                                                          \
    }

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

static const struct level levels[] = {{CPU_AVX512, "avx512", 16, flops_avx512},
                                      {CPU_AVX2, "avx2", 8, flops_avx2},
                                      {CPU_SSE41, "sse41", 4, flops_sse2}, // no wider arithmetic
                                      {0, "c", 4, flops_sse2}};

S8(s8_sse41, __attribute__((target("sse4.1"))), __m128i, "x",
   "movdqa %2, %1\n\tpmaddwd %3, %1\n\tpaddd %1, %0")
S8(s8_avx2, __attribute__((target("avx2"))), __m256i, "x",
   "vpmaddwd %2, %3, %1\n\tvpaddd %1, %0, %0")
S8(s8_avx512, __attribute__((target("avx512bw"))), __m512i, "v",
   "vpmaddwd %2, %3, %1\n\tvpaddd %1, %0, %0")
S8(s8_avx512vnni, __attribute__((target("avx512f,avx512vnni"))), __m512i, "v",
   "vpdpbusd %2, %3, %0")

struct tiles { // Intel SDM vol. 1, 18.2
    uint8_t palette, start_row, reserved[14];
    uint16_t bytes[16];
    uint8_t rows[16];
};

/* Four sums of 16 x 16, as many as two by two tiles leave room for. */
__attribute__((target("amx-tile,amx-int8"))) static void s8_amx(int rounds)
{
    struct tiles t = {.palette = 1};
    for (int i = 0; i < 6; i++) {
        t.bytes[i] = 64;
        t.rows[i] = 16;
    }
    __asm__ volatile("" ::"r"(&t) : "memory"); // gcc 12 takes it that 8 bytes are read
    _tile_loadconfig(&t);
    _tile_zero(0);
    _tile_zero(1);
    _tile_zero(2);
    _tile_zero(3);
    _tile_zero(4);
    _tile_zero(5);
    for (int i = 0; i < rounds * SUMS / 4; i++) {
        _tile_dpbssd(0, 4, 5);
        _tile_dpbssd(1, 4, 5);
        _tile_dpbssd(2, 4, 5);
        _tile_dpbssd(3, 4, 5);
    }
    _tile_release();
}

static const struct s8_level s8_levels[] = {
    {"amx", 16 * 16 * 64, s8_amx}, {"avx512vnni", 64, s8_avx512vnni},
    {"avx512", 32, s8_avx512},     {"avx2", 16, s8_avx2},
    {"sse41", 8, s8_sse41},        {"c", 8, s8_sse41}}; // what a compiler can make of plain loops
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

static const struct level levels[] = {{0, "neon", 4, flops_neon}, {0, "c", 4, flops_neon}};

S8(s8_neon, , int8x16_t, "w",
   "smull %1.8h, %2.8b, %3.8b\n\tsmlal2 %1.8h, %2.16b, %3.16b\n\tsadalp %0.4s, %1.8h")
S8(s8_neondot, __attribute__((target("arch=armv8.2-a+dotprod"))), int8x16_t, "w",
   "sdot %0.4s, %2.16b, %3.16b")
S8(s8_i8mm, __attribute__((target("arch=armv8.2-a+i8mm"))), int8x16_t, "w",
   "smmla %0.4s, %2.16b, %3.16b")

static const struct s8_level s8_levels[] = {
    {"i8mm", 32, s8_i8mm}, {"neondot", 16, s8_neondot}, {"neon", 16, s8_neon}, {"c", 16, s8_neon}};
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

static void s8_c(int rounds)
{
    for (int i = 0; i < rounds; i++)
        for (int k = 0; k < SUMS; k++)
            __asm__ volatile("" ::"r"(i * k));
}

static const struct level levels[] = {{0, "c", 1, flops_c}};
static const struct s8_level s8_levels[] = {{"c", 1, s8_c}};
#endif

enum {
    N_LEVELS = sizeof levels / sizeof levels[0],
    N_S8_LEVELS = sizeof s8_levels / sizeof s8_levels[0]
};

struct peak {
    const struct limits_loop *loop;
    float sums[64]; // one per worker
};

static err_t peak_chunk(void *ctx, int chunk, int worker)
{
    struct peak *p = ctx;
    (void)worker;
    if (p->loop->ints)
        p->loop->ints(ROUNDS);
    else
        p->sums[chunk] = p->loop->floats(ROUNDS);
    return OK;
}

double limits_now(struct pool *pool, const struct limits_loop *loop)
{
    const int n = pool_size(pool);
    struct peak p = {.loop = loop};
    const double start = engine_busy_seconds();
    if (loop->per_step == 0 || pool_for(pool, n, peak_chunk, &p) != OK)
        return 0;
    return loop->per_step * SUMS * ROUNDS * n * n / (engine_busy_seconds() - start);
}

struct limits_loop limits_flops(unsigned cpu)
{
    const struct level *l = levels;
    while ((l->cpu & cpu) != l->cpu)
        l++;
    return (struct limits_loop){.per_step = 2.0 * l->width, .floats = l->fn};
}

struct limits_loop limits_f32(const char *isa)
{
    for (int i = 0; i < N_LEVELS; i++)
        if (strcmp(levels[i].isa, isa) == 0)
            return (struct limits_loop){.per_step = levels[i].width, .floats = levels[i].fn};
    return (struct limits_loop){.per_step = 0};
}

struct limits_loop limits_s8(const char *isa)
{
    for (int i = 0; i < N_S8_LEVELS; i++)
        if (strcmp(s8_levels[i].isa, isa) == 0)
            return (struct limits_loop){.per_step = s8_levels[i].macs, .ints = s8_levels[i].fn};
    return (struct limits_loop){.per_step = 0};
}

void limits_add(struct limits_turns *t, double limit, double rate)
{
    if (t->n == LIMITS_TURNS)
        return;
    t->limit[t->n] = limit;
    t->share[t->n++] = limit > 0 ? rate / limit : 0;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

struct limits_share limits_sum_up(struct limits_turns *t)
{
    const int n = t->n;
    if (n == 0)
        return (struct limits_share){.limit = 0};
    qsort(t->limit, (size_t)n, sizeof t->limit[0], compare_doubles);
    qsort(t->share, (size_t)n, sizeof t->share[0], compare_doubles);
    return (struct limits_share){t->limit[n / 2], t->share[n / 2], t->share[n / 4],
                                 t->share[n * 3 / 4]};
}

struct limits_share limits_share_of(const struct limits_turns *t, double rate)
{
    struct limits_turns of = *t;
    for (int i = 0; i < of.n; i++)
        of.share[i] = of.limit[i] > 0 ? rate / of.limit[i] : 0;
    return limits_sum_up(&of);
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
