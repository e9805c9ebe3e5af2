/* The row kernels of the network on every instruction set of this machine, plain C included,
 * against the same in double precision: all lengths around the width of vectors, ordinary and
 * extreme input, arrays that end or start at inaccessible pages.
 * nn_test [--seed N] [--bench]
 * Bounds are stated in the `keep` functions. absmax, quant and hadamard must give equal bits on all
 * instruction sets. */
#include "tests/kernels/trial.h"

#include <float.h>

/* A slot, with what its results should be; `variant` chooses among the forms of its contract. */
struct slot {
    struct item item;
    void (*truth)(struct outcome *o);
    int variants;
    bool exact; // the same bits as plain C
};

static int variant;

static bool bit(int k)
{
    return variant >> k & 1;
}

/* Inputs and outputs of the slots; each uses those of its contract. */
enum { CAP = 1 << 14 };
static struct {
    int n, block;
    size_t ld;
    float *x, *y;
    float before[CAP]; // copy of data that is overwritten
    int8_t *q;
    float inv;
    struct norm norm;
    struct epilogue epilogue;
    struct head_rotary turn;
    struct attend_block block_in;
    struct attend_add add;
    float old_top[CAP / 128], old_sum[CAP / 128];
} in;

static double want[1 << 15]; // for one part

static float *half_random(bool given, int n, double lo, double hi)
{
    return given ? trial_random((size_t)n, lo, hi) : NULL;
}

static void put_want(struct outcome *o, const char *what, int rows, int n)
{
    static float rounded[OUT_MAX];
    for (int i = 0; i < rows * n; i++)
        rounded[i] = (float)want[i];
    trial_put(o, what, rounded, (const int[3]){rows, n, n}, 0);
}

/* --- absmax, quant ------------------------------------------------------------------------- */

static const float odd[] = {0,     -0.0f,  1e-45f,   -1e-40f,   1e-38f, 3e-37f,
                            1e30f, -3e38f, INFINITY, -INFINITY, NAN};

enum { N_ODD = sizeof odd / sizeof *odd };

/* variant: how much of the list above is possible */
static void absmax_make(int size, enum pattern pattern)
{
    static const size_t kinds[] = {N_ODD, 6, 4, 8};
    in.n = size;
    in.x = trial_random((size_t)size, -3, 3);
    for (int i = 0; pattern == EXTREME && variant % 2 && i < size; i++)
        in.x[i] = 0;
    if (pattern == EXTREME)
        trial_spoil(in.x, (size_t)size, odd, kinds[variant]);
    in.y = trial_floats(1);
}

static void absmax_call(const struct kernels *k)
{
    *in.y = k->net.absmax(in.x, (size_t)in.n);
}

static void absmax_keep(struct outcome *o)
{
    trial_put_row(o, "largest", in.y, 1, 0);
}

static double largest(void)
{
    double top = 0;
    for (int i = 0; i < in.n; i++)
        top = isnan(in.x[i]) || isnan(top) ? NAN : fmax(top, fabs((double)in.x[i]));
    return top;
}

static void absmax_truth(struct outcome *o)
{
    want[0] = largest();
    put_want(o, "largest", 1, 1);
}

/* variants 4 and 5: exactly between two integers; one value a thousand times the others */
static void quant_make(int size, enum pattern pattern)
{
    in.n = size;
    if (variant < 4)
        absmax_make(size, pattern);
    else
        in.x = trial_random((size_t)size, -1, 1);
    for (int i = 0; variant == 4 && i < size; i++)
        in.x[i] = (float)(i % 127) * (pattern == EXTREME ? -1.0f : 1.0f) + 0.5f;
    if (size && variant >= 4)
        in.x[size / 2] = variant == 4 ? 127 : 1000;
    float top = (float)largest();
    in.inv = top < FLT_MIN ? 0 : 127 / top;
    in.q = guard_alloc((size_t)size, 1);
}

static void quant_call(const struct kernels *k)
{
    k->net.quant(in.x, (size_t)in.n, in.inv, in.q);
}

static void quant_keep(struct outcome *o)
{
    static float q[CAP];
    for (int i = 0; i < in.n; i++)
        q[i] = in.q[i];
    trial_put_row(o, "integers", q, in.n, 0);
}

