/* The products of the network on every instruction set of this machine against plain C: shapes
 * around every tile, extreme values, arrays that end or start at inaccessible pages. Tile
 * instructions that this machine lacks are emulated.
 * gemm_test [--seed N] [--bench] [--only LEVEL]
 * Integers must be equal. Floats are compared twice: where all products and sums are small
 * integers, which are exact in any order, they must be equal, else within 1e-6 of the sum of the
 * magnitudes. */
#include "tests/kernels/trial.h"

#if defined(__x86_64__)
#include "tests/kernels/amx_emu.h"

#include <immintrin.h>
#endif

#define F32_BOUND 1e-6

static const struct level {
    const char *name;
    unsigned cpu;
} levels[] = {
    {"sse41", CPU_SSE41},
    {"avx2", CPU_SSE41 | CPU_AVX2},
    {"avx512", CPU_SSE41 | CPU_AVX2 | CPU_AVX512},
    {"avx512vnni", CPU_SSE41 | CPU_AVX2 | CPU_AVX512 | CPU_AVX512VNNI},
    {"amx", CPU_SSE41 | CPU_AVX2 | CPU_AVX512 | CPU_AVX512VNNI | CPU_AMX},
    {"neon", CPU_NEON},
    {"neondot", CPU_NEON | CPU_NEONDOT},
    {"i8mm", CPU_NEON | CPU_NEONDOT | CPU_I8MM},
};

enum { LEVELS = sizeof levels / sizeof *levels };

/* The kernels of a level; false if this machine lacks it. */
static bool level_kernels(const struct level *l, struct gemm_kernels *out)
{
    struct kernels k;
    if ((cpu_detect() & l->cpu) != l->cpu)
        return false;
    kernels_init(&k, l->cpu);
    *out = k.net;
    return true;
}

/* --- shapes -------------------------------------------------------------------------------- */

struct shape {
    int m, panels, segs, seg;
};

/* Elements between rows, runs, panels and rows of results beyond what is needed. */
struct gaps {
    int a, seg, w, c;
};

enum { M_MAX = 70, SHAPES_MAX = 512 };

static const struct gaps gaps[] = {{0, 0, 0, 0}, {3, 1, 64, 1}, {60, 5, 1, 16}, {-1, 0, 0, 0}};

enum { N_GAPS = sizeof gaps / sizeof *gaps };

static size_t shape_k(const struct shape *s)
{
    return (size_t)s->segs * (size_t)s->seg;
}

/* Rows overlap, as those of a convolution do, where the gap is negative. */
static size_t shape_lda(const struct shape *s, const struct gaps *g)
{
    size_t row = (size_t)(s->segs - 1) * (size_t)(s->seg + g->seg) + (size_t)s->seg;
    return g->a < 0 ? (size_t)s->seg / 2 : row + (size_t)g->a;
}

static size_t shape_a(const struct shape *s, const struct gaps *g)
{
    size_t row = (size_t)(s->segs - 1) * (size_t)(s->seg + g->seg) + (size_t)s->seg;
    return s->m ? (size_t)(s->m - 1) * shape_lda(s, g) + row : 0;
}

static size_t shape_ldw(const struct shape *s, const struct gaps *g)
{
    return PANEL * shape_k(s) + (size_t)g->w;
}

static size_t shape_w(const struct shape *s, const struct gaps *g)
{
    return (size_t)(s->panels - 1) * shape_ldw(s, g) + PANEL * shape_k(s);
}

static size_t shape_ldc(const struct shape *s, const struct gaps *g)
{
    return PANEL * (size_t)s->panels + (size_t)g->c;
}

static size_t shape_c(const struct shape *s, const struct gaps *g)
{
    return s->m ? (size_t)(s->m - 1) * shape_ldc(s, g) + PANEL * (size_t)s->panels : 0;
}

static int shapes_add(struct shape *out, int n, struct shape s)
{
    out[n] = s;
    return n < SHAPES_MAX - 1 ? n + 1 : n;
}

/* All row counts up to more than two tiles, all kinds of runs, and the product of a few of both;
 * widths of runs are multiples of `unit`. */
