/* Points are sorted by their keys with a stable radix sort, so every sum has one fixed order. With
 * c the confidence, the weight of a point in its cell is exp(c - max c) / (sum exp(c - max c) +
 * 1e-6); position and raw features are averaged with it. Then one plane after the other is gathered
 * and averaged, each by one thread. Formulas: core/splat/README.md 6; guards: hazards 17 to 22 of
 * core/net/README.md 5. Sums are taken in double. */
#include "core/splat/voxel.h"

#include "core/base/gaussians.h"

#include <math.h>
#include <string.h>

enum { DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS, BLOCK = 1024 };

static const float KEY_MAX = 2147483520.0f;             // largest float that fits int32_t
static const double WEIGHT_EPS = 1e-6, QUAT_EPS = 1e-8; // core/splat/README.md 6
static const float SCALE_MAX = 0.3f;                    // core/splat/README.md 6
static const float SCALE_MIN = 1e-12f;                  // ln must stay finite
static const float SOFTPLUS_LINEAR = 20.0f;             // beyond, softplus(x) = x in float

struct merge {
    const struct run *r;
    const struct voxel_input *in;
    struct voxels *out;
    int32_t *key[3]; // (in->n) by pixel
    uint32_t *order; // (n) pixels, in the end sorted by key
    uint32_t *spare; // (n)
    uint32_t *start; // (cells + 1) positions in `order`
    float *weight;   // (n) by position in `order`
    uint32_t n;      // finite points
};

static int rounded_cap(int n)
{
    return n < 16 ? 16 : (n + 15) / 16 * 16;
}

static err_t layout_scratch(struct merge *m, struct arena *a, int points)
{
    size_t n = (size_t)points;
    err_t e = OK;
    for (int k = 0; k < 3 && !e; k++)
        e = arena_alloc(a, n, sizeof *m->key[k], &m->key[k]);
    if (!e)
        e = arena_alloc(a, n, sizeof *m->order, &m->order);
    if (!e)
        e = arena_alloc(a, n, sizeof *m->spare, &m->spare);
    if (!e)
        e = arena_alloc(a, n, sizeof *m->weight, &m->weight);
    return e ? e : arena_alloc(a, n + 1, sizeof *m->start, &m->start);
}

/* There are at most as many cells as points; memory beyond the cells is never touched. */
static err_t layout_cells(struct voxels *v, struct arena *a, int points)
{
    v->cap = rounded_cap(points);
    err_t e = arena_alloc(a, (size_t)points, 3 * sizeof *v->key, &v->key);
    if (!e)
        e = arena_alloc(a, (size_t)points, sizeof *v->count, &v->count);
    if (!e)
        e = arena_alloc(a, (size_t)v->cap, 3 * sizeof *v->points, &v->points);
    return e ? e
             : arena_alloc(a, (size_t)v->cap, VOXEL_FEATURES * sizeof *v->features, &v->features);
}

void voxel_plan(struct plan *p, int points)
{
    struct voxels v;
    struct merge m;
    size_t mark = arena_mark(&p->tmp);
    if (points < 0 || points > GAUSSIANS_MAX || layout_scratch(&m, &p->tmp, points) ||
        layout_cells(&v, &p->keep, points))
        plan_refuse(p);
    arena_reset(&p->tmp, mark);
}

static void make_keys(struct merge *m, float cell)
{
    for (int i = 0; i < m->in->n; i++) {
        const float *p = m->in->points + 3 * (size_t)i;
        if (!isfinite(p[0]) || !isfinite(p[1]) || !isfinite(p[2]) ||
            !isfinite(m->in->confidence[i]))
            continue;
        for (int k = 0; k < 3; k++) {
            float f = rintf(p[k] / cell); // ties to even; a tiny cell can make it infinite
            m->key[k][i] = (int32_t)fminf(fmaxf(f, -KEY_MAX), KEY_MAX);
        }
        m->order[m->n++] = (uint32_t)i;
    }
}

/* One stable pass of the sort: by DIGIT_BITS bits of key - lo. */
static void sort_digit(struct merge *m, const int32_t *key, int32_t lo, int shift)
{
    uint32_t at[DIGITS] = {0}, sum = 0;
    for (uint32_t j = 0; j < m->n; j++)
        at[((uint32_t)key[m->order[j]] - (uint32_t)lo) >> shift & (DIGITS - 1)]++;
    for (int d = 0; d < DIGITS; d++) {
        uint32_t count = at[d];
        at[d] = sum;
        sum += count;
    }
    for (uint32_t j = 0; j < m->n; j++) {
        uint32_t i = m->order[j];
        m->spare[at[((uint32_t)key[i] - (uint32_t)lo) >> shift & (DIGITS - 1)]++] = i;
    }
    uint32_t *swap = m->order;
    m->order = m->spare;
    m->spare = swap;
}

