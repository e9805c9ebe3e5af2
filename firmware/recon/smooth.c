#include "firmware/recon/smooth.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The factors of a block or trunk. */
struct smooth_group {
    struct smooth_group *next;
    char prefix[NET_NAME_CAP]; // begins the names of its tensors
    int c;                     // channels
    float s[];                 // (SMOOTHING_FACTORS, c); a trunk has SMOOTHING_NORM1 only
};

/* ---- weights ---- */

struct wanted {
    char name[NET_NAME_CAP];
    struct tensor_spec t;
    bool found;
};

static err_t pick_tensor(void *ctx, const struct tensor_spec *t)
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
    err_t e = table_walk(s->dims, pick_tensor, &w);
    if (!e && !w.found)
        e = err_fail(ERR_FORMAT, "%s: no such tensor", w.name);
    if (e)
        return e;
    *out = malloc(table_count(&w.t) * sizeof **out);
    if (!*out)
        return err_fail(ERR_NOMEM, "no memory for %s", w.name);
    return s->fetch(s->ctx, r, &w.t, *out);
}

/* ---- factors ---- */

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
                        float *scratch)
{
    static const char *const attention[PARTS] = {"norm1.weight", "norm1.bias", "attn.qkv.weight",
                                                 "attn.qkv.bias", "attn.proj.weight"};
    static const char *const mlp[PARTS] = {"norm2.weight", "norm2.bias", "mlp.fc1.weight"};
    float *v[PARTS] = {NULL};
    size_t c = (size_t)g->c;
    err_t e = read_all(s, r, g, attention, v);
    if (!e) {
        const struct smoothing_reader qkv = {v[FIRST], 3 * c};
        const struct smoothing_source norm = {v[GAIN], v[BIAS], g->c};
        smoothing_norm(&norm, &qkv, 1, scratch, g->s + SMOOTHING_NORM1 * c);
        smoothing_value(&norm, v[FIRST] + 2 * c * c, v[FIRST_BIAS] + 2 * c, v[SECOND], scratch,
                        g->s + SMOOTHING_VALUE * c);
    }
    free_all(v);
    if (!e)
        e = read_all(s, r, g, mlp, v);
    if (!e) {
        const struct smoothing_reader fc1 = {v[FIRST], 4 * c};
        const struct smoothing_source norm = {v[GAIN], v[BIAS], g->c};
        smoothing_norm(&norm, &fc1, 1, scratch, g->s + SMOOTHING_NORM2 * c);
    }
    free_all(v);
    return e;
}

static err_t find_trunk(const struct smooth *s, const struct run *r, struct smooth_group *g,
                        float *scratch)
{
    static const char *const names[PARTS] = {"norm.weight",       "norm.bias",
                                             "projects.0.weight", "projects.1.weight",
                                             "projects.2.weight", "projects.3.weight"};
    const int *oc = strstr(g->prefix, "depth_head") ? s->dims->depth_oc : s->dims->gs_oc;
    float *v[PARTS] = {NULL};
    err_t e = read_all(s, r, g, names, v);
    if (!e) {
        const struct smoothing_source norm = {v[GAIN], v[BIAS], g->c};
        struct smoothing_reader projects[NET_KEEP];
        for (int k = 0; k < NET_KEEP; k++)
            projects[k] = (struct smoothing_reader){v[FIRST + k], (size_t)oc[k]};
        smoothing_norm(&norm, projects, NET_KEEP, scratch, g->s);
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
    struct smooth_group *g = calloc(1, sizeof *g + SMOOTHING_FACTORS * (size_t)c * sizeof(float));
    float *scratch = calloc(2 * (size_t)c, sizeof *scratch);
    err_t e = g && scratch ? OK : err_fail(ERR_NOMEM, "no memory to smooth %s", name);
    if (!e) {
        g->c = c;
        memcpy(g->prefix, name, prefix);
        e = block ? find_block(s, r, g, scratch) : find_trunk(s, r, g, scratch);
    }
    free(scratch);
    if (e) {
        free(g);
        return e;
    }
    g->next = s->groups;
    s->groups = *out = g;
    return OK;
}

err_t smooth_fetch(void *ctx, const struct run *r, const struct tensor_spec *t, float *out)
{
    struct smooth *s = ctx;
    struct smoothing_use use[SMOOTHING_USES_MAX];
    const int n = smoothing_uses(t->name, use);
    err_t e = s->fetch(s->ctx, r, t, out);
    for (int i = 0; i < n && !e; i++) {
        struct smooth_group *g;
        e = group_of(s, r, t->name, use[i].prefix, use[i].block, &g);
        if (!e)
            smoothing_apply(&use[i], g->s + (size_t)use[i].factors * (size_t)g->c, g->c, out,
                            table_count(t));
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
