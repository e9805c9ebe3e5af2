/* trial.h - runs kernels on guarded memory, compares them with plain C and times them.
 * A float agrees if |got - want| <= bound (|want| + scale); scale is the mean |want| of its row
 * unless said. For tests only; one thread. */
#ifndef KERNELS_TRIAL_H
#define KERNELS_TRIAL_H

#include "core/base/cpu.h"
#include "core/base/splitmix.h"
#include "core/kernels/kernels.h"
#include "tests/kernels/guard.h"

#include <math.h>
#include <time.h>

enum { OUT_MAX = 1 << 15, PARTS = 16 };

enum pattern { ORDINARY, EXTREME, PATTERNS };

/* Output of a kernel, copied out of the guarded memory. */
struct part {
    const char *what;
    int at, rows, n; // first value; shape
    double bound;    // INFINITY: only has to be finite
    double scale;    // 0: mean |want| of the row
};

struct outcome {
    float v[OUT_MAX];
    int used, n_parts;
    struct part part[PARTS];
    const char *fault; // NULL = none
};

static uint64_t trial_seed = 1, trial_rng;

static inline double trial_uniform(double lo, double hi)
{
    return lo + (hi - lo) * (double)(splitmix_next(&trial_rng) >> 11) * 0x1p-53;
}

static inline float *trial_floats(size_t n)
{
    return guard_alloc(n, sizeof(float));
}

static inline float *trial_random(size_t n, double lo, double hi)
{
    float *p = trial_floats(n);
    for (size_t i = 0; i < n; i++)
        p[i] = (float)trial_uniform(lo, hi);
    return p;
}

static inline uint8_t *trial_bytes(size_t n)
{
    uint8_t *p = guard_alloc(n, 1);
    for (size_t i = 0; i < n; i++)
        p[i] = (uint8_t)trial_uniform(0, 256);
    return p;
}

/* Some values at random places become worst cases. */
static inline void trial_spoil(float *p, size_t n, const float *bad, size_t n_bad)
{
    for (size_t i = 0; i < n; i++)
        if (trial_uniform(0, 1) < 0.4)
            p[i] = bad[(size_t)trial_uniform(0, (double)n_bad)];
}

/* Scale of the part that was put last. */
static inline void trial_scale(struct outcome *o, double scale)
{
    o->part[o->n_parts - 1].scale = scale;
}

static inline double trial_largest(const float *p, int n)
{
    double top = 0;
    for (int i = 0; i < n; i++)
        top = fmax(top, fabs((double)p[i]));
    return top;
}

/* shape: rows, values that count in each, values from one row to the next. */
static inline void trial_put(struct outcome *o, const char *what, const float *p,
                             const int shape[3], double bound)
{
    int rows = shape[0], n = shape[1];
    if (o->n_parts == PARTS || o->used + rows * n > OUT_MAX) {
        fprintf(stderr, "%s: outcome is too large\n", what);
        exit(1);
    }
    o->part[o->n_parts++] = (struct part){what, o->used, rows, n, bound, 0};
    for (int r = 0; r < rows; r++, o->used += n)
        memcpy(o->v + o->used, p + r * shape[2], (size_t)n * sizeof *p);
}

/* As put, and the columns behind those that count must be untouched. */
static inline void trial_put_columns(struct outcome *o, const char *what, const float *p,
                                     const int shape[3], double bound)
{
    trial_put(o, what, p, shape, bound);
    for (int r = 0; r < shape[0]; r++)
        for (int i = shape[1]; i < shape[2]; i++)
            if (!guard_is_canary(p + r * shape[2] + i))
                o->fault = "wrote beyond a row";
}

static inline void trial_put_row(struct outcome *o, const char *what, const float *p, int n,
                                 double bound)
{
    trial_put(o, what, p, (const int[3]){1, n, n}, bound);
}

/* A kernel under test. */
struct item {
    const char *name;
    void (*make)(int size, enum pattern pattern); // input, in guarded memory
    void (*call)(const struct kernels *k);
    void (*keep)(struct outcome *o);
    int size_min, size_max, size_bench;
};

/* Around the widths 4, 8 and 16, and the largest that some kernel takes. */
static const int trial_sizes[] = {0, 1, 2, 3, 4, 5, 7, 8, 9, 13, 15, 16, 17, 31, 33, 63, 64, 100};

static const unsigned trial_levels[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2,
                                        CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};

enum {
    N_SIZES = sizeof trial_sizes / sizeof *trial_sizes,
    N_LEVELS = sizeof trial_levels / sizeof *trial_levels
};

struct trial {
    const struct item *item;
    int size;
    enum pattern pattern;
    bool at_end;
};

struct call {
    const struct item *item;
    const struct kernels *k;
};