static void quant_truth(struct outcome *o)
{
    for (int i = 0; i < in.n; i++) {
        float v = (float)((double)in.x[i] * (double)in.inv);
        want[i] = isnan(v) ? 0 : fmin(fmax(nearbyint((double)v), -127), 127);
    }
    put_want(o, "integers", 1, in.n);
}

/* --- hadamard ------------------------------------------------------------------------------ */

/* size: blocks; variant: log2 of their length, less 2 */
static void hadamard_make(int size, enum pattern pattern)
{
    in.block = 4 << variant;
    in.n = size * in.block;
    in.x = trial_random((size_t)in.n, -1, 1);
    if (pattern == EXTREME && in.n)
        in.x[(int)trial_uniform(0, in.n)] = 1000;
    memcpy(in.before, in.x, (size_t)in.n * sizeof *in.x);
}

static void hadamard_call(const struct kernels *k)
{
    k->net.hadamard(in.x, in.n, in.block);
}

static void hadamard_keep(struct outcome *o)
{
    double all = 0;
    for (int i = 0; i < in.n; i++)
        all += fabs((double)in.before[i]) / sqrt(in.block);
    trial_put_row(o, "rotated", in.x, in.n, 3e-7);
    trial_scale(o, all + 1e-9);
}

static void hadamard_truth(struct outcome *o)
{
    for (int i = 0; i < in.n; i++) {
        const float *x = in.before + i / in.block * in.block;
        want[i] = 0;
        for (int j = 0; j < in.block; j++)
            want[i] += __builtin_parity((unsigned)((i % in.block & j) ^ (j & j >> 1)))
                           ? -(double)x[j]
                           : (double)x[j];
        want[i] /= sqrt(in.block);
    }
    put_want(o, "rotated", 1, in.n);
}

/* --- norm ---------------------------------------------------------------------------------- */

/* variant: gamma and beta given; y is x; mean far from 0; eps 1e-6 instead of 1e-5 */
static void norm_make(int size, enum pattern pattern)
{
    double mean = bit(2) ? 1e6 : 0.3;
    in.n = size;
    in.x = trial_random((size_t)size, mean - 1.7, mean + 1.7);
    if (pattern == EXTREME)
        switch (size % 4) {
        case 0:
            in.x[size / 2] = 1000;
            break;
        case 1:
            for (int i = 0; i < size; i++)
                in.x[i] = (float)mean;
            break;
        case 2:
            for (int i = 0; i < size; i++)
                in.x[i] *= 1e-40f;
            break;
        default:
            for (int i = 0; i < size; i++)
                in.x[i] *= bit(2) ? 1e9f : 1e14f;
        }
    in.y = bit(1) ? in.x : trial_floats((size_t)size);
    memcpy(in.before, in.x, (size_t)size * sizeof *in.x);
    in.norm = (struct norm){size, bit(3) ? 1e-6f : 1e-5f, half_random(bit(0), size, -2, 2),
                            half_random(bit(0), size, -2, 2)};
}

static void norm_call(const struct kernels *k)
{
    k->net.norm(&in.norm, in.x, in.y);
}

static void norm_keep(struct outcome *o)
{
    trial_put_row(o, "normal", in.y, in.n, 1e-6);
    trial_scale(o, 1);
}

static void norm_want(const struct norm *s, const float *x)
{
    double mean = 0, var = 0;
    for (int i = 0; i < s->n; i++)
        mean += ((double)x[i] - (double)x[0]) / s->n;
    mean += (double)x[0];
    for (int i = 0; i < s->n; i++)
        var += ((double)x[i] - mean) * ((double)x[i] - mean) / s->n;
    for (int i = 0; i < s->n; i++)
        want[i] = ((double)x[i] - mean) / sqrt(var + (double)s->eps) *
                      (s->gamma ? (double)s->gamma[i] : 1) +
                  (s->beta ? (double)s->beta[i] : 0);
}

static void norm_truth(struct outcome *o)
{
    norm_want(&in.norm, in.before);
    put_want(o, "normal", 1, in.n);
}

/* --- epilogue ------------------------------------------------------------------------------ */

static double activate(enum activation act, double v)
{
    return act == ACT_RELU   ? fmax(v, 0)
           : act == ACT_GELU ? 0.5 * v * erfc(-v * sqrt(0.5))
           : act == ACT_SILU ? v / (1 + exp(-v))
                             : v;
}

enum { M = 3 };

