#include "core/base/gaussians.h"

#include <math.h>
#include <string.h>

static bool size_is_allowed(int cap, int degree)
{
    return cap >= 0 && cap <= GAUSSIANS_MAX && degree >= 0 && degree <= SH_DEGREE_MAX;
}

int gaussians_cap(int cap)
{
    return cap > 16 ? (cap + 15) / 16 * 16 : 16;
}

err_t gaussians_init(struct gaussians *g, struct arena *a, int cap, int degree)
{
    memset(g, 0, sizeof *g);
    if (!size_is_allowed(cap, degree))
        return err_fail(
            ERR_ARG, "gaussians: %d splats of SH degree %d, allowed are 0 to %d of degree 0 to %d",
            cap, degree, GAUSSIANS_MAX, SH_DEGREE_MAX);
    size_t mark = arena_mark(a);
    for (int p = 0; p < gaussians_planes(degree); p++) {
        err_t e = arena_zalloc(a, (size_t)gaussians_cap(cap), sizeof(float), &g->plane[p]);
        if (e) {
            arena_reset(a, mark);
            memset(g, 0, sizeof *g);
            return e;
        }
    }
    g->cap = gaussians_cap(cap);
    g->degree = degree;
    return OK;
}

size_t gaussians_need(int cap, int degree)
{
    struct arena a = arena_counter();
    struct gaussians g;
    return gaussians_init(&g, &a, cap, degree) ? SIZE_MAX : a.peak;
}

static bool is_finite(const struct gaussians *g, int n_planes, int i)
{
    for (int p = 0; p < n_planes; p++)
        if (!isfinite(g->plane[p][i]))
            return false;
    return true;
}

static bool clamp_value(float *v, float lo, float hi)
{
    if (*v >= lo && *v <= hi)
        return false;
    *v = *v < lo ? lo : hi;
    return true;
}

static bool repair_quat(const struct gaussians *g, int i)
{
    double sum = 0;
    for (int k = 0; k < 4; k++)
        sum += (double)g->plane[G_QUAT + k][i] * g->plane[G_QUAT + k][i];
    double length = sqrt(sum);
    if (length >= 1e-6 && length <= 1e6)
        return false;
    for (int k = 0; k < 4; k++) {
        float *v = &g->plane[G_QUAT + k][i];
        *v = length < 1e-6 ? (float)(k == 0) : (float)(*v / length);
    }
    return true;
}

static bool repair_splat(const struct gaussians *g, int i)
{
    bool changed = repair_quat(g, i);
    for (int k = 0; k < 3; k++)
        changed |= clamp_value(&g->plane[G_LOG_SCALE + k][i], GAUSSIANS_LOG_SCALE_MIN,
                               GAUSSIANS_LOG_SCALE_MAX);
    changed |= clamp_value(&g->plane[G_LOGIT][i], -GAUSSIANS_LOGIT_MAX, GAUSSIANS_LOGIT_MAX);
    return changed;
}

void gaussians_move(const struct gaussians *g, int from, int to)
{
    for (int p = 0; p < gaussians_planes(g->degree) && from != to; p++)
        g->plane[p][to] = g->plane[p][from];
}

void gaussians_sanitize(struct gaussians *g, struct gaussians_report *report)
{
    int n_planes = gaussians_planes(g->degree), kept = 0;
    *report = (struct gaussians_report){0};
    for (int i = 0; i < g->n; i++) {
        if (!is_finite(g, n_planes, i))
            continue;
        gaussians_move(g, i, kept);
        report->repaired += repair_splat(g, kept);
        kept++;
    }
    report->dropped = g->n - kept;
    g->n = kept;
}

void gaussians_scale(struct gaussians *g, float scale)
{
    const float add = logf(scale);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < g->n; i++) {
            g->plane[G_MU + k][i] *= scale;
            g->plane[G_LOG_SCALE + k][i] += add;
        }
}

void gaussians_copy(const struct gaussians *from, int degree_max, struct gaussians *to)
{
    to->n = from->n;
    to->degree = from->degree < degree_max ? from->degree : degree_max;
    for (int p = 0; p < gaussians_planes(to->degree); p++)
        memcpy(to->plane[p], from->plane[p], (size_t)from->n * sizeof(float));
}
