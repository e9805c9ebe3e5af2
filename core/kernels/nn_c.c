/* The reference of the row kernels of gemm.h: obvious loops, never optimised. */
#include "core/kernels/kernels.h"

#include <float.h>
#include <math.h>
#include <string.h>

static float absmax(const float *x, size_t n)
{
    float top = 0;
    for (size_t i = 0; i < n; i++)
        top = fabsf(x[i]) <= top || isnan(top) ? top : fabsf(x[i]);
    return top;
}

static void quant(const float *x, size_t n, float inv, int8_t *out)
{
    for (size_t i = 0; i < n; i++) {
        float v = x[i] * inv; // NaN also for 0 times infinity
        out[i] = isnan(v) ? 0 : (int8_t)rintf(fmaxf(fminf(v, 127), -127));
    }
}

static void hadamard(float *x, int n, int block)
{
    const float unit = 1 / sqrtf((float)block);
    for (int i = 0; i < n; i++) {
        unsigned at = (unsigned)(i % block);
        x[i] = __builtin_parity(at & at >> 1) ? -x[i] : x[i];
    }
    for (int half = 1; half < block; half *= 2)
        for (int i = 0; i < n; i++)
            if (!(i & half)) {
                float a = x[i], b = x[i + half];
                x[i] = a + b;
                x[i + half] = a - b;
            }
    for (int i = 0; i < n; i++)
        x[i] *= unit;
}

static void norm(const struct norm *s, const float *x, float *y)
{
    double mean = 0, var = 0;
    for (int i = 0; i < s->n; i++)
        mean += x[i];
    mean /= s->n;
    for (int i = 0; i < s->n; i++)
        var += (x[i] - mean) * (x[i] - mean);
    float unit = (float)(1 / sqrt(var / s->n + s->eps));
    for (int i = 0; i < s->n; i++) {
        float v = (float)(x[i] - mean) * unit;
        y[i] = v * (s->gamma ? s->gamma[i] : 1) + (s->beta ? s->beta[i] : 0);
    }
}

static float activation_value(enum activation act, float v)
{
    switch (act) {
    case ACT_RELU:
        return v < 0 ? 0 : v;
    case ACT_GELU:
        return 0.5f * v * (1 + erff(v * 0.70710678118654752f));
    case ACT_SILU:
        return v / (1 + expf(-v));
    case ACT_NONE:
        break;
    }
    return v;
}

static void epilogue(const struct epilogue *e)
{
    for (int i = 0; i < e->m; i++)
        for (int j = 0; j < e->n; j++) {
            size_t at = (size_t)i * e->ldc + (size_t)j;
            float sum = e->ci ? (float)e->ci[at] : e->cf[at];
            float scale = (e->row_scale ? e->row_scale[i] : 1) * (e->scale ? e->scale[j] : 1);
            float v = activation_value(e->act, sum * scale + (e->bias ? e->bias[j] : 0));
            float *out = e->out + (size_t)i * e->ldo + j;
            *out = e->add ? *out + (e->gamma ? e->gamma[j] : 1) * v : v;
        }
}

static void head_rotary(const struct head_rotary *t, float *x)
{
    if (t->gamma) {
        const struct norm s = {t->n, 1e-5f, t->gamma, t->beta};
        norm(&s, x, x);
    }
    if (t->before)
        memcpy(t->before, x, (size_t)t->n * sizeof *x);
    if (!t->cosine)
        return;
    int quarter = t->n / 4;
    for (int i = 0; i < 2 * quarter; i++) {
        float *a = x + (i < quarter ? i : i + quarter), *b = a + quarter;
        float c = t->cosine[i], s = t->sine[i], u = *a, v = *b;
        *a = u * c - v * s;
        *b = v * c + u * s;
    }
}

/* Not inlined: fused into a difference it would round differently from the largest logit. */
static __attribute__((noinline)) float logit(const struct attend_block *b, int i, int j)
{
    size_t at = (size_t)i * b->lds + (size_t)j;
    float s = b->si ? (float)b->si[at] : b->sf[at];
    return s * b->row_scale[i] * (b->key_scale ? b->key_scale[j] : 1);
}

static void attend_block(const struct attend_block *b)
{
    for (int i = 0; i < b->m; i++) {
        float top = -INFINITY, sum = 0;
        for (int j = 0; j < b->n; j++)
            top = fmaxf(top, logit(b, i, j));
        float all = fmaxf(top, b->top[i]), base = b->si ? top : all;
        for (int j = 0; j < b->n; j++) {
            float p = expf(logit(b, i, j) - base);
            if (b->si)
                p = rintf(254 * p - 127);
            if (b->si)
                b->pi[(size_t)i * b->ldp + (size_t)j] = (int8_t)p;
            else
                b->pf[(size_t)i * b->ldp + (size_t)j] = p;
            sum += b->si ? p + 127 : p;
        }
        for (int j = b->n; b->si && j % 4; j++)
            b->pi[(size_t)i * b->ldp + (size_t)j] = 0;
        b->rescale[i] = expf(b->top[i] - all);
        b->weigh[i] = b->si ? expf(top - all) / 254 : 1;
        b->sum[i] = b->sum[i] * b->rescale[i] + b->weigh[i] * sum;
        b->top[i] = all;
    }
}

static void attend_add(const struct attend_add *a)
{
    for (int i = 0; i < a->m; i++)
        for (int j = 0; j < a->n; j++) {
            size_t at = (size_t)i * a->ldc + (size_t)j;
            float c = a->ci ? (float)a->ci[at] + (float)a->shift[j] : a->cf[at];
            float w = a->weigh[i] * (a->value_scale ? a->value_scale[j] : 1);
            float *o = a->o + (size_t)i * a->ldo + j;
            *o = *o * a->rescale[i] + w * c;
        }
}

void nn_c(struct gemm_kernels *k)
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
