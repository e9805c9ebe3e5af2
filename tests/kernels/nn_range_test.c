/* Row kernels of the network where many values count, on every instruction set of this machine:
 * activations over their range, and attention over more keys than any capture has, both against
 * double precision.
 * nn_range_test [--seed N] */
#include "tests/kernels/trial.h"

/* --- activations --------------------------------------------------------------------------- */

static double activate(enum activation act, double v)
{
    return act == ACT_RELU   ? fmax(v, 0)
           : act == ACT_GELU ? 0.5 * v * erfc(-v * sqrt(0.5))
           : act == ACT_SILU ? v / (1 + exp(-v))
                             : v;
}

/* Activations alone: within 5e-7 |v| of GELU and 1e-6 |v| of SiLU, for numbers far below 1 too. A
 * value does not depend on the lane that it is in. */
static int check_activation(const struct kernels *k, enum activation act, double bound)
{
    enum { N = 61, STEPS = 4000 };
    float v[N], row[N], one;
    double top = 0;
    int moved = 0;
    for (int step = 0; step < STEPS; step++) {
        for (int i = 0; i < N; i++) {
            double x = ((double)(step * N + i) + trial_uniform(0, 1)) / (STEPS * N) * 2 - 1;
            v[i] = (float)(step % 2 ? x * 12 : pow(x, 5) * 1000);
        }
        struct epilogue e = {.m = 1, .n = N, .cf = v, .ldc = N, .act = act, .out = row, .ldo = N};
        k->net.epilogue(&e);
        e.n = 1;
        e.out = &one;
        for (int i = 0; i < N; i++) {
            double d = fabs((double)row[i] - activate(act, (double)v[i]));
            top = fmax(top, d / (fabs((double)v[i]) + 1e-30) / bound);
            e.cf = v + i;
            k->net.epilogue(&e);
            moved += memcmp(&one, row + i, sizeof one) != 0;
        }
    }
    if (moved)
        printf("%d values depend on their lane\n", moved);
    printf("%s %s %s over its range, error %.2f of the bound\n",
           top <= 1 && !moved ? "ok" : "FAILED", k->name, act == ACT_GELU ? "GELU" : "SiLU", top);
    return top > 1 || moved;
}

/* Activations do not hide an overflow: NaN and infinity stay. */
static int check_overflow(const struct kernels *k)
{
    int lost = 0;
    for (int act = ACT_NONE; act <= ACT_SILU; act++)
        for (int i = 0; i < 37; i++) {
            float v[37] = {0}, out[37];
            const struct epilogue e = {
                .m = 1, .n = 37, .cf = v, .ldc = 37, .act = act, .out = out, .ldo = 37};
            v[i] = NAN;
            k->net.epilogue(&e);
            lost += !isnan(out[i]);
            v[i] = INFINITY;
            k->net.epilogue(&e);
            lost += isfinite(out[i]);
        }
    printf("%s %s activations keep what is not finite\n", lost ? "FAILED" : "ok", k->name);
    return lost != 0;
}

/* --- streaming softmax --------------------------------------------------------------------- */

enum { KEYS = 20000, BLOCK = 128, WIDTH = 24, QUERIES = 5 };

static struct {
    float logit[QUERIES][KEYS], value[KEYS][WIDTH];
    int8_t value8[KEYS][WIDTH];
    float top[QUERIES], sum[QUERIES], rescale[QUERIES], weigh[QUERIES], o[QUERIES][WIDTH];
} stream;

/* Rows of different temper: flat, ordinary, sharp, rising so that every block has a new top, one
 * key far above the others. */
static void stream_make(void)
{
    trial_rng = trial_seed;
    for (int j = 0; j < KEYS; j++) {
        for (int i = 0; i < QUERIES; i++)
            stream.logit[i][j] = (float)trial_uniform(-1, 1) * (i == 1 ? 4.0f : i == 2 ? 80.0f : 1);
        stream.logit[0][j] = 3;
        stream.logit[3][j] = 0.01f * (float)j;
        for (int c = 0; c < WIDTH; c++) {
            stream.value8[j][c] = (int8_t)trial_uniform(-127, 128);
            stream.value[j][c] = (float)stream.value8[j][c] / 127;
        }
    }
    stream.logit[4][KEYS / 3] = 1000;
    for (int i = 0; i < QUERIES; i++) {
        stream.top[i] = -INFINITY;
        stream.sum[i] = 0;
    }
    memset(stream.o, 0, sizeof stream.o);
}

/* Logits of integers are multiples of 1e-4. */
static void stream_block(const struct kernels *k, int first, int n, bool ints)
{
    static int32_t si[QUERIES][BLOCK], ci[QUERIES][WIDTH];
    static float pf[QUERIES][BLOCK], cf[QUERIES][WIDTH], unit[QUERIES], scale[WIDTH];
    static int8_t pi[QUERIES][BLOCK];
    static int32_t shift[WIDTH];
    for (int i = 0; i < QUERIES; i++) {
        unit[i] = ints ? 1e-4f : 1;
        for (int j = 0; j < n; j++) {
            si[i][j] = (int32_t)rintf(stream.logit[i][first + j] * 1e4f);
            pf[i][j] = stream.logit[i][first + j];
        }
    }
    const struct attend_block b = {QUERIES, n,     ints ? si[0] : NULL, pf[0],       BLOCK,
                                   unit,    NULL,  stream.top,          stream.sum,  pi[0],
                                   pf[0],   BLOCK, stream.rescale,      stream.weigh};
    k->net.attend_block(&b);
    for (int c = 0; c < WIDTH; c++) {
        shift[c] = 0;
        for (int j = 0; j < n; j++)
            shift[c] += 127 * stream.value8[first + j][c];
    }
    for (int i = 0; i < QUERIES; i++)
        for (int c = 0; c < WIDTH; c++) {
            scale[c] = ints ? 1 / 127.0f : 1;
            ci[i][c] = 0;
            cf[i][c] = 0;
            for (int j = 0; ints && j < n; j++)
                ci[i][c] += pi[i][j] * stream.value8[first + j][c];
            for (int j = 0; !ints && j < n; j++)
                cf[i][c] += pf[i][j] * stream.value[first + j][c];
        }
    const struct attend_add a = {
        QUERIES, n ? WIDTH : 0, ints ? ci[0] : NULL, cf[0], WIDTH, stream.rescale, stream.weigh,
        scale,   shift,         stream.o[0],         WIDTH};
    k->net.attend_add(&a);
}

