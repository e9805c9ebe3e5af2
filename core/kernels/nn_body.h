/* nn_body.h - row operations of the network (quantisation, rotation, norm, epilogue, attention),
 * compiled once per instruction set.
 * Included by nn_<isa>.c after one SIMD_ macro. Bounds: tests/kernels/nn_test.c.
 * The last lanes of a row go through the same arithmetic as the others, so that a value does not
 * depend on its index. Arguments are copied where the compiler must assume that vector stores
 * alias them. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"

#include <float.h>

#define MAP static inline __attribute__((always_inline))

static const float ones[16] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
static const float zeros[16] = {0};

/* A row of factors or terms that the contract allows to be NULL. */
struct row {
    const float *p;
    size_t step; // 0: the same vector everywhere
};

MAP struct row row_of(const float *p, const float *otherwise)
{
    return p ? (struct row){p, 1} : (struct row){otherwise, 0};
}

/* lanes: LANES, a constant of the compiler, or the rest of a row. */
MAP vf load(const float *p, int lanes)
{
    return lanes == LANES ? v_load(p) : v_load_n(p, lanes);
}

MAP vf load_row(struct row r, int j, int lanes)
{
    return load(r.p + r.step * (size_t)j, lanes);
}

MAP void store(float *p, vf a, int lanes)
{
    if (lanes == LANES)
        v_store(p, a);
    else
        v_store_n(p, a, lanes);
}

/* Sums of a product as floats. */
MAP vf load_sums(const int32_t *ci, const float *cf, bool ints, size_t at, int lanes)
{
    if (ints)
        return i_float(lanes == LANES ? i_load(ci + at) : i_load_n(ci + at, lanes));
    return load(cf + at, lanes);
}

/* --- quantisation -------------------------------------------------------------------------- */

/* Without their sign, floats compare like their bits as integers; infinities and NaN are last. */
static float absmax(const float *x, size_t n)
{
    vint top[4];
    size_t i = 0;
    for (int k = 0; k < 4; k++)
        top[k] = i_set(0);
    for (; i + 4 * LANES <= n; i += 4 * LANES)
        for (int k = 0; k < 4; k++)
            top[k] = i_max(top[k], i_magnitude(v_load(x + i + (size_t)k * LANES)));
    for (; i < n; i += LANES)
        top[0] = i_max(top[0], i_magnitude(v_load_n(x + i, n - i < LANES ? (int)(n - i) : LANES)));
    int32_t bits = i_top(i_max(i_max(top[0], top[1]), i_max(top[2], top[3])));
    float largest;
    memcpy(&largest, &bits, sizeof largest);
    return largest;
}

MAP vint quant_lanes(const float *x, vf inv, int lanes)
{
    vf v = load(x, lanes) * inv;
    v = v_sel(v_le(v, v), v, v_set(0.0f)); // not NaN
    return i_round(v_clamp(v, -127.0f, 127.0f));
}

static void quant(const float *x, size_t n, float inv, int8_t *out)
{
    const vf unit = v_set(inv);
    size_t i = 0;
    for (; i + 4 * LANES <= n; i += 4 * LANES) {
        vint q[4];
        for (int k = 0; k < 4; k++)
            q[k] = quant_lanes(x + i + (size_t)k * LANES, unit, LANES);
        i_store8x4(out + i, q);
    }
    for (; i < n; i += LANES) {
        int lanes = n - i < LANES ? (int)(n - i) : LANES;
        i_store8(out + i, quant_lanes(x + i, unit, lanes), lanes);
    }
}

/* --- rotation ------------------------------------------------------------------------------ */

/* Stages of strides below `edge` <= LANES: lane i becomes its sum with lane i ^ d, or the
 * difference where it is the second of the pair. Additions are those of the C reference, in its
 * order: the same bits everywhere. */
MAP vf rotate_lanes(vf a, int edge)
{
    static const float sign[4][16] = {{1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1},
                                      {1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1, 1, 1, -1, -1},
                                      {1, 1, 1, 1, -1, -1, -1, -1, 1, 1, 1, 1, -1, -1, -1, -1},
                                      {1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1, -1}};
    for (int k = 0; 1 << k < edge; k++)
        a = v_fma(a, v_load(sign[k]), v_swap(a, 1 << k));
    return a;
}