static int shapes_fill(struct shape out[SHAPES_MAX], int unit)
{
    static const int rows[] = {1, 5, 8, 16, 17, 31, 33, 64, 65, M_MAX};
    static const int runs[] = {1, 2, 3, 4, 7, 8, 15, 16, 17, 18, 24, 31, 32, 33, 48, 63};
    static const int deep[] = {256, 257, 511, 513};
    int n = 0, n_runs = sizeof runs / sizeof *runs;
    for (int m = 0; m <= M_MAX; m++)
        n = shapes_add(out, n, (struct shape){m, 1 + m % 3, 1 + m % 2, unit * (1 + m % 5)});
    for (int i = 0; i < 3 * n_runs; i++)
        n = shapes_add(out, n, (struct shape){3, 1 + i % 3, 1, unit * runs[i / 3]});
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        for (int j = 0; j < n_runs; j++)
            n = shapes_add(out, n,
                           (struct shape){rows[i], 1 + (j + (int)i) % 4,
                                          (const int[]){1, 3, 7}[j % 3], unit * runs[j]});
    for (int i = 0; i < 4; i++)
        n = shapes_add(
            out, n,
            (struct shape){(const int[]){2, 9, 16, 19}[i], 2, 1 + 2 * (i % 2), unit * deep[i]});
    return n;
}

/* --- integers ------------------------------------------------------------------------------ */

static struct gemm_s8 s8;
static gemm_s8_fn *s8_fn;

static void s8_call(const void *ctx)
{
    s8_fn(ctx);
}

static int8_t s8_value(enum pattern pattern, int low)
{
    if (pattern == EXTREME)
        return (int8_t)(trial_uniform(0, 1) < 0.5 ? 127 : low);
    return (int8_t)floor(trial_uniform(low, 128));
}

static void s8_make(const struct shape *s, const struct gaps *g, enum pattern pattern)
{
    size_t na = shape_a(s, g), nw = shape_w(s, g);
    int8_t *a = guard_alloc(na, 1), *w = guard_alloc(nw, 1);
    for (size_t i = 0; i < na; i++)
        a[i] = s8_value(pattern, -127);
    for (size_t i = 0; i < nw; i++)
        w[i] = s8_value(pattern, -128);
    s8 = (struct gemm_s8){.m = s->m,
                          .panels = s->panels,
                          .segs = s->segs,
                          .seg = s->seg,
                          .a = a,
                          .lda = shape_lda(s, g),
                          .seg_stride = (size_t)(s->seg + g->seg),
                          .w = w,
                          .ldw = shape_ldw(s, g),
                          .c = guard_alloc(shape_c(s, g), sizeof(int32_t)),
                          .ldc = shape_ldc(s, g)};
}

/* returns: the fault, or NULL. */
static const char *run_guarded(void (*call)(const void *ctx), const void *ctx)
{
    int number = guard_call(call, ctx);
    if (number)
        return number == SIGSEGV ? "left its arrays" : number == SIGILL ? "SIGILL" : "a signal";
    return guard_intact() ? NULL : "wrote beside its arrays";
}

/* Gaps between rows of results must be as they were. */
static bool gaps_intact(const void *c, int m, size_t n, size_t ldc)
{
    for (int i = 0; i + 1 < m; i++)
        for (size_t j = n; j < ldc; j++)
            if (!guard_is_canary((const float *)c + (size_t)i * ldc + j))
                return false;
    return true;
}

static const char *s8_compare(gemm_s8_fn *reference, gemm_s8_fn *fn)
{
    size_t n = PANEL * (size_t)s8.panels, all = s8.m ? (size_t)(s8.m - 1) * s8.ldc + n : 0;
    int32_t *want = malloc((all + 1) * sizeof *want);
    s8_fn = reference;
    const char *fault = run_guarded(s8_call, &s8);
    memcpy(want, s8.c, all * sizeof *want);
    guard_fill((uint8_t *)s8.c, all * sizeof *want);
    s8_fn = fn;
    if (!fault)
        fault = run_guarded(s8_call, &s8);
    if (!fault && memcmp(want, s8.c, all * sizeof *want) != 0)
        fault = "differs from C";
    if (!fault && !gaps_intact(s8.c, s8.m, n, s8.ldc))
        fault = "wrote between its rows";
    free(want);
    return fault;
}

