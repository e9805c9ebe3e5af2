#include "core/net/smoothing.h"

#include <math.h>
#include <string.h>

/* ---- which tensors take part ---- */

static const struct {
    const char *suffix;
    enum smoothing_factors factors;
    bool divided, block, value;
} uses[] = {
    {"norm1.weight", SMOOTHING_NORM1, true, true, false},
    {"norm1.bias", SMOOTHING_NORM1, true, true, false},
    {"attn.qkv.weight", SMOOTHING_NORM1, false, true, false},
    {"attn.qkv.weight", SMOOTHING_VALUE, true, true, true},
    {"attn.qkv.bias", SMOOTHING_VALUE, true, true, true},
    {"attn.proj.weight", SMOOTHING_VALUE, false, true, false},
    {"norm2.weight", SMOOTHING_NORM2, true, true, false},
    {"norm2.bias", SMOOTHING_NORM2, true, true, false},
    {"mlp.fc1.weight", SMOOTHING_NORM2, false, true, false},
    {"norm.weight", SMOOTHING_NORM1, true, false, false},
    {"norm.bias", SMOOTHING_NORM1, true, false, false},
    {"projects.0.weight", SMOOTHING_NORM1, false, false, false},
    {"projects.1.weight", SMOOTHING_NORM1, false, false, false},
    {"projects.2.weight", SMOOTHING_NORM1, false, false, false},
    {"projects.3.weight", SMOOTHING_NORM1, false, false, false},
};

/* Bytes before the suffix if this is the name of such a tensor, else 0. */
static size_t prefix_of(const char *suffix, bool block, const char *name)
{
    size_t n = strlen(name), m = strlen(suffix);
    if (n <= m || strcmp(name + n - m, suffix) != 0 || name[n - m - 1] != '.')
        return 0;
    bool number = n - m >= 2 && name[n - m - 2] >= '0' && name[n - m - 2] <= '9';
    bool head = strncmp(name, "encoder.depth_head.norm", 23) == 0 ||
                strncmp(name, "encoder.gaussian_param_head.norm", 32) == 0 ||
                strstr(name, "_head.projects.") != NULL;
    return (block ? number : head) ? n - m : 0;
}

int smoothing_uses(const char *name, struct smoothing_use out[SMOOTHING_USES_MAX])
{
    int n = 0;
    for (size_t i = 0; i < sizeof uses / sizeof *uses && n < SMOOTHING_USES_MAX; i++) {
        size_t prefix = prefix_of(uses[i].suffix, uses[i].block, name);
        if (prefix)
            out[n++] = (struct smoothing_use){uses[i].factors, uses[i].divided, uses[i].value,
                                              uses[i].block, prefix};
    }
    return n;
}

/* ---- factors ---- */

/* top_c = max(top_c, |w_oc|) over the rows of w (n, c). */
static void columns_max(const float *w, size_t n, int c, float *top)
{
    for (size_t o = 0; o < n; o++)
        for (int i = 0; i < c; i++)
            top[i] = fmaxf(top[i], fabsf(w[o * (size_t)c + (size_t)i]));
}

/* Neither dead nor so extreme that factors could overflow. */
static bool is_alive(float x)
{
    return x > 0x1p-100f && x < 0x1p100f;
}

/* s = sqrt(a / w), 1 where a side is not alive; relative to the middle one within 2^10, so that no
 * channel is lost in the other direction. */
static void balance_channels(const float *a, const float *w, int c, float *s)
{
    double mean = 0;
    int n = 0;
    for (int i = 0; i < c; i++) {
        bool alive = is_alive(a[i]) && is_alive(w[i]);
        s[i] = alive ? (log2f(a[i]) - log2f(w[i])) / 2 : NAN;
        mean += alive ? (double)s[i] : 0;
        n += alive;
    }
    for (int i = 0; i < c; i++)
        s[i] = isnan(s[i]) ? 1 : exp2f(fmaxf(-10, fminf(10, s[i] - (float)(mean / n))));
}

/* Largest expected output of a layer norm: three deviations and the offset. */
static void norm_range(const struct smoothing_source *norm, float *a)
{
    for (int i = 0; i < norm->c; i++)
        a[i] = 3 * fabsf(norm->gain[i]) + fabsf(norm->bias[i]);
}

/* Standard deviation of a row of v for inputs of unit deviation behind the norm. */
static void value_range(const struct smoothing_source *norm, const float *w, const float *b,
                        float *a)
{
    const int c = norm->c;
    for (int o = 0; o < c; o++) {
        double var = 0, mean = b[o];
        for (int i = 0; i < c; i++) {
            double x = w[(size_t)o * (size_t)c + (size_t)i];
            var += x * norm->gain[i] * x * norm->gain[i];
            mean += x * norm->bias[i];
        }
        a[o] = (float)(3 * sqrt(var) + fabs(mean));
    }
}

void smoothing_norm(const struct smoothing_source *norm, const struct smoothing_reader *reader,
                    int n, float *scratch, float *s)
{
    const int c = norm->c;
    float *range = scratch, *top = scratch + c;
    memset(top, 0, (size_t)c * sizeof *top);
    norm_range(norm, range);
    for (int i = 0; i < n; i++)
        columns_max(reader[i].w, reader[i].rows, c, top);
    balance_channels(range, top, c, s);
}

void smoothing_value(const struct smoothing_source *norm, const float *w, const float *b,
                     const float *proj, float *scratch, float *s)
{
    const int c = norm->c;
    float *range = scratch, *top = scratch + c;
    memset(top, 0, (size_t)c * sizeof *top);
    value_range(norm, w, b, range);
    columns_max(proj, (size_t)c, c, top);
    balance_channels(range, top, c, s);
}

/* ---- use ---- */

void smoothing_apply(const struct smoothing_use *u, const float *s, int c, float *x, size_t n)
{
    size_t channels = (size_t)c, from = u->value ? n / 3 * 2 : 0;
    size_t run = u->divided ? (n - from) / channels : 1; // values that share a factor
    for (size_t i = from; i < n; i++) {
        float f = s[(i - from) / run % channels];
        x[i] = u->divided ? x[i] / f : x[i] * f;
    }
}