/* Stages of strides h and 2 h, times the factor; those within a vector come first if `lanes`. */
MAP void rotate4(float *x, int n, int h, vf factor, bool lanes)
{
    for (int i = 0; i < n; i += 4 * h)
        for (int j = i; j < i + h; j += LANES) {
            vf a = v_load(x + j), b = v_load(x + j + h);
            vf c = v_load(x + j + 2 * h), d = v_load(x + j + 3 * h);
            if (lanes) {
                a = rotate_lanes(a, LANES);
                b = rotate_lanes(b, LANES);
                c = rotate_lanes(c, LANES);
                d = rotate_lanes(d, LANES);
            }
            vf ab = a + b, cd = c + d, a_b = a - b, c_d = c - d;
            v_store(x + j, (ab + cd) * factor);
            v_store(x + j + h, (a_b + c_d) * factor);
            v_store(x + j + 2 * h, (ab - cd) * factor);
            v_store(x + j + 3 * h, (a_b - c_d) * factor);
        }
}

MAP void rotate2(float *x, int n, int h, vf factor)
{
    for (int i = 0; i < n; i += 2 * h)
        for (int j = i; j < i + h; j += LANES) {
            vf a = v_load(x + j), b = v_load(x + j + h);
            v_store(x + j, (a + b) * factor);
            v_store(x + j + h, (a - b) * factor);
        }
}

/* The sign of index 16 a + b is that of a times that of b, negated where the last bit of a and the
 * first of b are both set. */
static void set_signs(float *x, int n, int block)
{
    static const float sign[2][16] = {{1, 1, 1, -1, 1, 1, -1, 1, 1, 1, 1, -1, -1, -1, 1, -1},
                                      {1, 1, 1, -1, 1, 1, -1, 1, -1, -1, -1, 1, 1, 1, -1, 1}};
    int lanes = block < LANES ? block : LANES;
    for (int i = 0; i < n; i += lanes) {
        unsigned a = (unsigned)(i % block) / 16;
        vf s = load(sign[a & 1] + i % block % 16, lanes);
        s = s * v_set(__builtin_parity(a & a >> 1) ? -1.0f : 1.0f);
        store(x + i, load(x + i, lanes) * s, lanes);
    }
}

static void hadamard(float *x, int n, int block)
{
    set_signs(x, n, block);
    const vf one = v_set(1.0f), unit = v_set(1 / sqrtf((float)block));
    int h = LANES, i = 0;
    if (block >= 4 * LANES) {
        rotate4(x, n, LANES, block == 4 * LANES ? unit : one, true);
        h = 4 * LANES;
    } else if (block >= LANES) {
        for (; i < n; i += LANES)
            v_store(x + i, rotate_lanes(v_load(x + i), LANES) * (block == LANES ? unit : one));
    } else {
        for (; i < n; i += block)
            v_store_n(x + i, rotate_lanes(v_load_n(x + i, block), block) * unit, block);
    }
    for (; 4 * h <= block; h *= 4)
        rotate4(x, n, h, 4 * h == block ? unit : one, false);
    if (2 * h == block)
        rotate2(x, n, h, unit);
}

/* --- layer norm ---------------------------------------------------------------------------- */

MAP float row_sum(const float *x, int n)
{
    vf sum[4];
    int i = 0;
    for (int k = 0; k < 4; k++)
        sum[k] = v_set(0.0f);
    for (; i + 4 * LANES <= n; i += 4 * LANES)
        for (int k = 0; k < 4; k++)
            sum[k] = sum[k] + v_load(x + i + k * LANES);
    for (; i < n; i += LANES)
        sum[0] = sum[0] + v_load_n(x + i, n - i < LANES ? n - i : LANES);
    return v_sum((sum[0] + sum[1]) + (sum[2] + sum[3]));
}