/* Sums of M rows, of integers or floats; returns the part that is not NULL. */
static void sums_make(bool ints, enum pattern pattern, const int32_t **ci, const float **cf)
{
    size_t all = (M - 1) * in.ld + (size_t)in.n;
    float *f = trial_random(all, -5, 5);
    if (pattern == EXTREME)
        trial_spoil(f, all, (const float[]){0, -2000, 90, -90, 1e-40f, 1e-6f, -1e-6f}, 7);
    int32_t *i = ints ? guard_alloc(all, sizeof *i) : NULL;
    for (size_t k = 0; ints && k < all; k++)
        i[k] = pattern == EXTREME && k % 3 == 0 ? (k % 2 ? INT32_MAX : INT32_MIN)
                                                : (int32_t)(f[k] * 1000);
    *ci = i;
    *cf = ints ? NULL : f;
}

/* variant: activation (2 bits), add, integers, scales and bias given, gamma given */
static void epilogue_make(int size, enum pattern pattern)
{
    struct epilogue *e = &in.epilogue;
    in.n = size;
    in.ld = (size_t)size + (size_t)size % 3;
    *e = (struct epilogue){.m = M, .n = size, .ldc = in.ld, .ldo = in.ld + 1};
    e->act = (enum activation)(variant & 3);
    e->add = bit(2);
    sums_make(bit(3), pattern, &e->ci, &e->cf);
    if (bit(4) || bit(3)) {
        double unit = pattern == ORDINARY ? 1e-3 : 1e-8;
        e->row_scale = trial_random(M, 0.5, 2);
        e->scale = trial_random((size_t)size, unit / 2, unit);
    }
    e->bias = half_random(bit(4), size, -1, 1);
    e->gamma = half_random(bit(2) && bit(5), size, -1, 1);
    e->out = trial_floats((M - 1) * e->ldo + (size_t)size);
    for (int i = 0; e->add && i < M; i++)
        for (int j = 0; j < size; j++)
            e->out[(size_t)i * e->ldo + (size_t)j] = (float)trial_uniform(-1, 1);
    memcpy(in.before, e->out, ((M - 1) * e->ldo + (size_t)size) * sizeof *e->out);
}

static void epilogue_call(const struct kernels *k)
{
    k->net.epilogue(&in.epilogue);
}

/* The largest term that is rounded; activations bend by at most 1.13. */
static double epilogue_size(void)
{
    const struct epilogue *e = &in.epilogue;
    double top = 1;
    for (size_t i = 0; i < M; i++)
        for (size_t j = 0; j < (size_t)in.n; j++) {
            double v = e->ci ? e->ci[i * e->ldc + j] : (double)e->cf[i * e->ldc + j];
            v *= e->scale ? (double)e->scale[j] * (double)e->row_scale[i] : 1;
            top = fmax(top, fabs(v));
        }
    return top;
}

static void rows_keep(struct outcome *o, const char *what, const float *out, size_t ld,
                      double scale)
{
    trial_put(o, what, out, (const int[3]){M, in.n, (int)ld}, 5e-7);
    trial_scale(o, scale);
    for (size_t i = 0; i + 1 < M; i++)
        for (size_t j = (size_t)in.n; j < ld; j++)
            if (!guard_is_canary(out + i * ld + j))
                o->fault = "wrote beyond a row";
}

static void epilogue_keep(struct outcome *o)
{
    rows_keep(o, "finished", in.epilogue.out, in.epilogue.ldo, epilogue_size());
}

static void epilogue_truth(struct outcome *o)
{
    const struct epilogue *e = &in.epilogue;
    for (size_t i = 0, at = 0; i < M; i++)
        for (size_t j = 0; j < (size_t)in.n; j++, at++) {
            double v = e->ci ? e->ci[i * e->ldc + j] : (double)e->cf[i * e->ldc + j];
            v *= e->row_scale ? (double)e->row_scale[i] : 1;
            v *= e->scale ? (double)e->scale[j] : 1;
            v = activate(e->act, v + (e->bias ? (double)e->bias[j] : 0));
            double old = e->add ? (double)in.before[i * e->ldo + j] : 0;
            want[at] = e->add ? old + (e->gamma ? (double)e->gamma[j] : 1) * v : v;
        }
    put_want(o, "finished", M, in.n);
}

/* --- head_rotary ----------------------------------------------------------------------------- */

