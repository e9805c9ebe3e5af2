/* Splitting keeps the picture nearly the same: along the longest axis (standard deviation s) the
 * two halves sit at +-0.5 s with standard deviation 0.8 s; their sum differs from the original by a
 * few per cent where both are thin. */
#include "core/refine/density.h"

#include "core/base/gaussians.h"
#include "core/base/rotation.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

err_t density_init(struct density *d, struct arena *a, struct gaussians *g, int degree)
{
    memset(d, 0, sizeof *d);
    d->g = g;
    size_t n = (size_t)g->cap;
    err_t e = OK;
    for (int p = 0; p < gaussians_planes(degree) && !e; p++) {
        /* bands that are added later zero their moments then */
        bool used = p < gaussians_planes(g->degree);
        e = (used ? arena_zalloc : arena_alloc)(a, n, 4, &d->m1[p]);
        if (!e)
            e = (used ? arena_zalloc : arena_alloc)(a, n, 4, &d->m2[p]);
    }
    if (!e)
        e = arena_zalloc(a, n, 4, &d->score);
    if (!e)
        e = arena_alloc(a, n, 4, &d->order);
    if (!e)
        e = arena_alloc(a, n, 4, &d->tmp);
    return e ? e : arena_alloc(a, n, 8, &d->key);
}

size_t density_plan(int cap, int degree)
{
    struct arena planes = arena_counter(), a = arena_counter();
    struct gaussians g;
    struct density d;
    if (gaussians_init(&g, &planes, cap, degree) || density_init(&d, &a, &g, degree))
        return SIZE_MAX;
    return a.peak;
}

/* Keep the splats order[0..n), in this order. */
static void reorder_splats(struct density *d, int n)
{
    struct gaussians *g = d->g;
    for (int p = 0; p < 3 * gaussians_planes(g->degree) + 1; p++) {
        int kind = p / gaussians_planes(g->degree), k = p % gaussians_planes(g->degree);
        float *a = kind == 0 ? g->plane[k] : kind == 1 ? d->m1[k] : kind == 2 ? d->m2[k] : d->score;
        for (int i = 0; i < n; i++)
            d->tmp[i] = a[d->order[i]];
        memcpy(a, d->tmp, (size_t)n * sizeof *a);
    }
    g->n = n;
}

static uint64_t spread_bits(uint32_t x)
{
    uint64_t v = x & 0xffff;
    v = (v | v << 16) & 0x0000ff0000ffull;
    v = (v | v << 8) & 0x00f00f00f00full;
    v = (v | v << 4) & 0x0c30c30c30c3ull;
    return (v | v << 2) & 0x249249249249ull;
}

static int by_key(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

/* 13 bits per axis of the position squashed by x/(1+|x|) around the median, then the number. */
void density_sort(struct density *d)
{
    struct gaussians *g = d->g;
    double mean[3] = {0}, dev = 0;
    for (int i = 0; i < g->n; i++)
        for (int k = 0; k < 3; k++)
            mean[k] += (double)g->plane[k][i] / g->n;
    for (int i = 0; i < g->n; i++)
        for (int k = 0; k < 3; k++)
            dev += fabs((double)g->plane[k][i] - mean[k]) / (3.0 * g->n);
    for (int i = 0; i < g->n; i++) {
        uint64_t code = 0;
        for (int k = 0; k < 3; k++) {
            double x = ((double)g->plane[k][i] - mean[k]) / fmax(dev, 1e-12);
            code |= spread_bits((uint32_t)((x / (1 + fabs(x)) + 1) * 4095)) << k;
        }
        d->key[i] = code << 24 | (uint32_t)i;
    }
    qsort(d->key, (size_t)g->n, sizeof *d->key, by_key);
    for (int i = 0; i < g->n; i++)
        d->order[i] = (uint32_t)(d->key[i] & 0xffffff);
    reorder_splats(d, g->n);
}

int density_prune(struct density *d, float min_opacity)
{
    struct gaussians *g = d->g;
    float logit = logf(min_opacity / (1 - min_opacity));
    int n = 0, before = g->n;
    for (int i = 0; i < before; i++) {
        float sum = 0;
        for (int p = 0; p < gaussians_planes(g->degree); p++)
            sum += g->plane[p][i] * 0.0f;
        if (sum == 0.0f && g->plane[G_LOGIT][i] >= logit)
            d->order[n++] = (uint32_t)i;
    }
    if (n < before)
        reorder_splats(d, n);
    return before - n;
}

static void split_one(struct density *d, int i, int j)
{
    struct gaussians *g = d->g;
    for (int p = 0; p < gaussians_planes(g->degree); p++) {
        g->plane[p][j] = g->plane[p][i];
        d->m1[p][i] = d->m1[p][j] = 0;
        d->m2[p][j] = d->m2[p][i];
    }
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (g->plane[G_LOG_SCALE + k][i] > g->plane[G_LOG_SCALE + axis][i])
            axis = k;
    double q[4], r[9];
    for (int k = 0; k < 4; k++)
        q[k] = (double)g->plane[G_QUAT + k][i];
    rotation_from_quat(q, r);
    float half = 0.5f * expf(g->plane[G_LOG_SCALE + axis][i]);
    for (int k = 0; k < 3; k++) {
        float step = half * (float)r[3 * k + axis];
        g->plane[G_MU + k][i] -= step;
        g->plane[G_MU + k][j] += step;
    }
    g->plane[G_LOG_SCALE + axis][i] += logf(0.8f);
    g->plane[G_LOG_SCALE + axis][j] = g->plane[G_LOG_SCALE + axis][i];
}

int density_split(struct density *d, int count)
{
    struct gaussians *g = d->g;
    int n = g->n, room = g->cap - n;
    /* positive floats order like integers; highest score first, ties by number */
    for (int i = 0; i < n; i++) {
        uint32_t bits;
        float s = d->score[i] > 0 && isfinite(d->score[i]) ? d->score[i] : 0.0f;
        memcpy(&bits, &s, 4);
        d->key[i] = (uint64_t)~bits << 32 | (uint32_t)i;
    }
    qsort(d->key, (size_t)n, sizeof *d->key, by_key);
    count = count < room ? count : room;
    int made = 0;
    while (made < count && made < n && d->key[made] >> 32 != 0xffffffffu) {
        split_one(d, (int)(d->key[made] & 0xffffffffu), n + made);
        made++;
    }
    g->n = n + made;
    memset(d->score, 0, (size_t)g->n * sizeof *d->score);
    return made;
}