/* Sums of the differences from `centre` and of their squares. */
MAP void row_moments(const float *x, int n, float centre, float *first, float *second)
{
    vf sum[4], square[4];
    int i = 0;
    for (int k = 0; k < 4; k++)
        sum[k] = square[k] = v_set(0.0f);
    for (; i + 4 * LANES <= n; i += 4 * LANES)
        for (int k = 0; k < 4; k++) {
            vf d = v_load(x + i + k * LANES) - v_set(centre);
            sum[k] = sum[k] + d;
            square[k] = v_fma(d, d, square[k]);
        }
    for (; i < n; i += LANES) {
        int lanes = n - i < LANES ? n - i : LANES;
        vf d = v_sel(m_first(lanes), v_load_n(x + i, lanes) - v_set(centre), v_set(0.0f));
        sum[0] = sum[0] + d;
        square[0] = v_fma(d, d, square[0]);
    }
    *first = v_sum((sum[0] + sum[1]) + (sum[2] + sum[3]));
    *second = v_sum((square[0] + square[1]) + (square[2] + square[3]));
}

/* Subtracting a first guess of the mean avoids cancellation; the mean of the differences corrects
 * the guess. */
MAP void norm_row(const struct norm *s, const float *x, float *y)
{
    const struct row gamma = row_of(s->gamma, ones), beta = row_of(s->beta, zeros);
    const float n = (float)s->n, guess = row_sum(x, s->n) / n;
    float first, second;
    row_moments(x, s->n, guess, &first, &second);
    const float shift = first / n, var = fmaxf(second / n - shift * shift, 0);
    const float unit = 1 / sqrtf(var + s->eps);
    for (int i = 0; i < s->n; i += LANES) {
        int lanes = s->n - i < LANES ? s->n - i : LANES;
        vf d = load(x + i, lanes) - v_set(guess) - v_set(shift);
        d = v_fma(d * v_set(unit), load_row(gamma, i, lanes), load_row(beta, i, lanes));
        store(y + i, d, lanes);
    }
}

static void norm(const struct norm *s, const float *x, float *y)
{
    norm_row(s, x, y);
}

/* --- after a product ----------------------------------------------------------------------- */

/* v Phi(v), where Phi(v) - 1/2 = v P(v^2) / Q(v^2): minimax on |v| < 5.25, within 7e-8, and beyond
 * it 0 and 1 within 8e-8. */
MAP vf gelu(vf v)
{
    v = v_max(v_set(-5.25f), v); // also avoids a huge number times a remainder
    vf x = v_min(v, v_set(5.25f)), s = x * x;
    vf p = v_set(6.044539987e-06f), q = v_set(5.152334666e-07f);
    p = v_fma(p, s, v_set(3.274888149e-04f));
    q = v_fma(q, s, v_set(1.174655117e-04f));
    p = v_fma(p, s, v_set(5.606171675e-03f));
    q = v_fma(q, s, v_set(2.781031653e-03f));
    p = v_fma(p, s, v_set(5.079319701e-02f));
    q = v_fma(q, s, v_set(3.806130216e-02f));
    p = v_fma(p, s, v_set(3.989418745e-01f));
    q = v_fma(q, s, v_set(2.939797342e-01f));
    q = v_fma(q, s, v_set(1.0f));
    return v * v_fma(x * p, v_recip(q), v_set(0.5f));
}

MAP vf activate(enum activation act, vf v)
{
    if (act == ACT_RELU)
        return v_max(v_set(0.0f), v); // NaN stays
    if (act == ACT_GELU)
        return gelu(v);
    if (act == ACT_SILU)
        return v * v_recip(v_set(1.0f) + v_exp(v_set(0.0f) - v));
    return v;
}

struct columns {
    struct row scale, bias, gamma;
};

MAP void epilogue_lanes(const struct epilogue *e, const struct columns *c, enum activation act,
                        bool ints, vf row_scale, int i, int j, int lanes)
{
    vf v = load_sums(e->ci, e->cf, ints, (size_t)i * e->ldc + (size_t)j, lanes);
    vf scale = row_scale * load_row(c->scale, j, lanes);
    v = activate(act, v_fma(v, scale, load_row(c->bias, j, lanes)));
    float *out = e->out + (size_t)i * e->ldo + j;
    if (e->add)
        v = v_fma(load_row(c->gamma, j, lanes), v, load(out, lanes));
    store(out, v, lanes);
}

