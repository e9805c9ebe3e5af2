#include "core/net/model.h"

#include <stdio.h>
#include <string.h>

enum precision model_type(const struct tensor_spec *t, enum precision file)
{
    if (t->role == ROLE_PLAIN || t->exact)
        return PRECISION_F32;
    if (file == PRECISION_S8 && table_product(t).seg % 4 != 0)
        return PRECISION_F32;
    return file;
}

/* Hidden units of the blocks' MLPs have outliers, and no factor can pass their activation. */
int model_rotation(const struct tensor_spec *t, enum precision file)
{
    static const char suffix[] = ".mlp.fc2.weight", owner[] = "encoder.aggregator.";
    size_t n = strlen(t->name), m = sizeof suffix - 1;
    if (model_type(t, file) != PRECISION_S8 || n < m || strcmp(t->name + n - m, suffix) != 0 ||
        strncmp(t->name, owner, sizeof owner - 1) != 0)
        return 0;
    int k = table_product(t).seg;
    return k & -k;
}

const struct model_tensor *model_find(const struct model *m, const char *name)
{
    for (int i = 0; i < m->n; i++)
        if (strcmp(m->tensors[i].spec.name, name) == 0)
            return &m->tensors[i];
    return NULL;
}

err_t model_plain(const struct model *m, const char *name, const float **out)
{
    const struct model_tensor *t = model_find(m, name);
    *out = NULL;
    if (!t || t->spec.role != ROLE_PLAIN)
        return err_fail(ERR_FORMAT, "the model has no tensor %s", name);
    *out = t->data;
    return OK;
}

err_t model_weight(const struct model *m, const char *name, struct weight *out)
{
    char full[NET_NAME_CAP];
    memset(out, 0, sizeof *out);
    snprintf(full, sizeof full, "%s.weight", name);
    const struct model_tensor *t = model_find(m, full);
    if (!t || t->spec.role == ROLE_PLAIN)
        return err_fail(ERR_FORMAT, "the model has no product %s", full);
    struct product_shape p = table_product(&t->spec);
    *out = (struct weight){.type = t->type,
                           .n = p.n,
                           .segs = p.segs,
                           .seg = p.seg,
                           .rotate = model_rotation(&t->spec, m->precision),
                           .panels = t->data,
                           .scale = t->scale};
    snprintf(full, sizeof full, "%s.bias", name);
    const struct model_tensor *bias = model_find(m, full);
    out->bias = bias ? bias->data : NULL;
    return OK;
}