/* size: sixteenths of the width; variant: layer norm, copy before the turn, turn */
static void turn_make(int size, enum pattern pattern)
{
    int n = in.n = 16 * size;
    in.x = trial_random((size_t)n, -2, 3);
    for (int i = 0; pattern == EXTREME && i < n; i++)
        in.x[i] = size % 2 ? 5 : i == n / 3 ? 1000 : in.x[i];
    memcpy(in.before, in.x, (size_t)n * sizeof *in.x);
    in.turn = (struct head_rotary){.n = n,
                                   .gamma = half_random(bit(0), n, -2, 2),
                                   .beta = half_random(bit(0), n, -2, 2),
                                   .before = bit(1) ? trial_floats((size_t)n) : NULL};
    float *c = half_random(bit(2), n / 2, 0, 6.3), *s = half_random(bit(2), n / 2, 0, 1);
    for (int i = 0; bit(2) && i < n / 2; i++) {
        s[i] = sinf(c[i]);
        c[i] = cosf(c[i]);
    }
    in.turn.cosine = c;
    in.turn.sine = s;
}

static void turn_call(const struct kernels *k)
{
    k->net.head_rotary(&in.turn, in.x);
}

static void turn_keep(struct outcome *o)
{
    double scale = bit(0) ? 20 : trial_largest(in.before, in.n);
    trial_put_row(o, "turned", in.x, in.n, 5e-7);
    trial_scale(o, scale);
    if (in.turn.before)
        trial_put_row(o, "before", in.turn.before, in.n, 5e-7);
    if (in.turn.before)
        trial_scale(o, scale);
}

static void turn_truth(struct outcome *o)
{
    double plain[128];
    int n = in.n, quarter = n / 4;
    for (int i = 0; i < n; i++)
        want[i] = (double)in.before[i];
    if (in.turn.gamma)
        norm_want(&(struct norm){n, 1e-5f, in.turn.gamma, in.turn.beta}, in.before);
    memcpy(plain, want, (size_t)n * sizeof *want);
    for (int half = 0; in.turn.cosine && half < 2; half++)
        for (int i = 0; i < quarter; i++) {
            int a = 2 * half * quarter + i, b = a + quarter;
            double c = (double)in.turn.cosine[half * quarter + i];
            double s = (double)in.turn.sine[half * quarter + i];
            want[a] = plain[a] * c - plain[b] * s;
            want[b] = plain[b] * c + plain[a] * s;
        }
    put_want(o, "turned", 1, n);
    memcpy(want, plain, (size_t)n * sizeof *want);
    if (in.turn.before)
        put_want(o, "before", 1, n);
}

/* --- attend_block -------------------------------------------------------------------------- */

static double logit(size_t i, size_t j)
{
    const struct attend_block *b = &in.block_in;
    double s = b->si ? b->si[i * b->lds + j] : (double)in.before[i * b->lds + j];
    return s * (double)b->row_scale[i] * (b->key_scale ? (double)b->key_scale[j] : 1);
}

static double logit_top(size_t i)
{
    double top = -INFINITY;
    for (int j = 0; j < in.n; j++)
        top = fmax(top, logit(i, (size_t)j));
    return top;
}

/* Logits are of size 4; extreme: all equal, in +-80, in +-1e4, one far above the others. */
static float logit_random(enum pattern pattern, int i, int j)
{
    static const float reach[] = {0, 80, 1e4f, 4};
    float x = (float)trial_uniform(-1, 1);
    if (pattern == ORDINARY)
        return 4 * x;
    return i % 4 == 3 && j == in.n / 2 ? 1000 : x * reach[i % 4];
}

static const int block_rows[] = {1, 5, 17, 64};