MAP void epilogue_rows(const struct epilogue *e, enum activation act, bool ints)
{
    const struct columns c = {row_of(e->scale, ones), row_of(e->bias, zeros),
                              row_of(e->gamma, ones)};
    for (int i = 0; i < e->m; i++) {
        vf row_scale = v_set(e->row_scale ? e->row_scale[i] : 1.0f);
        int j = 0;
        for (; j + LANES <= e->n; j += LANES)
            epilogue_lanes(e, &c, act, ints, row_scale, i, j, LANES);
        if (j < e->n)
            epilogue_lanes(e, &c, act, ints, row_scale, i, j, e->n - j);
    }
}

MAP void epilogue_sums(const struct epilogue *e, enum activation act)
{
    if (e->ci)
        epilogue_rows(e, act, true);
    else
        epilogue_rows(e, act, false);
}

static void epilogue(const struct epilogue *e)
{
    const struct epilogue copy = *e;
    switch (e->act) {
    case ACT_RELU:
        epilogue_sums(&copy, ACT_RELU);
        break;
    case ACT_GELU:
        epilogue_sums(&copy, ACT_GELU);
        break;
    case ACT_SILU:
        epilogue_sums(&copy, ACT_SILU);
        break;
    case ACT_NONE:
        epilogue_sums(&copy, ACT_NONE);
    }
}

/* --- attention ----------------------------------------------------------------------------- */

static void head_rotary(const struct head_rotary *t, float *x)
{
    if (t->gamma) {
        const struct norm s = {t->n, 1e-5f, t->gamma, t->beta};
        norm_row(&s, x, x);
    }
    if (t->before)
        memcpy(t->before, x, (size_t)t->n * sizeof *x);
    if (!t->cosine)
        return;
    const int quarter = t->n / 4;
    for (int half = 0; half < 2; half++, x += 2 * quarter)
        for (int i = 0; i < quarter; i += LANES) {
            int lanes = quarter - i < LANES ? quarter - i : LANES;
            vf c = load(t->cosine + half * quarter + i, lanes);
            vf s = load(t->sine + half * quarter + i, lanes);
            vf a = load(x + i, lanes), b = load(x + quarter + i, lanes);
            store(x + i, v_fnma(b, s, a * c), lanes);
            store(x + quarter + i, v_fma(a, s, b * c), lanes);
        }
}

/* 254 2^x for x < 1, within 0.022, and 254 exactly for 0. Polynomial of least relative error (9e-5)
 * for 2^f on [0, 1) among those that are 1 at 0. */
MAP vf weight254(vf x)
{
    vf f = x - v_floor(x), p = v_set(254 * 7.706704e-02f);
    p = v_fma(p, f, v_set(254 * 2.2764499e-01f));
    p = v_fma(p, f, v_set(254 * 6.9511679e-01f));
    p = v_fma(p, f, v_set(254.0f));
    return v_shrink2(p, x);
}

/* I8: s key_scale, still without row_scale. F32: the logits. */
MAP vf logits(const struct attend_block *b, struct row key, bool ints, int i, int j, int lanes)
{
    vf s = load_sums(b->si, b->sf, ints, (size_t)i * b->lds + (size_t)j, lanes);
    if (!ints)
        s = s * v_set(b->row_scale[i]);
    return s * load_row(key, j, lanes);
}

MAP float largest_logit(const struct attend_block *b, struct row key, bool ints, int i)
{
    vf top = v_set(-INFINITY);
    int j = 0;
    for (; j + LANES <= b->n; j += LANES)
        top = v_max(logits(b, key, ints, i, j, LANES), top);
    if (j < b->n) {
        vf x = logits(b, key, ints, i, j, b->n - j);
        top = v_max(v_sel(m_first(b->n - j), x, top), top);
    }
    return v_top(top);
}

/* Logits are limited to +-2^16, in steps of log2: with their fused product and difference that of
 * the largest one is 0 within 2^-9, a third of a step of its weight. */
MAP float weigh_unit(const struct attend_block *b, int i)
{
    float unit = b->row_scale[i] * 1.44269504089f, top = fabsf(b->weigh[i]);
    return unit * top > 0x1p16f ? 0x1p16f / top : unit;
}