/* Sums at the bound of the contract. */
static int s8_bound(const struct gemm_kernels *k, const char *name)
{
    const struct shape s = {3, 1, 2, 65536};
    int bad = 0;
    for (int i = 0; i < 4; i++) {
        guard_reset(true);
        s8_make(&s, &gaps[0], ORDINARY);
        memset((int8_t *)s8.a, i % 2 ? 127 : -127, shape_a(&s, &gaps[0]));
        memset((int8_t *)s8.w, i / 2 ? 127 : -128, shape_w(&s, &gaps[0]));
        s8_fn = k->s8;
        const char *fault = run_guarded(s8_call, &s8);
        int32_t want = 131072 * (i % 2 ? 127 : -127) * (i / 2 ? 127 : -128);
        for (int j = 0; j < s.m * PANEL && !fault; j++)
            fault = s8.c[j] == want ? NULL : "wrong at the bound of int32";
        if (fault)
            printf("%s s8: %s\n", name, fault);
        bad += fault != NULL;
    }
    return bad;
}

/* --- floats -------------------------------------------------------------------------------- */

static struct gemm_f32 f32;
static gemm_f32_fn *f32_fn;

static void f32_call(const void *ctx)
{
    f32_fn(ctx);
}

/* Extreme input: small integers, so that nothing is rounded. */
static float *f32_values(size_t n, enum pattern pattern)
{
    float *p = trial_random(n, -1, 1);
    for (size_t i = 0; i < n && pattern == EXTREME; i++)
        p[i] = rintf(8 * p[i]);
    return p;
}

static void f32_make(const struct shape *s, const struct gaps *g, enum pattern pattern)
{
    f32 = (struct gemm_f32){.m = s->m,
                            .panels = s->panels,
                            .segs = s->segs,
                            .seg = s->seg,
                            .a = f32_values(shape_a(s, g), pattern),
                            .lda = shape_lda(s, g),
                            .seg_stride = (size_t)(s->seg + g->seg),
                            .w = f32_values(shape_w(s, g), pattern),
                            .ldw = shape_ldw(s, g),
                            .c = trial_floats(shape_c(s, g)),
                            .ldc = shape_ldc(s, g),
                            .add = s->m % 2 == 0};
    for (int i = 0; i < f32.m && f32.add; i++)
        for (int j = 0; j < PANEL * f32.panels; j++)
            f32.c[(size_t)i * f32.ldc + (size_t)j] = (float)(i - j);
}

/* Result (i, j) in double, and the sum of the magnitudes. */
static double f32_exact(int i, int j, double *size)
{
    const float *w = f32.w + (size_t)(j / PANEL) * f32.ldw + j % PANEL;
    double sum = f32.add ? i - j : 0;
    *size = fabs(sum);
    for (int s = 0; s < f32.segs; s++)
        for (int l = 0; l < f32.seg; l++, w += PANEL) {
            size_t at = (size_t)i * f32.lda + (size_t)s * f32.seg_stride + (size_t)l;
            double x = (double)f32.a[at] * (double)*w;
            sum += x;
            *size += fabs(x);
        }
    return sum;
}

static const char *f32_compare(gemm_f32_fn *fn, enum pattern pattern, double *top)
{
    f32_fn = fn;
    const char *fault = run_guarded(f32_call, &f32);
    for (int i = 0; i < f32.m && !fault; i++)
        for (int j = 0; j < PANEL * f32.panels; j++) {
            double size, want = f32_exact(i, j, &size);
            double got = (double)f32.c[(size_t)i * f32.ldc + (size_t)j];
            double d = want == got ? 0 : fabs(got - want) / (F32_BOUND * size);
            if (pattern == EXTREME ? got != want : !(d <= 1))
                fault = "differs from the sum in double";
            *top = d > *top ? d : *top;
        }
    if (!fault && !gaps_intact(f32.c, f32.m, PANEL * (size_t)f32.panels, f32.ldc))
        fault = "wrote between its rows";
    return fault;
}

/* --- unpacking ----------------------------------------------------------------------------- */

static struct {
    const struct gemm_kernels *k;
    int n;
    int8_t *s8;
    uint16_t *bf16;
    float *out;
} unpack;

static void unpack_s8_call(const void *ctx)
{
    (void)ctx;
    unpack.k->unpack_s8(unpack.s8, unpack.n, unpack.out);
}

static void unpack_bf16_call(const void *ctx)
{
    (void)ctx;
    unpack.k->unpack_bf16(unpack.bf16, unpack.n, unpack.out);
}