/* variant: integers, key scales, not the first block, in place; rows (2 bits) */
static void block_make(int size, enum pattern pattern)
{
    struct attend_block *b = &in.block_in;
    int m = block_rows[variant >> 4], pad = (size + 3) / 4 * 4;
    in.n = size;
    in.ld = (size_t)size + (size_t)size % 3;
    *b = (struct attend_block){.m = m, .n = size, .lds = in.ld, .ldp = (size_t)pad + (size_t)m % 5};
    size_t all = (size_t)(m - 1) * in.ld + (size_t)size;
    float *s = trial_floats(all), *keys = half_random(bit(1), size, 0.5, 1);
    for (int i = 0; i < m; i++)
        for (int j = 0; j < size; j++)
            s[(size_t)i * in.ld + (size_t)j] = logit_random(pattern, i, j);
    memcpy(in.before, s, all * sizeof *s);
    int32_t *ints = bit(0) ? guard_alloc(all, sizeof *ints) : NULL;
    for (size_t k = 0; ints && k < all; k++)
        ints[k] = (int32_t)(in.before[k] * 1000);
    b->si = ints;
    b->sf = ints ? NULL : s;
    b->row_scale = trial_random((size_t)m, ints ? 5e-4 : 0.5, ints ? 1e-3 : 1);
    b->key_scale = keys;
    b->top = trial_random((size_t)m, -3, 5);
    b->sum = trial_random((size_t)m, 1, 100);
    for (int i = 0; i < m; i++) {
        b->top[i] = bit(2) ? b->top[i] : -INFINITY;
        b->sum[i] = bit(2) ? b->sum[i] : 0;
        in.old_top[i] = b->top[i];
        in.old_sum[i] = b->sum[i];
    }
    b->ldp = !ints && bit(3) ? in.ld : b->ldp;
    b->pi = ints ? guard_alloc((size_t)(m - 1) * b->ldp + (size_t)pad, 1) : NULL;
    if (!ints)
        b->pf = bit(3) ? s : trial_floats((size_t)(m - 1) * b->ldp + (size_t)size);
    b->rescale = trial_floats((size_t)m);
    b->weigh = trial_floats((size_t)m);
}

static void block_call(const struct kernels *k)
{
    k->net.attend_block(&in.block_in);
}

/* Weights as floats, those of integers from 0 on, (m, n); looks at what lies between rows. */
static void block_weights(struct outcome *o, float *out)
{
    const struct attend_block *b = &in.block_in;
    const size_t n = (size_t)b->n, pad = (n + 3) / 4 * 4;
    for (size_t i = 0; i < (size_t)b->m; i++)
        for (size_t j = 0; j < b->ldp && (j < pad || i + 1 < (size_t)b->m); j++) {
            size_t at = i * b->ldp + j;
            uint8_t canary = (uint8_t)(GUARD_CANARY >> 8 * (at % 4));
            if (j < n)
                out[i * n + j] = b->si ? 127 + b->pi[at] : b->pf[at];
            else if (b->si && j < pad && b->pi[at] != 0)
                o->fault = "columns behind the keys are not 0";
            else if (b->si && j >= pad && (uint8_t)b->pi[at] != canary)
                o->fault = "wrote beyond a row";
            else if (!b->si && b->pf != b->sf && i + 1 < (size_t)b->m &&
                     !guard_is_canary(b->pf + at))
                o->fault = "wrote beyond a row";
        }
}

/* Logits of size L are rounded to 1.2e-7 L, and so are weights relative to themselves; integers
 * are within 0.55 of 254 times the weight besides. The sum is that of the kernel's own weights. */
static void block_keep(struct outcome *o)
{
    static float p[CAP], sum[64];
    const struct attend_block *b = &in.block_in;
    double size = 1, blur;
    for (size_t i = 0; i < (size_t)b->m; i++)
        for (size_t j = 0; j < (size_t)b->n; j++)
            size = fmax(size, fabs(logit(i, j)));
    blur = 1e-6 + 3e-7 * size;
    block_weights(o, p);
    for (int i = 0; i < b->m; i++) {
        double all = 0;
        for (int j = 0; j < b->n; j++)
            all += (double)p[i * b->n + j];
        all = all * (double)b->weigh[i] + (double)(in.old_sum[i] * b->rescale[i]);
        sum[i] = (float)((double)b->sum[i] / all);
    }
    trial_put(o, "weights", p, (const int[3]){b->m, b->n, b->n},
              b->si ? (0.55 + 254 * blur) * 1e-6 : blur);
    trial_scale(o, b->si ? 1e6 : 1e-30);
    trial_put_row(o, "sum", sum, b->m, 1e-6);
    trial_put_row(o, "top", b->top, b->m, 2e-7);
    trial_put_row(o, "rescale", b->rescale, b->m, blur);
    trial_scale(o, 1e-30);
    trial_put_row(o, "weigh", b->weigh, b->m, blur);
    trial_scale(o, 1e-30);
}

