/* truth.h - splats of a file against those of tests/data/splats/truth.ply, which other programs
 * made the file from, in whatever order.
 * thread: one. */
#ifndef FORMAT_TRUTH_H
#define FORMAT_TRUTH_H

#include "drivers/format/ply.h"

#include <float.h>
#include <math.h>
#include <stdio.h>

/* How far planes may be from the truth. */
struct truth_bound {
    float mu, log_scale, quat, logit, sh;
};

/* Plane p of the truth's splat j and of the file's splat i differ so much; of quaternions the sign
 * does not count. */
static inline float truth_distance(const struct gaussians *t, int j, const struct gaussians *g,
                                   int i, int p)
{
    float sign = 1;
    if (p >= G_QUAT && p < G_QUAT + 4) {
        float dot = 0;
        for (int k = 0; k < 4; k++)
            dot += t->plane[G_QUAT + k][j] * g->plane[G_QUAT + k][i];
        sign = dot < 0 ? -1 : 1;
    }
    return fabsf(t->plane[p][j] - sign * g->plane[p][i]);
}

static inline int truth_nearest(const struct gaussians *t, const struct gaussians *g, int i)
{
    int best = 0;
    float least = FLT_MAX;
    for (int j = 0; j < t->n; j++) {
        float d = 0;
        for (int k = 0; k < 3; k++)
            d += truth_distance(t, j, g, i, G_MU + k);
        best = d < least ? j : best;
        least = fminf(d, least);
    }
    return best;
}

/* Whether each splat of the truth is there once and within the bounds; tells the worst of each
 * kind otherwise. */
static inline bool truth_holds(const struct gaussians *t, const struct gaussians *g,
                               const struct truth_bound *bound)
{
    const struct {
        const char *name;
        int from, to;
        float most;
    } kinds[] = {{"mu", G_MU, G_MU + 3, bound->mu},
                 {"log_scale", G_LOG_SCALE, G_LOG_SCALE + 3, bound->log_scale},
                 {"quat", G_QUAT, G_QUAT + 4, bound->quat},
                 {"logit", G_LOGIT, G_LOGIT + 1, bound->logit},
                 {"sh", G_SH, gaussians_planes(g->degree), bound->sh}};
    bool seen[64] = {false}, good = t->n <= 64 && t->n == g->n && t->degree == g->degree;
    for (int k = 0; k < 5; k++) {
        float worst = 0;
        for (int i = 0; i < g->n && t->degree == g->degree; i++) {
            const int j = truth_nearest(t, g, i);
            good &= k > 0 || !seen[j];
            seen[j] = true;
            for (int p = kinds[k].from; p < kinds[k].to; p++)
                worst = fmaxf(worst, truth_distance(t, j, g, i, p));
        }
        good &= worst <= kinds[k].most;
        printf("%s: %.2g of %.2g\n", kinds[k].name, (double)worst, (double)kinds[k].most);
    }
    return good;
}

#endif
