/* small_model.h - a model in memory of any dimensions: hashed weights (core/net/hashed.h), or those
 * that a function gives. */
#ifndef UNIT_SMALL_MODEL_H
#define UNIT_SMALL_MODEL_H

#include "core/net/hashed.h"
#include "core/net/model.h"
#include "core/net/pack.h"

#include <stdlib.h>
#include <string.h>

enum { SMALL_TENSORS_MAX = 4096 };

/* Values of a tensor in the order of the checkpoint. */
typedef void small_fill_fn(void *ctx, const struct tensor_spec *spec, float *out);

/* A whole network in the smallest size that has every part. */
static const struct net_dims small_model_tiny = {
    .embed = 32,
    .heads = 2,
    .dino_depth = 1,
    .dino_heads = 2,
    .depth = 4,
    .keep = {0, 1, 2, 3},
    .qk_layer = 1,
    .cam_depth = 1,
    .cam_heads = 2,
    .depth_feat = 16,
    .gs_feat = 16,
    .depth_oc = {8, 8, 8, 8},
    .gs_oc = {8, 8, 8, 8},
    .hdr = 8,
    .size = 42,
    .voxel = 0.1f,
    .gauss = true,
    .appearance = true,
};

struct small_model {
    struct model model;
    small_fill_fn *fill;
    void *ctx;
    struct model_tensor tensors[SMALL_TENSORS_MAX];
};

static inline void *small_alloc(size_t n, size_t elem)
{
    void *p = aligned_alloc(64, (n * elem + 63) / 64 * 64 + 64);
    if (!p)
        abort();
    return p;
}

static inline void small_pack(struct model_tensor *t, const float *values)
{
    int panels = pack_panels(&t->spec);
    size_t bytes = pack_panel_bytes(&t->spec, t->type);
    struct product_shape s = table_product(&t->spec);
    char *data = small_alloc((size_t)panels, bytes);
    float *scale = small_alloc((size_t)panels * 16, sizeof *scale);
    float *row = small_alloc((size_t)(s.segs * s.seg), sizeof *row);
    for (int p = 0; p < panels; p++)
        pack_panel(&t->spec, t->type, p, values,
                   &(struct pack){row, data + (size_t)p * bytes, scale + 16 * p});
    free(row);
    t->data = data;
    t->scale = t->type == PRECISION_S8 ? scale : NULL;
    if (!t->scale)
        free(scale);
}

static inline err_t small_tensor(void *ctx, const struct tensor_spec *spec)
{
    struct small_model *s = ctx;
    if (!spec->used)
        return OK;
    if (s->model.n == SMALL_TENSORS_MAX)
        abort();
    struct model_tensor *t = s->tensors + s->model.n++;
    size_t n = table_count(spec), times = spec->repeat > 1 ? (size_t)spec->repeat : 1;
    float *values = small_alloc(n * times, sizeof *values);
    s->fill(s->ctx, spec, values);
    for (size_t i = 1; i < times; i++)
        memcpy(values + i * n, values, n * sizeof *values);
    *t = (struct model_tensor){.spec = *spec, .type = model_type(spec, s->model.precision)};
    t->data = values;
    if (spec->role == ROLE_PLAIN)
        return OK;
    small_pack(t, values);
    free(values);
    return OK;
}

static inline void small_hashed(void *ctx, const struct tensor_spec *spec, float *out)
{
    (void)ctx;
    hashed_fill(spec, 1, 0, table_count(spec), out);
}

/* own: small_model_free. The struct must not move. */
static inline void small_model_make(struct small_model *s, const struct net_dims *d,
                                    enum precision precision, small_fill_fn *fill, void *ctx)
{
    memset(s, 0, sizeof *s);
    s->fill = fill;
    s->ctx = ctx;
    s->model = (struct model){.dims = *d, .precision = precision, .tensors = s->tensors};
    if (table_check(d) != OK || table_walk(d, small_tensor, s) != OK)
        abort();
}

static inline void small_model_init(struct small_model *s, const struct net_dims *d,
                                    enum precision precision)
{
    small_model_make(s, d, precision, small_hashed, NULL);
}

static inline void small_model_free(struct small_model *s)
{
    for (int i = 0; i < s->model.n; i++) {
        free((void *)(uintptr_t)s->tensors[i].data);
        free((void *)(uintptr_t)s->tensors[i].scale);
    }
    memset(s, 0, sizeof *s);
}

#endif