static void block_truth(struct outcome *o)
{
    const struct attend_block *b = &in.block_in;
    double top[64], all[64];
    for (size_t i = 0; i < (size_t)b->m; i++) {
        top[i] = logit_top(i);
        all[i] = fmax(top[i], (double)in.old_top[i]);
        for (size_t j = 0; j < (size_t)b->n; j++) {
            double x = logit(i, j);
            want[i * (size_t)b->n + j] = b->si ? 254 * exp(x - top[i]) : exp(x - all[i]);
        }
    }
    put_want(o, "weights", b->m, b->n);
    for (int i = 0; i < b->m; i++)
        want[i] = 1;
    put_want(o, "sum", 1, b->m);
    memcpy(want, all, sizeof all);
    put_want(o, "top", 1, b->m);
    for (int i = 0; i < b->m; i++)
        want[i] = exp((double)in.old_top[i] - all[i]);
    put_want(o, "rescale", 1, b->m);
    for (int i = 0; i < b->m; i++)
        want[i] = b->si ? exp(top[i] - all[i]) / 254 : 1;
    put_want(o, "weigh", 1, b->m);
}

/* --- attend_add ---------------------------------------------------------------------------- */

/* variant: integers, value scales */
static void add_make(int size, enum pattern pattern)
{
    struct attend_add *a = &in.add;
    in.n = size;
    in.ld = (size_t)size + (size_t)size % 3;
    *a = (struct attend_add){.m = M, .n = size, .ldc = in.ld, .ldo = in.ld + 1};
    sums_make(bit(0), pattern, &a->ci, &a->cf);
    a->rescale = trial_random(M, 0, 1);
    a->weigh = trial_random(M, 0, pattern == EXTREME ? 1e-9 : 1e-3);
    a->value_scale = half_random(bit(1), size, 0, 1);
    int32_t *shift = bit(0) ? guard_alloc((size_t)size, sizeof *shift) : NULL;
    for (int j = 0; shift && j < size; j++)
        shift[j] = (int32_t)trial_uniform(-2e6, 2e6);
    a->shift = shift;
    a->o = trial_floats((M - 1) * a->ldo + (size_t)size);
    for (int i = 0; i < M; i++)
        for (int j = 0; j < size; j++)
            a->o[(size_t)i * a->ldo + (size_t)j] = (float)trial_uniform(-1, 1);
    memcpy(in.before, a->o, ((M - 1) * a->ldo + (size_t)size) * sizeof *a->o);
}

static void add_call(const struct kernels *k)
{
    k->net.attend_add(&in.add);
}

static void add_keep(struct outcome *o)
{
    rows_keep(o, "values", in.add.o, in.add.ldo, 5);
}

static void add_truth(struct outcome *o)
{
    const struct attend_add *a = &in.add;
    for (size_t i = 0, at = 0; i < M; i++)
        for (size_t j = 0; j < (size_t)in.n; j++, at++) {
            double v =
                a->ci ? (double)a->ci[i * a->ldc + j] + a->shift[j] : (double)a->cf[i * a->ldc + j];
            v *= (double)a->weigh[i] * (a->value_scale ? (double)a->value_scale[j] : 1);
            want[at] = (double)in.before[i * a->ldo + j] * (double)a->rescale[i] + v;
        }
    put_want(o, "values", M, in.n);
}

/* --- all of them --------------------------------------------------------------------------- */

static const struct slot slots[] = {
    {{"absmax", absmax_make, absmax_call, absmax_keep, 0, 2048, 1024}, absmax_truth, 4, true},
    {{"quant", quant_make, quant_call, quant_keep, 0, 2048, 1024}, quant_truth, 6, true},
    {{"hadamard", hadamard_make, hadamard_call, hadamard_keep, 0, 2, 1}, hadamard_truth, 11, true},
    {{"norm", norm_make, norm_call, norm_keep, 1, 2048, 1024}, norm_truth, 16, false},
    {{"epilogue", epilogue_make, epilogue_call, epilogue_keep, 0, 1024, 64},
     epilogue_truth,
     64,
     false},
    {{"head_rotary", turn_make, turn_call, turn_keep, 1, 8, 4}, turn_truth, 8, false},
    {{"attend_block", block_make, block_call, block_keep, 1, 128, 128}, block_truth, 64, false},
    {{"attend_add", add_make, add_call, add_keep, 0, 1024, 64}, add_truth, 4, false},
};

enum { N_SLOTS = sizeof slots / sizeof *slots };