static err_t sort_axis(struct merge *m, const int32_t *key)
{
    int32_t lo = INT32_MAX, hi = INT32_MIN;
    for (uint32_t j = 0; j < m->n; j++) {
        int32_t k = key[m->order[j]];
        lo = k < lo ? k : lo;
        hi = k > hi ? k : hi;
    }
    uint32_t range = m->n ? (uint32_t)hi - (uint32_t)lo : 0;
    for (int shift = 0; shift < 32 && range >> shift; shift += DIGIT_BITS) {
        err_t e = run_check(m->r, "voxels");
        if (e)
            return e;
        sort_digit(m, key, lo, shift);
    }
    return OK;
}

static bool same_cell(const struct merge *m, uint32_t a, uint32_t b)
{
    return m->key[0][a] == m->key[0][b] && m->key[1][a] == m->key[1][b] &&
           m->key[2][a] == m->key[2][b];
}

/* returns: number of cells. */
static int find_cells(struct merge *m)
{
    int cells = 0;
    for (uint32_t j = 0; j < m->n; j++)
        if (j == 0 || !same_cell(m, m->order[j - 1], m->order[j]))
            m->start[cells++] = j;
    m->start[cells] = m->n;
    return cells;
}

static void weigh_cell(struct merge *m, uint32_t from, uint32_t to)
{
    const float *c = m->in->confidence;
    float top = c[m->order[from]];
    double sum = WEIGHT_EPS;
    for (uint32_t j = from + 1; j < to; j++)
        top = fmaxf(top, c[m->order[j]]);
    for (uint32_t j = from; j < to; j++) {
        m->weight[j] = expf(c[m->order[j]] - top);
        sum += (double)m->weight[j];
    }
    for (uint32_t j = from; j < to; j++)
        m->weight[j] = (float)((double)m->weight[j] / sum);
}

/* One plane of coordinates (chunks 0..2) or features. */
static err_t average_chunk(void *ctx, int chunk, int worker)
{
    const struct merge *m = ctx;
    (void)worker;
    err_t e = run_check(m->r, "voxels");
    if (e)
        return e;
    bool point = chunk < 3;
    size_t plane = (size_t)(point ? chunk : chunk - 3), cap = (size_t)m->out->cap;
    const float *in = point ? m->in->points + plane : m->in->features + plane * (size_t)m->in->n;
    float *out = (point ? m->out->points : m->out->features) + plane * cap;
    size_t step = point ? 3 : 1;
    for (int v = 0; v < m->out->n; v++) {
        double sum = 0;
        for (uint32_t j = m->start[v]; j < m->start[v + 1]; j++)
            sum += (double)m->weight[j] * (double)in[step * m->order[j]];
        out[v] = (float)sum;
    }
    for (int v = m->out->n; v < rounded_cap(m->out->n); v++)
        out[v] = 0.0f;
    return OK;
}

static err_t merge_points(struct merge *m, float cell)
{
    err_t e = layout_scratch(m, m->r->tmp, m->in->n);
    if (!e)
        e = layout_cells(m->out, m->r->keep, m->in->n);
    if (e)
        return e;
    make_keys(m, cell);
    for (int k = 2; k >= 0 && !e; k--)
        e = sort_axis(m, m->key[k]);
    if (e)
        return e;
    m->out->n = find_cells(m);
    for (int v = 0; v < m->out->n; v++) {
        uint32_t from = m->start[v], to = m->start[v + 1];
        weigh_cell(m, from, to);
        m->out->count[v] = (int32_t)(to - from);
        for (int k = 0; k < 3; k++)
            m->out->key[3 * (size_t)v + (size_t)k] = m->key[k][m->order[from]];
    }
    return pool_for(m->r->pool, 3 + VOXEL_FEATURES, average_chunk, m);
}

