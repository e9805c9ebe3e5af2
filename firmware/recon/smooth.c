#include "firmware/recon/smooth.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum factors { NORM1, VALUE, NORM2, FACTORS };

/* The activations of a block or trunk. */
struct smooth_group {
    struct smooth_group *next;
    char prefix[NET_NAME_CAP]; // begins the names of its tensors
    int c;                     // channels
    float s[];                 // (FACTORS, c); a trunk has NORM1 only
};

/* ---- which tensors take part ---- */

enum how { OVER, TIMES }; // entries, or rows of v / columns

static const struct use {
    const char *suffix;
    enum factors factors;
    enum how how;
    bool block, value; // in a transformer block, not a DPT trunk; its last third only
} uses[] = {
    {"norm1.weight", NORM1, OVER, true, false},
    {"norm1.bias", NORM1, OVER, true, false},
    {"attn.qkv.weight", NORM1, TIMES, true, false},
    {"attn.qkv.weight", VALUE, OVER, true, true},
    {"attn.qkv.bias", VALUE, OVER, true, true},
    {"attn.proj.weight", VALUE, TIMES, true, false},
    {"norm2.weight", NORM2, OVER, true, false},
    {"norm2.bias", NORM2, OVER, true, false},
    {"mlp.fc1.weight", NORM2, TIMES, true, false},
    {"norm.weight", NORM1, OVER, false, false},
    {"norm.bias", NORM1, OVER, false, false},
    {"projects.0.weight", NORM1, TIMES, false, false},
    {"projects.1.weight", NORM1, TIMES, false, false},
    {"projects.2.weight", NORM1, TIMES, false, false},
    {"projects.3.weight", NORM1, TIMES, false, false},
};

enum { N_USES = sizeof uses / sizeof *uses };

/* Bytes of the prefix if `name` is what `u` says, else 0. */
static size_t prefix_of(const struct use *u, const char *name)
{
    size_t n = strlen(name), m = strlen(u->suffix);
    if (n <= m || strcmp(name + n - m, u->suffix) != 0 || name[n - m - 1] != '.')
        return 0;
    bool number = n - m >= 2 && name[n - m - 2] >= '0' && name[n - m - 2] <= '9';
    bool head = strncmp(name, "encoder.depth_head.norm", 23) == 0 ||
                strncmp(name, "encoder.gaussian_param_head.norm", 32) == 0 ||
                strstr(name, "_head.projects.") != NULL;
    return (u->block ? number : head) ? n - m : 0;
}

/* ---- factors ---- */

struct wanted {
    char name[NET_NAME_CAP];
    struct tensor_spec t;
    bool found;
};

static err_t pick(void *ctx, const struct tensor_spec *t)
{
    struct wanted *w = ctx;
    if (strcmp(t->name, w->name) == 0) {
        w->t = *t;
        w->found = true;
    }
    return OK;
}

/* Values of a tensor of the group; own: free(*out). */
static err_t read_tensor(const struct smooth *s, const struct run *r, const char *prefix,
                         const char *suffix, float **out)
{
    struct wanted w = {.found = false};
    snprintf(w.name, sizeof w.name, "%s%s", prefix, suffix);
    err_t e = table_walk(s->dims, pick, &w);
    if (!e && !w.found)
        e = err_fail(ERR_FORMAT, "%s: no such tensor", w.name);
    if (e)
        return e;
    *out = malloc(table_count(&w.t) * sizeof **out);
    if (!*out)
        return err_fail(ERR_NOMEM, "no memory for %s", w.name);
    return s->fetch(s->ctx, r, &w.t, *out);
}

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
static void factors(const float *a, const float *w, int c, float *s)
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

/* What a layer norm gives: three deviations and the offset. */
static void norm_range(const float *gain, const float *bias, int c, float *a)
{
    for (int i = 0; i < c; i++)
        a[i] = 3 * fabsf(gain[i]) + fabsf(bias[i]);
}

/* What a row of v gives for inputs of unit deviation behind the norm. */
static void value_range(const float *const norm[2], const float *w, const float *b, int c, float *a)
{
    for (int o = 0; o < c; o++) {
        double var = 0, mean = b[o];
        for (int i = 0; i < c; i++) {
            double x = w[(size_t)o * (size_t)c + (size_t)i];
            var += x * norm[0][i] * x * norm[0][i];
            mean += x * norm[1][i];
        }
        a[o] = (float)(3 * sqrt(var) + fabs(mean));
    }
}

/* The tensors that a group looks at; those of a trunk are the norm and four projections. */
enum { GAIN, BIAS, FIRST, FIRST_BIAS, SECOND, PARTS = 6 };

static err_t read_all(const struct smooth *s, const struct run *r, const struct smooth_group *g,
                      const char *const names[PARTS], float *v[PARTS])
{
    err_t e = OK;
    for (int i = 0; i < PARTS && !e && names[i]; i++)
        e = read_tensor(s, r, g->prefix, names[i], v + i);
    return e;
}