/* The value of input i, output j, bit for bit. */
static bool unpack_right(bool bf16, int i, int j)
{
    float s = bf16 ? 0 : (float)unpack.s8[i / 4 * 4 * PANEL + 4 * j + i % 4];
    uint32_t want = bf16 ? (uint32_t)unpack.bf16[i * PANEL + j] << 16 : 0, got;
    if (!bf16)
        memcpy(&want, &s, sizeof want);
    memcpy(&got, unpack.out + i * PANEL + j, sizeof got);
    return got == want;
}

static int check_unpack(const struct gemm_kernels *k, const char *name)
{
    int bad = 0;
    for (int i = 0; i < 2 * 2 * 70; i++) {
        bool bf16 = i % 2;
        int n = bf16 ? i / 4 : 4 * (i / 4);
        const char *fault = NULL;
        guard_reset(i / 2 % 2);
        unpack.k = k;
        unpack.n = n;
        unpack.out = trial_floats(PANEL * (size_t)n);
        unpack.s8 = guard_alloc(PANEL * (size_t)n, 1);
        unpack.bf16 = guard_alloc(PANEL * (size_t)n, 2);
        for (int j = 0; j < PANEL * n; j++) {
            unpack.s8[j] = s8_value(ORDINARY, -128);
            unpack.bf16[j] = (uint16_t)trial_uniform(0, 65536);
        }
        fault = run_guarded(bf16 ? unpack_bf16_call : unpack_s8_call, NULL);
        for (int j = 0; j < PANEL * n && !fault; j++)
            fault = unpack_right(bf16, j / PANEL, j % PANEL) ? NULL : "wrong value";
        if (fault)
            printf("%s unpack_%s of %d inputs: %s\n", name, bf16 ? "bf16" : "s8", n, fault);
        bad += fault != NULL;
    }
    return bad;
}

/* --- all of them --------------------------------------------------------------------------- */

static int print_summary(const char *level, const char *slot, int cases, int bad)
{
    printf("%s %s %s, %d cases\n", bad ? "FAILED" : "ok", level, slot, cases);
    return bad;
}

static void print_fault(const char *slot, const char *fault, const struct shape *s, int turn)
{
    if (fault)
        printf("%s of %d rows, %d panels, %d runs of %d, turn %d: %s\n", slot, s->m, s->panels,
               s->segs, s->seg, turn, fault);
}

static int check_s8(const struct gemm_kernels *k, const char *name)
{
    static struct shape shapes[SHAPES_MAX];
    struct kernels c;
    kernels_init(&c, 0);
    int n = shapes_fill(shapes, 4), bad = 0;
    for (int i = 0; i < 2 * N_GAPS * n; i++) {
        const struct shape *s = &shapes[i / (2 * N_GAPS)];
        guard_reset(i % 2);
        s8_make(s, &gaps[i / 2 % N_GAPS], i / (2 * N_GAPS) % 3 ? ORDINARY : EXTREME);
        const char *fault = s8_compare(c.net.s8, k->s8);
        print_fault("s8", fault, s, i % (2 * N_GAPS));
        bad += fault != NULL;
    }
    bad += s8_bound(k, name);
    return print_summary(name, "s8", 2 * N_GAPS * n + 4, bad);
}

static int check_f32(const struct gemm_kernels *k, const char *name)
{
    static struct shape shapes[SHAPES_MAX];
    double top = 0;
    int n = shapes_fill(shapes, 1), bad = 0;
    for (int i = 0; i < 2 * N_GAPS * n; i++) {
        const struct shape *s = &shapes[i / (2 * N_GAPS)];
        enum pattern pattern = i / (2 * N_GAPS) % 2 ? ORDINARY : EXTREME;
        guard_reset(i % 2);
        f32_make(s, &gaps[i / 2 % N_GAPS], pattern);
        const char *fault = f32_compare(k->f32, pattern, &top);
        print_fault("f32", fault, s, i % (2 * N_GAPS));
        bad += fault != NULL;
    }
    printf("%s f32: error %.2f of the bound\n", name, top);
    return print_summary(name, "f32", 2 * N_GAPS * n, bad);
}