err_t voxel_merge(const struct run *r, const struct voxel_input *in, float cell, struct voxels *out)
{
    memset(out, 0, sizeof *out);
    if (in->n < 0 || in->n > GAUSSIANS_MAX)
        return err_fail(ERR_ARG, "voxels: %d points, must be 0..%d", in->n, GAUSSIANS_MAX);
    if (!(cell > 0.0f) || !isfinite(cell))
        return err_fail(ERR_ARG, "voxels: edge of a cell is %g, must be finite and > 0",
                        (double)cell);
    struct merge m = {.r = r, .in = in, .out = out};
    size_t tmp = arena_mark(r->tmp), keep = arena_mark(r->keep);
    err_t e = merge_points(&m, cell);
    arena_reset(r->tmp, tmp);
    if (e) {
        arena_reset(r->keep, keep);
        memset(out, 0, sizeof *out);
    }
    return e;
}

/* ln(min(0.3, 0.001 softplus(x))). Comparisons, not fminf: NaN stays NaN. */
static float log_scale(float x)
{
    float s = VOXEL_SCALE_UNIT * (x > SOFTPLUS_LINEAR ? x : log1pf(expf(x)));
    s = s > SCALE_MAX ? SCALE_MAX : s;
    return logf(s < SCALE_MIN ? SCALE_MIN : s);
}

static void normalise_quat(struct gaussians *g, int i)
{
    double sum = 0;
    for (int k = 0; k < 4; k++)
        sum += (double)g->plane[G_QUAT + k][i] * (double)g->plane[G_QUAT + k][i];
    double len = sqrt(sum) + QUAT_EPS;
    for (int k = 0; k < 4; k++)
        g->plane[G_QUAT + k][i] = (float)((double)g->plane[G_QUAT + k][i] / len);
}

struct adapt {
    const struct run *r;
    struct gaussians *g;
};

static err_t adapt_chunk(void *ctx, int chunk, int worker)
{
    const struct adapt *a = ctx;
    struct gaussians *g = a->g;
    (void)worker;
    int from = chunk * BLOCK, to = g->n - from < BLOCK ? g->n : from + BLOCK;
    for (int i = from; i < to; i++) {
        for (int k = 0; k < 3; k++)
            g->plane[G_LOG_SCALE + k][i] = log_scale(g->plane[G_LOG_SCALE + k][i]);
        normalise_quat(g, i);
    }
    float mask = 0.1f; // for degree d: 0.1 * 0.25^d
    for (int d = 1; d <= SH_DEGREE_MAX; d++) {
        mask *= 0.25f;
        for (int p = G_SH + 3 * d * d; p < G_SH + 3 * (d + 1) * (d + 1); p++)
            for (int i = from; i < to; i++)
                g->plane[p][i] *= mask;
    }
    return run_check(a->r, "voxels");
}

err_t voxel_adapt(const struct run *r, struct voxels *io, struct gaussians *out)
{
    size_t cap = (size_t)io->cap;
    float *f = io->features;
    *out = (struct gaussians){.n = io->n, .cap = io->cap, .degree = SH_DEGREE_MAX};
    for (size_t k = 0; k < 3; k++) {
        out->plane[G_MU + k] = io->points + k * cap;
        out->plane[G_LOG_SCALE + k] = f + (VOXEL_SCALE + k) * cap;
        out->plane[G_QUAT + 1 + k] = f + (VOXEL_QUAT + k) * cap;
        for (size_t b = 0; b < SH_COEFS_MAX; b++)
            out->plane[G_SH + 3 * b + k] = f + (VOXEL_SH + SH_COEFS_MAX * k + b) * cap;
    }
    out->plane[G_QUAT] = f + (VOXEL_QUAT + 3) * cap;
    out->plane[G_LOGIT] = f + VOXEL_LOGIT * cap;
    struct adapt a = {r, out};
    err_t e = pool_for(r->pool, (io->n + BLOCK - 1) / BLOCK, adapt_chunk, &a);
    if (e)
        memset(out, 0, sizeof *out);
    return e;
}

err_t voxel_merge_most(const struct run *r, const struct voxel_input *in, float cell, int max,
                       struct voxels *out, float *used)
{
    const size_t mark = arena_mark(r->keep);
    for (*used = cell;;) {
        err_t e = voxel_merge(r, in, *used, out);
        if (e || max == 0 || out->n <= max)
            return e;
        arena_reset(r->keep, mark);
        *used *= fmaxf(1.05f, sqrtf((float)out->n / (float)max)); // surfaces: n ~ 1 / cell^2
    }
}