static const int sizes[] = {0,  1,  2,  3,  4,  5,   6,   7,   8,    9,   11, 12, 13,
                            15, 16, 17, 18, 19, 20,  23,  24,  25,   28,  31, 32, 33,
                            40, 47, 48, 49, 60, 63,  64,  65,  66,   67,  68, 71, 72,
                            73, 79, 80, 81, 96, 127, 128, 129, 1024, 2048};

/* One case on one level; what is wrong, or NULL. */
static const char *check_case(const struct slot *s, struct trial *t, const struct kernels *k,
                              double *worst)
{
    static struct outcome plain, got, truth;
    static const char *what;
    struct kernels c;
    kernels_init(&c, 0);
    trial_run(t, &c, &plain);
    trial_run(t, k, &got);
    if (got.fault || plain.fault)
        return got.fault ? got.fault : plain.fault;
    truth.used = truth.n_parts = 0;
    s->truth(&truth);
    for (int p = 0; p < got.n_parts; p++) {
        truth.part[p].bound = got.part[p].bound;
        truth.part[p].scale = got.part[p].scale;
    }
    what = "?";
    double d = truth.used == got.used ? trial_worst(&truth, &got, &what) : INFINITY;
    *worst = fmax(*worst, d);
    if (d > 1)
        return what;
    bool same = memcmp(got.v, plain.v, (size_t)got.used * sizeof *got.v) == 0;
    return s->exact && !same ? "bits differ from plain C" : NULL;
}

static int check_slot(const struct slot *s, const struct kernels *k)
{
    double worst = 0;
    int failures = 0, n = (int)(sizeof sizes / sizeof *sizes);
    for (variant = 0; variant < s->variants; variant++)
        for (int i = 0; i < n * PATTERNS * 2; i++) {
            struct trial t = {&s->item, sizes[i / (2 * PATTERNS)], i / 2 % PATTERNS, i % 2};
            if (t.size < s->item.size_min || t.size > s->item.size_max)
                continue;
            const char *wrong = check_case(s, &t, k, &worst);
            if (!wrong)
                continue;
            if (failures++ < 5)
                printf("%s %s, size %d, variant %d, %s input, arrays %s a page: %s\n", k->name,
                       s->item.name, t.size, variant, t.pattern ? "extreme" : "ordinary",
                       t.at_end ? "end" : "start", wrong);
        }
    printf("%s %s %s, error %.2f of the bound\n", failures ? "FAILED" : "ok", k->name, s->item.name,
           worst);
    return failures;
}

static int check_all(void)
{
    int failures = 0;
    for (int l = 0; l < N_LEVELS; l++) {
        struct kernels k;
        if ((cpu_detect() & trial_levels[l]) != trial_levels[l])
            continue;
        kernels_init(&k, trial_levels[l]);
        for (int i = 0; i < N_SLOTS; i++)
            failures += check_slot(&slots[i], &k);
    }
    return failures;
}

/* Forms that the network uses most. */
static void bench_all(void)
{
    static const struct {
        const char *name;
        int slot, variant, size;
    } forms[] = {
        {"absmax 1024", 0, 0, 1024}, {"quant 1024", 1, 0, 1024},  {"rotate 1024", 2, 8, 1},
        {"rotate 4096", 2, 10, 1},   {"norm 1024", 3, 1, 1024},   {"bias 3x64", 4, 0x18, 64},
        {"relu 3x64", 4, 0x19, 64},  {"GELU 3x64", 4, 0x1a, 64},  {"add 3x64", 4, 0x3c, 64},
        {"head turn 64", 5, 7, 4},   {"p8 64x128", 6, 0x37, 128}, {"p32 64x128", 6, 0x34, 128},
        {"o8 3x64", 7, 3, 64}};
    for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
        struct item item = slots[forms[i].slot].item;
        item.name = forms[i].name;
        item.size_bench = forms[i].size;
        variant = forms[i].variant;
        trial_bench(&item);
    }
}

int main(int argc, char **argv)
{
    bool timing = false;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--seed") == 0 && i + 1 < argc)
            trial_seed = strtoull(argv[++i], NULL, 10);
        else if (strcmp(argv[i], "--bench") == 0)
            timing = true;
        else
            return fprintf(stderr, "usage: %s [--seed N] [--bench]\n", argv[0]), 2;
    }
    guard_open();
    printf("seed %llu\n", (unsigned long long)trial_seed);
    if (timing) {
        bench_all();
        return 0;
    }
    guard_trap();
    return check_all() != 0;
}