static int check_all(const char *only)
{
    int bad = 0, chosen = 0;
    for (int l = 0; l < LEVELS; l++) {
        struct gemm_kernels k;
        trial_rng = trial_seed * 1000003;
        if (only && strcmp(only, levels[l].name) != 0)
            continue;
        chosen++;
        if (level_kernels(&levels[l], &k))
            bad += check_s8(&k, levels[l].name) + check_f32(&k, levels[l].name) +
                   print_summary(levels[l].name, "unpack", 280, check_unpack(&k, levels[l].name));
        else
            printf("-- this machine has no %s\n", levels[l].name);
    }
#if defined(__x86_64__)
    if (!(cpu_detect() & CPU_AMX) && (!only || strcmp(only, "amx") == 0)) {
        struct gemm_kernels k;
        emu_start();
        gemm_amx(&k);
        bad += check_s8(&k, "emulated amx");
    }
#endif
    return bad + (chosen == 0);
}

/* --- times --------------------------------------------------------------------------------- */

/* As core/net calls them: so many rows, so many panels at once. */
static const struct workload {
    const char *name;
    int m, k_segs, seg, n;
    int lda; // 0: rows without gaps
    int at_once;
} workloads[] = {
    {"qkv", 64, 1, 1024, 3072, 0, 4},        {"projection", 64, 1, 1024, 1024, 0, 4},
    {"mlp in", 64, 1, 1024, 4096, 0, 4},     {"mlp out", 64, 1, 4096, 1024, 0, 2},
    {"2048 wide", 64, 1, 2048, 1024, 0, 4},  {"3x3 of 256", 64, 3, 768, 256, 256, 2},
    {"7x7 of 128", 64, 7, 896, 128, 128, 2}, {"attention q k", 64, 1, 64, 128, 0, 8},
    {"attention p v", 64, 1, 128, 64, 0, 4}, {"4 rows", 4, 1, 2048, 2048, 0, 4},
    {"1 row", 1, 1, 2048, 2048, 0, 4},
};

enum {
    WORKLOADS = sizeof workloads / sizeof *workloads,
    PEAK_ROUNDS = 50000,
    SUMS = 12,
    TURNS_MIN = 5,
    TURNS_MAX = 400
};

/* Peak of a loop without memory accesses; NULL fn: not known. */
struct peak {
    unsigned cpu;
    int width; // multiplications of a step
    void (*fn)(int rounds);
};

#if defined(__x86_64__)

#define TWELVE(step)                                                                               \
    step("0") step("1") step("2") step("3") step("4") step("5") step("6") step("7") step("8")      \
        step("9") step("10") step("11")
#define ZERO(k) "pxor %%xmm" k ", %%xmm" k "\n"
#define CLEAR TWELVE(ZERO) ZERO("13") ZERO("14") ZERO("15")
/* after: without it the upper halves of registers slow down what follows with SSE's own code. */
#define PEAK(name, clear, step, after)                                                             \
    static void name(int rounds)                                                                   \
    {                                                                                              \
        __asm__ volatile(clear "1:\n" TWELVE(step) "dec %0\njnz 1b\n" after                        \
                         : "+r"(rounds)                                                            \
                         :                                                                         \
                         : "cc", "xmm0", "xmm1", "xmm2", "xmm3", "xmm4", "xmm5", "xmm6", "xmm7",   \
                           "xmm8", "xmm9", "xmm10", "xmm11", "xmm13", "xmm14", "xmm15");           \
    }

#define S8_SSE41(k) "movdqa %%xmm15, %%xmm13\npmaddwd %%xmm14, %%xmm13\npaddd %%xmm13, %%xmm" k "\n"
#define S8_AVX2(k) "vpmaddwd %%ymm14, %%ymm15, %%ymm13\nvpaddd %%ymm13, %%ymm" k ", %%ymm" k "\n"
#define S8_AVX512(k) "vpmaddwd %%zmm14, %%zmm15, %%zmm13\nvpaddd %%zmm13, %%zmm" k ", %%zmm" k "\n"
#define S8_AVX512VNNI(k) "vpdpbusd %%zmm14, %%zmm15, %%zmm" k "\n"
#define F32_SSE41(k) "movaps %%xmm15, %%xmm13\nmulps %%xmm14, %%xmm13\naddps %%xmm13, %%xmm" k "\n"
#define F32_AVX2(k) "vfmadd231ps %%ymm14, %%ymm15, %%ymm" k "\n"
#define F32_AVX512(k) "vfmadd231ps %%zmm14, %%zmm15, %%zmm" k "\n"

