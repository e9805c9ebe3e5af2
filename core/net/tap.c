#include "core/net/tap.h"

void tap_put(const struct run *r, const struct tap_tensor *t)
{
    if (!r->tap)
        return;
    struct tap_tensor whole = *t;
    bool dense = true;
    for (int i = 0; i < t->rank; i++)
        dense = dense && t->stride[i] == 0;
    size_t step = 1;
    for (int i = t->rank - 1; dense && i >= 0; i--) {
        whole.stride[i] = step;
        step *= (size_t)t->shape[i];
    }
    if (whole.parts == 0)
        whole.parts = 1;
    r->tap->put(r->tap->ctx, &whole);
}

void tap_map(const struct run *r, const char *name, int view, int n_views, const int hwc[3],
             const float *px)
{
    size_t c = (size_t)hwc[2], row = (size_t)hwc[1] * c;
    tap_put(r, &(struct tap_tensor){.name = name,
                                    .rank = 4,
                                    .shape = {n_views, hwc[2], hwc[0], hwc[1]},
                                    .part = view,
                                    .parts = n_views,
                                    .data = px,
                                    .stride = {row * (size_t)hwc[0], 1, row, c}});
}