/* weigh_block: 254 2^(x / STEPS) - 127 of 4 LANES values, x / STEPS < 2^-9; adds them to sum. */
#if defined(SIMD_AVX512)
#define STEPS (-4096.0f)

/* In 16-bit fixed point: linear between 32 points of an octave, which is at most 0.015 too much,
 * then shifted by octaves. */
MAP vint weigh_block(const vf x[4], int8_t *out, vint sum)
{
    static const uint16_t offset[32] = {65024, 63631, 62267, 60933, 59627, 58350, 57099, 55876,
                                        54678, 53507, 52360, 51238, 50140, 49066, 48015, 46986,
                                        45979, 44994, 44030, 43086, 42163, 41259, 40375, 39510,
                                        38664, 37835, 37024, 36231, 35455, 34695, 33951, 33224};
    static const uint16_t slope[32] = {1393, 1364, 1334, 1306, 1277, 1251, 1223, 1198,
                                       1171, 1147, 1122, 1098, 1074, 1051, 1029, 1007,
                                       985,  964,  944,  923,  904,  884,  865,  846,
                                       829,  811,  793,  776,  760,  744,  727,  712};
    const __m512i top = _mm512_loadu_si512(offset), down = _mm512_loadu_si512(slope);
    const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    __m512i w[2];
    for (int k = 0; k < 2; k++) {
        __m512i z = _mm512_packus_epi32(i_round(x[2 * k]), i_round(x[2 * k + 1]));
        __m512i at = _mm512_srli_epi16(z, 7), rest = _mm512_slli_epi16(z, 9);
        rest = _mm512_mulhi_epu16(_mm512_permutexvar_epi16(at, down), rest);
        rest = _mm512_sub_epi16(_mm512_permutexvar_epi16(at, top), rest);
        rest = _mm512_srlv_epi16(rest, _mm512_srli_epi16(z, 12));
        rest = _mm512_add_epi16(rest, _mm512_set1_epi16(128));
        w[k] = _mm512_mulhi_epu16(rest, _mm512_set1_epi16(256));
    }
    __m512i p = _mm512_permutexvar_epi32(order, _mm512_packus_epi16(w[0], w[1]));
    sum = i_add(sum, _mm512_sad_epu8(p, i_set(0)));
    _mm512_storeu_si512(out, _mm512_sub_epi8(p, _mm512_set1_epi8(127)));
    return i_add(sum, i_set(-127 * 64 / LANES));
}
#else
#define STEPS 1.0f

MAP vint weigh_block(const vf x[4], int8_t *out, vint sum)
{
    vint p[4];
    for (int k = 0; k < 4; k++) {
        p[k] = i_add(i_round(weight254(x[k])), i_set(-127));
        sum = i_add(sum, p[k]);
    }
    i_store8x4(out, p);
    return sum;
}
#endif

/* Weights of one row. On entry b->weigh holds the largest value of `logits`.
 * returns: the sum of the weights. */
MAP float weigh_ints(const struct attend_block *b, struct row key, int i)
{
    const float unit = weigh_unit(b, i), base = -unit * b->weigh[i];
    int8_t *out = b->pi + (size_t)i * b->ldp;
    vint sum = i_set(0);
    int j = 0;
    for (; j + 4 * LANES <= b->n; j += 4 * LANES) {
        vf x[4];
        for (int k = 0; k < 4; k++)
            x[k] = v_fma(logits(b, key, true, i, j + k * LANES, LANES), v_set(STEPS * unit),
                         v_set(STEPS * base));
        sum = weigh_block(x, out + j, sum);
    }
    for (; j < b->n; j += LANES) {
        int lanes = b->n - j < LANES ? b->n - j : LANES;
        vf x = v_fma(logits(b, key, true, i, j, lanes), v_set(unit), v_set(base));
        vint p = i_round(v_sel(m_first(lanes), weight254(x) - v_set(127.0f), v_set(0.0f)));
        sum = i_add(sum, p);
        i_store8(out + j, p, (lanes + 3) / 4 * 4);
    }
    return (float)(i_sum(sum) + 127 * b->n);
}