PEAK(peak_s8_sse41, CLEAR, S8_SSE41, "")
PEAK(peak_s8_avx2, "vzeroall\n", S8_AVX2, "vzeroupper\n")
PEAK(peak_s8_avx512, "vzeroall\n", S8_AVX512, "vzeroupper\n")
PEAK(peak_s8_avx512vnni, "vzeroall\n", S8_AVX512VNNI, "vzeroupper\n")
PEAK(peak_f32_sse41, CLEAR, F32_SSE41, "")
PEAK(peak_f32_avx2, "vzeroall\n", F32_AVX2, "vzeroupper\n")
PEAK(peak_f32_avx512, "vzeroall\n", F32_AVX512, "vzeroupper\n")

static const struct peak peaks_s8[] = {{CPU_AVX512VNNI, 64, peak_s8_avx512vnni},
                                       {CPU_AVX512, 32, peak_s8_avx512},
                                       {CPU_AVX2, 16, peak_s8_avx2},
                                       {CPU_SSE41, 8, peak_s8_sse41},
                                       {0, 0, NULL}};
static const struct peak peaks_f32[] = {{CPU_AVX512, 16, peak_f32_avx512},
                                        {CPU_AVX2, 8, peak_f32_avx2},
                                        {CPU_SSE41, 4, peak_f32_sse41},
                                        {0, 0, NULL}};
#else
static const struct peak peaks_s8[] = {{0, 0, NULL}}, peaks_f32[] = {{0, 0, NULL}};
#endif

static void s8_workload(const struct workload *l, const struct gemm_kernels *k)
{
    struct gemm_s8 g = s8;
    g.panels = l->at_once;
    for (int p = 0; p < l->n / PANEL; p += l->at_once, g.w += (size_t)l->at_once * g.ldw)
        k->s8(&g);
}

static void f32_workload(const struct workload *l, const struct gemm_kernels *k)
{
    struct gemm_f32 g = f32;
    g.panels = l->at_once;
    for (int p = 0; p < l->n / PANEL; p += l->at_once, g.w += (size_t)l->at_once * g.ldw)
        k->f32(&g);
}

/* Memory that starts a cache line. */
static void *workload_room(size_t bytes)
{
    void *p = aligned_alloc(64, (bytes + 63) / 64 * 64);
    if (!p) {
        perror("memory for a workload");
        exit(1);
    }
    return p;
}

/* Processor time of this thread, s: other programs do not count. */
static double busy_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static const struct peak *peak_of(bool floats, unsigned cpu)
{
    const struct peak *p = floats ? peaks_f32 : peaks_s8;
    while ((cpu & p->cpu) != p->cpu)
        p++;
    return p;
}

/* Time of a workload and its share of the peak of the multipliers. The two alternate, because the
 * clock of a processor changes. */
struct timing {
    double best;             // s
    int n;                   // turns
    double share[TURNS_MAX]; // ascending; 0: not known
};

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

#define TURN_S 2e-4 // the clock itself takes about 1e-6

/* Processor time of `times` runs of a workload, s. */
static double run_workload(const struct workload *l, const struct gemm_kernels *k, bool floats,
                           int times)
{
    const double start = busy_seconds();
    for (int i = 0; i < times; i++)
        (floats ? f32_workload : s8_workload)(l, k);
    return busy_seconds() - start;
}

static struct timing take_turns(const struct workload *l, const struct gemm_kernels *k,
                                const struct peak *p, bool floats)
{
    const double macs = (double)l->m * l->k_segs * l->seg * l->n;
    struct timing t = {.best = INFINITY};
    const int times = 1 + (int)(TURN_S / run_workload(l, k, floats, 1));
    double end = busy_seconds() + 0.2;
    while (t.n < TURNS_MIN || (t.n < TURNS_MAX && busy_seconds() < end)) {
        double start = busy_seconds();
        if (p->fn)
            p->fn(PEAK_ROUNDS);
        double limit = (double)p->width * SUMS * PEAK_ROUNDS / (busy_seconds() - start);
        double took = run_workload(l, k, floats, times) / times;
        t.best = fmin(t.best, took);
        t.share[t.n++] = p->fn ? macs / took / limit : 0;
    }
    qsort(t.share, (size_t)t.n, sizeof t.share[0], ascending);
    return t;
}