static void free_all(float *v[PARTS])
{
    for (int i = 0; i < PARTS; i++)
        free(v[i]);
    memset(v, 0, PARTS * sizeof *v);
}

static err_t find_block(const struct smooth *s, const struct run *r, struct smooth_group *g,
                        float *range)
{
    static const char *const attention[PARTS] = {"norm1.weight", "norm1.bias", "attn.qkv.weight",
                                                 "attn.qkv.bias", "attn.proj.weight"};
    static const char *const mlp[PARTS] = {"norm2.weight", "norm2.bias", "mlp.fc1.weight"};
    float *v[PARTS] = {NULL}, *top = range + g->c;
    size_t c = (size_t)g->c;
    err_t e = read_all(s, r, g, attention, v);
    if (!e) {
        norm_range(v[GAIN], v[BIAS], g->c, range);
        columns_max(v[FIRST], 3 * c, g->c, top);
        factors(range, top, g->c, g->s);
        memset(top, 0, c * sizeof *top);
        const float *const norm[] = {v[GAIN], v[BIAS]};
        value_range(norm, v[FIRST] + 2 * c * c, v[FIRST_BIAS] + 2 * c, g->c, range);
        columns_max(v[SECOND], c, g->c, top);
        factors(range, top, g->c, g->s + VALUE * c);
    }
    free_all(v);
    if (!e)
        e = read_all(s, r, g, mlp, v);
    if (!e) {
        memset(top, 0, c * sizeof *top);
        norm_range(v[GAIN], v[BIAS], g->c, range);
        columns_max(v[FIRST], 4 * c, g->c, top);
        factors(range, top, g->c, g->s + NORM2 * c);
    }
    free_all(v);
    return e;
}

static err_t find_trunk(const struct smooth *s, const struct run *r, struct smooth_group *g,
                        float *range)
{
    static const char *const names[PARTS] = {"norm.weight",       "norm.bias",
                                             "projects.0.weight", "projects.1.weight",
                                             "projects.2.weight", "projects.3.weight"};
    const int *oc = strstr(g->prefix, "depth_head") ? s->dims->depth_oc : s->dims->gs_oc;
    float *v[PARTS] = {NULL}, *top = range + g->c;
    err_t e = read_all(s, r, g, names, v);
    if (!e) {
        norm_range(v[GAIN], v[BIAS], g->c, range);
        for (int k = 0; k < NET_KEEP; k++)
            columns_max(v[FIRST + k], (size_t)oc[k], g->c, top);
        factors(range, top, g->c, g->s);
    }
    free_all(v);
    return e;
}

/* The group of this prefix, made when it is first asked for. */
static err_t group_of(struct smooth *s, const struct run *r, const char *name, size_t prefix,
                      bool block, struct smooth_group **out)
{
    for (*out = s->groups; *out; *out = (*out)->next)
        if (strlen((*out)->prefix) == prefix && strncmp((*out)->prefix, name, prefix) == 0)
            return OK;
    bool wide = !block || strstr(name, "camera_head");
    int c = wide ? 2 * s->dims->embed : s->dims->embed;
    struct smooth_group *g = calloc(1, sizeof *g + FACTORS * (size_t)c * sizeof(float));
    float *range = calloc(2 * (size_t)c, sizeof *range);
    err_t e = g && range ? OK : err_fail(ERR_NOMEM, "no memory to smooth %s", name);
    if (!e) {
        g->c = c;
        memcpy(g->prefix, name, prefix);
        e = block ? find_block(s, r, g, range) : find_trunk(s, r, g, range);
    }
    free(range);
    if (e) {
        free(g);
        return e;
    }
    g->next = s->groups;
    s->groups = *out = g;
    return OK;
}

/* ---- use ---- */

static void apply(const struct use *u, const struct smooth_group *g, const struct tensor_spec *t,
                  float *x)
{
    const float *s = g->s + (size_t)u->factors * (size_t)g->c;
    size_t c = (size_t)g->c, n = table_count(t), from = u->value ? n / 3 * 2 : 0;
    size_t run = u->how == OVER ? (n - from) / c : 1; // values that share a factor
    for (size_t i = from; i < n; i++) {
        float f = s[(i - from) / run % c];
        x[i] = u->how == OVER ? x[i] / f : x[i] * f;
    }
}

err_t smooth_fetch(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    struct smooth *s = ctx;
    err_t e = s->fetch(s->ctx, r, t, out);
    for (int i = 0; i < N_USES && !e; i++) {
        struct smooth_group *g;
        size_t prefix = prefix_of(uses + i, t->name);
        if (!prefix)
            continue;
        e = group_of(s, r, t->name, prefix, uses[i].block, &g);
        if (!e)
            apply(uses + i, g, t, out);
    }
    return e;
}

void smooth_free(struct smooth *s)
{
    while (s->groups) {
        struct smooth_group *g = s->groups;
        s->groups = g->next;
        free(g);
    }
}