/* On entry b->weigh holds the new top. */
MAP float weigh_floats(const struct attend_block *b, struct row key, int i)
{
    const vf top = v_set(b->weigh[i]);
    float *out = b->pf + (size_t)i * b->ldp;
    vf sum = v_set(0.0f);
    int j = 0;
    for (; j + LANES <= b->n; j += LANES) {
        vf p = v_exp(logits(b, key, false, i, j, LANES) - top);
        sum = sum + p;
        v_store(out + j, p);
    }
    if (j < b->n) {
        vf p = v_exp(logits(b, key, false, i, j, b->n - j) - top);
        sum = sum + v_sel(m_first(b->n - j), p, v_set(0.0f));
        v_store_n(out + j, p, b->n - j);
    }
    return v_sum(sum);
}

/* On entry weigh holds the logit that the weights of a row are relative to, rescale their sum. */
MAP void merge_state(const struct attend_block *b, float unit, int i, int lanes)
{
    vf base = load(b->weigh + i, lanes), old = load(b->top + i, lanes), all = v_max(old, base);
    vf rescale = v_exp(old - all), weigh = v_exp(base - all) * v_set(unit);
    vf sum = load(b->sum + i, lanes) * rescale;
    store(b->sum + i, v_fma(weigh, load(b->rescale + i, lanes), sum), lanes);
    store(b->top + i, all, lanes);
    store(b->rescale + i, rescale, lanes);
    store(b->weigh + i, weigh, lanes);
}

/* One pass over all rows per step hides the latency of the sums across lanes. */
MAP void attend_rows(const struct attend_block *b, bool ints)
{
    const struct row key = row_of(b->key_scale, ones);
    for (int i = 0; i < b->m; i++) {
        float top = largest_logit(b, key, ints, i);
        b->weigh[i] = ints ? top : fmaxf(top, b->top[i]);
    }
    for (int i = 0; i < b->m; i++)
        b->rescale[i] = ints ? weigh_ints(b, key, i) : weigh_floats(b, key, i);
    for (int i = 0; ints && i < b->m; i++)
        b->weigh[i] *= b->row_scale[i];
    for (int i = 0; i < b->m; i += LANES)
        merge_state(b, ints ? 1 / 254.0f : 1.0f, i, b->m - i < LANES ? b->m - i : LANES);
}

static void attend_block(const struct attend_block *b)
{
    const struct attend_block copy = *b;
    if (b->si)
        attend_rows(&copy, true);
    else
        attend_rows(&copy, false);
}

MAP void add_lanes(const struct attend_add *a, struct row scale, bool ints, vf weigh, vf rescale,
                   int i, int j, int lanes)
{
    vf c = load_sums(a->ci, a->cf, ints, (size_t)i * a->ldc + (size_t)j, lanes);
    if (ints)
        c = c + i_float(lanes == LANES ? i_load(a->shift + j) : i_load_n(a->shift + j, lanes));
    float *o = a->o + (size_t)i * a->ldo + j;
    store(o, v_fma(weigh * load_row(scale, j, lanes), c, load(o, lanes) * rescale), lanes);
}

MAP void add_rows(const struct attend_add *a, bool ints)
{
    const struct row scale = row_of(a->value_scale, ones);
    for (int i = 0; i < a->m; i++) {
        vf weigh = v_set(a->weigh[i]), rescale = v_set(a->rescale[i]);
        int j = 0;
        for (; j + LANES <= a->n; j += LANES)
            add_lanes(a, scale, ints, weigh, rescale, i, j, LANES);
        if (j < a->n)
            add_lanes(a, scale, ints, weigh, rescale, i, j, a->n - j);
    }
}

static void attend_add(const struct attend_add *a)
{
    const struct attend_add copy = *a;
    if (a->ci)
        add_rows(&copy, true);
    else
        add_rows(&copy, false);
}

static void nn_fill(struct gemm_kernels *k)
{
    k->absmax = absmax;
    k->quant = quant;
    k->hadamard = hadamard;
    k->norm = norm;
    k->epilogue = epilogue;
    k->head_rotary = head_rotary;
    k->attend_block = attend_block;
    k->attend_add = attend_add;
}