/* Inputs and weights of a workload, in ordinary memory. */
static void workload_make(const struct workload *l)
{
    size_t k = (size_t)l->k_segs * (size_t)l->seg, lda = l->lda ? (size_t)l->lda : k;
    size_t run = (size_t)(l->m - 1) * lda + (size_t)l->seg; // elements in all rows
    size_t na = (size_t)l->k_segs * run, nw = (size_t)l->n * k;
    int8_t *a8 = workload_room(na), *w8 = workload_room(nw);
    float *a = workload_room(4 * na), *w = workload_room(4 * nw);
    for (size_t i = 0; i < na; i++)
        a[i] = a8[i] = s8_value(ORDINARY, -127);
    for (size_t i = 0; i < nw; i++)
        w[i] = w8[i] = s8_value(ORDINARY, -128);
    s8 = (struct gemm_s8){.m = l->m,
                          .segs = l->k_segs,
                          .seg = l->seg,
                          .a = a8,
                          .lda = lda,
                          .seg_stride = run,
                          .w = w8,
                          .ldw = PANEL * k,
                          .c = workload_room(4 * PANEL * (size_t)(l->m * l->at_once)),
                          .ldc = PANEL * (size_t)l->at_once};
    f32 = (struct gemm_f32){.m = l->m,
                            .segs = l->k_segs,
                            .seg = l->seg,
                            .a = a,
                            .lda = lda,
                            .seg_stride = run,
                            .w = w,
                            .ldw = PANEL * k,
                            .c = (float *)s8.c,
                            .ldc = s8.ldc};
}

static void workload_free(void)
{
    free((void *)s8.a);
    free((void *)s8.w);
    free(s8.c);
    free((void *)f32.a);
    free((void *)f32.w);
}

/* One line: a workload on all levels. C is timed on its first rows. */
static void bench(const struct workload *l, bool floats)
{
    static const struct peak unknown = {0, 0, NULL};
    struct workload few = *l;
    struct kernels c;
    double macs = (double)l->k_segs * l->seg * l->n;
    kernels_init(&c, 0);
    workload_make(l);
    int m = s8.m;
    few.m = s8.m = f32.m = m < 4 ? m : 4;
    double c_rate = macs * few.m / take_turns(&few, &c.net, &unknown, floats).best;
    s8.m = f32.m = m;
    printf("%s %-13s %2d x %4d x %4d  c %.1f", floats ? "f32" : "s8 ", l->name, m,
           l->k_segs * l->seg, l->n, c_rate * 1e-9);
    for (int i = 0; i < LEVELS; i++) {
        struct gemm_kernels k;
        if (!level_kernels(&levels[i], &k) ||
            strcmp(floats ? k.f32_name : k.s8_name, levels[i].name) != 0)
            continue;
        struct timing t = take_turns(l, &k, peak_of(floats, levels[i].cpu), floats);
        double rate = macs * m / t.best;
        printf("  %s %.0f ns %.1f %.0fx", levels[i].name, t.best * 1e9, rate * 1e-9, rate / c_rate);
        if (t.share[0] > 0)
            printf(" %.0f%% (%.0f-%.0f)", 100 * t.share[t.n / 2], 100 * t.share[t.n / 4],
                   100 * t.share[t.n * 3 / 4]);
    }
    printf("\n");
    workload_free();
}

static void bench_all(void)
{
    printf("GMAC/s at best, ratio to C, share of what the multipliers could do: median "
           "(quartiles)\n");
    for (int i = 0; i < 2 * WORKLOADS; i++)
        bench(&workloads[i / 2], i % 2);
}

int main(int argc, char **argv)
{
    bool timing = false;
    const char *only = NULL;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--seed") == 0 && i + 1 < argc)
            trial_seed = strtoull(argv[++i], NULL, 10);
        else if (strcmp(argv[i], "--bench") == 0)
            timing = true;
        else if (strcmp(argv[i], "--only") == 0 && i + 1 < argc)
            only = argv[++i];
        else
            return fprintf(stderr, "usage: %s [--seed N] [--bench] [--only LEVEL]\n", argv[0]), 2;
    }
    printf("seed %llu\n", (unsigned long long)trial_seed);
    if (timing) {
        bench_all();
        return 0;
    }
    guard_open();
    guard_trap();
    return check_all(only) != 0;
}