static inline void trial_call(const void *ctx)
{
    const struct call *c = ctx;
    c->item->call(c->k);
}

static inline void trial_make(const struct trial *t)
{
    trial_rng = trial_seed * 1000003 + (uint64_t)t->size * PATTERNS + t->pattern;
    guard_reset(t->at_end);
    t->item->make(t->size, t->pattern);
}

static inline void trial_run(const struct trial *t, const struct kernels *k, struct outcome *o)
{
    static const char *const names[] = {[SIGSEGV] = "SIGSEGV: left its arrays",
                                        [SIGBUS] = "SIGBUS",
                                        [SIGILL] = "SIGILL",
                                        [SIGFPE] = "SIGFPE"};
    struct call c = {t->item, k};
    o->used = o->n_parts = 0;
    o->fault = NULL;
    trial_make(t);
    int number = guard_call(trial_call, &c);
    if (number) {
        o->fault = names[number];
        return;
    }
    t->item->keep(o);
    if (!guard_intact())
        o->fault = "wrote beside its arrays";
}

/* Largest difference of one row of part q, in units of its bound. */
static inline double trial_row(const struct part *q, const float *want, const float *got)
{
    double scale = q->scale, top = 0;
    for (int i = 0; i < q->n && q->scale == 0; i++)
        scale += fabs((double)want[i]) / q->n;
    for (int i = 0; i < q->n; i++) {
        if (want[i] == got[i] || (isnan(want[i]) && isnan(got[i])) ||
            (isinf(q->bound) && isfinite(got[i])))
            continue;
        double size = fabs((double)want[i]) + scale;
        double d = fabs((double)got[i] - (double)want[i]) / (q->bound * size);
        top = d <= top ? top : isnan(d) ? INFINITY : d;
    }
    return top;
}

/* Largest difference in units of the bound; 1 and less is good. *what names its part. */
static inline double trial_worst(const struct outcome *want, const struct outcome *got,
                                 const char **what)
{
    double top = 0;
    for (int p = 0; p < want->n_parts; p++)
        for (int r = 0; r < want->part[p].rows; r++) {
            const struct part *q = &want->part[p];
            double d = trial_row(q, want->v + q->at + r * q->n, got->v + q->at + r * q->n);
            *what = d > top ? q->what : *what;
            top = fmax(d, top);
        }
    return top;
}

/* Returns the number of failures of one item on one level; adds to *top. */
static inline int trial_check(const struct item *item, const struct kernels *k, double *top)
{
    static struct outcome want, got;
    struct kernels c;
    int failures = 0;
    kernels_init(&c, 0);
    for (int i = 0; i < N_SIZES * PATTERNS * 2; i++) {
        struct trial t = {item, trial_sizes[i / (2 * PATTERNS)], i / 2 % PATTERNS, i % 2};
        const char *what = "";
        if (t.size < item->size_min || t.size > item->size_max)
            continue;
        trial_run(&t, &c, &want);
        trial_run(&t, k, &got);
        const char *fault = want.fault ? want.fault : got.fault;
        double d = fault ? 0 : trial_worst(&want, &got, &what);
        *top = d > *top ? d : *top;
        if (!fault && d <= 1)
            continue;
        failures++;
        printf("%s %s, size %d, %s input, arrays %s a page: ", k->name, item->name, t.size,
               t.pattern ? "extreme" : "ordinary", t.at_end ? "end" : "start");
        if (fault)
            printf("%s%s\n", want.fault ? "plain C: " : "", fault);
        else
            printf("%s differs by %.3g bounds\n", what, d);
    }
    return failures;
}

static inline double trial_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Best of five, ns. */
static inline double trial_time(const struct item *item, const struct kernels *k)
{
    struct trial t = {item, item->size_bench, ORDINARY, true};
    double best = INFINITY;
    trial_make(&t);
    for (int round = 0; round < 5; round++) {
        double start = trial_seconds(), took = 0;
        int n = 0;
        for (; took < 0.02; took = trial_seconds() - start)
            for (int i = 0; i < 20; i++, n++)
                item->call(k);
        best = fmin(best, took * 1e9 / n);
    }
    return best;
}

static inline void trial_bench(const struct item *item)
{
    double c_ns = 0;
    printf("%-14s", item->name);
    for (int l = 0; l < N_LEVELS; l++) {
        struct kernels k;
        if ((cpu_detect() & trial_levels[l]) != trial_levels[l])
            continue;
        kernels_init(&k, trial_levels[l]);
        double ns = trial_time(item, &k);
        c_ns = l == 0 ? ns : c_ns;
        printf("  %s %.0f ns", k.name, ns);
        if (l > 0)
            printf(" (%.1fx)", c_ns / ns);
    }
    printf("\n");
}

#endif