/* Largest error of a row of values, and the most that is allowed. Rounding moves a weight by at
 * most 0.55 / 254 of the largest of its block, and a small one by itself, to 0; that moves the
 * mean by its distance from the value, at most 2. */
static double stream_error(int i, bool ints, double *limit)
{
    static double w[KEYS];
    double top = -INFINITY, sum = 0, moved = 0, worst = 0;
    for (int j = 0; j < KEYS; j++)
        top = fmax(top, (double)stream.logit[i][j]);
    for (int first = 0; first < KEYS; first += BLOCK) {
        double most = 0;
        int n = KEYS - first < BLOCK ? KEYS - first : BLOCK;
        for (int j = first; j < first + n; j++) {
            w[j] = exp((double)stream.logit[i][j] - top);
            sum += w[j];
            most = fmax(most, w[j]);
        }
        for (int j = first; j < first + n; j++)
            moved += fmin(w[j], most * 0.55 / 254);
    }
    for (int c = 0; c < WIDTH; c++) {
        double mean = 0;
        for (int j = 0; j < KEYS; j++)
            mean += w[j] / sum * (double)stream.value[j][c];
        worst = fmax(worst, fabs((double)(stream.o[i][c] / stream.sum[i]) - mean));
    }
    *limit = 1e-6 + (ints ? 2 * moved / (sum - moved) : 0);
    return worst;
}

static int check_stream(const struct kernels *k, bool ints)
{
    int failures = 0;
    stream_make();
    for (int first = 0; first < KEYS; first += BLOCK)
        stream_block(k, first, KEYS - first < BLOCK ? KEYS - first : BLOCK, ints);
    for (int i = 0; i < QUERIES; i++) {
        double limit, error = stream_error(i, ints, &limit);
        bool bad = !(error <= limit);
        printf("%s %s softmax over %d keys, %s, row %d: error %.2g of at most %.2g\n",
               bad ? "FAILED" : "ok", k->name, KEYS, ints ? "integers" : "floats", i, error, limit);
        failures += bad;
    }
    return failures;
}

/* --- logits beyond all reason -------------------------------------------------------------- */

/* The largest of integer logits around `size` takes all of the weight, though fused and rounded
 * products of that size differ by far more than 1. */
static int check_huge(const struct kernels *k, float size)
{
    enum { BEST = 37, N = 61 };
    static int32_t si[BLOCK];
    static int8_t pi[BLOCK];
    float unit = size / 16000, scale[N], top = -INFINITY, sum = 0, rescale, weigh;
    trial_rng = trial_seed;
    for (int j = 0; j < N; j++) {
        scale[j] = (float)trial_uniform(0.2, 0.3);
        si[j] = (int32_t)trial_uniform(-16000, 16000);
    }
    si[BEST] = size < 0 ? -60000 : 60000;
    unit = fabsf(unit);
    for (int j = 0; j < N && size < 0; j++)
        si[j] -= j == BEST ? -59000 : 60000; // all below 0
    const struct attend_block b = {1,    N,    si, NULL, BLOCK, &unit,    scale,
                                   &top, &sum, pi, NULL, BLOCK, &rescale, &weigh};
    k->net.attend_block(&b);
    bool bad = !(fabsf(sum - 1) < 1e-5f);
    for (int j = 0; j < N; j++)
        bad |= pi[j] != (j == BEST ? 127 : -127);
    printf("%s %s logits of %g: sum %g, largest %d\n", bad ? "FAILED" : "ok", k->name, (double)size,
           (double)sum, pi[BEST]);
    return bad;
}

/* --- all of them --------------------------------------------------------------------------- */

static int check_level(unsigned cpu)
{
    struct kernels k;
    if ((cpu_detect() & cpu) != cpu)
        return 0;
    kernels_init(&k, cpu);
    return check_overflow(&k) + check_activation(&k, ACT_GELU, 5e-7) +
           check_activation(&k, ACT_SILU, 1e-6) + check_stream(&k, false) + check_stream(&k, true) +
           check_huge(&k, 1e6f) + check_huge(&k, 1e13f) + check_huge(&k, -1e13f) +
           check_huge(&k, 1e35f);
}

int main(int argc, char **argv)
{
    int failures = 0;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--seed") == 0 && i + 1 < argc)
            trial_seed = strtoull(argv[++i], NULL, 10);
        else
            return fprintf(stderr, "usage: %s [--seed N]\n", argv[0]), 2;
    }
    printf("seed %llu\n", (unsigned long long)trial_seed);
    for (int l = 0; l < N_LEVELS; l++)
        failures += check_level(trial_levels[l]);
    return failures != 0;
}
