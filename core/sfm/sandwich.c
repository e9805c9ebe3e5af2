/* The gradient of a track with its point eliminated is that of its errors less what a step of the
 * point takes away. */
#include "core/sfm/sandwich.h"

#include "core/base/lin.h"
#include "core/base/num.h"

#include <math.h>
#include <string.h>

enum { CELLS = 8, SLOPES = 6 + ADJUST_LENS }; // parts of a picture along an edge

static err_t layout(struct sandwich *s, struct arena *tmp, const int count[4])
{
    s->n = CELLS * CELLS * count[0] + ADJUST_LENS * count[1];
    err_t e = arena_zalloc(tmp, SLOPES * (size_t)count[3], sizeof *s->slope, &s->slope);
    if (!e)
        e = arena_alloc(tmp, (size_t)count[2], sizeof *s->part, &s->part);
    return e ? e : arena_alloc(tmp, (size_t)s->n, sizeof *s->effect, &s->effect);
}

size_t sandwich_plan(int n_views, int n_lenses, int n_tracks, int n_obs)
{
    struct arena tmp = arena_counter();
    struct sandwich s;
    return layout(&s, &tmp, (int[4]){n_views, n_lenses, n_tracks, n_obs}) ? SIZE_MAX : tmp.peak;
}

/* Farthest observation from the middle, along u or v. */
static double farthest(const struct adjust *a)
{
    float most = 1;
    for (int i = 0; i < a->first[a->n_tracks]; i++)
        most = fmaxf(most, fmaxf(fabsf(a->obs[i].u), fabsf(a->obs[i].v)));
    return (double)most;
}

static int part_of(const struct adjust_observation *o, double most)
{
    const int x = (int)(((double)o->u / most + 1) * CELLS / 2),
              y = (int)(((double)o->v / most + 1) * CELLS / 2);
    return (o->view * CELLS + num_min(y, CELLS - 1)) * CELLS + num_min(x, CELLS - 1);
}

/* The step of a track's point that its errors ask for. False where it has none. */
static bool step_point(const struct adjust *a, int track, double out[3])
{
    double h[9] = {0}, g[3] = {0}, inverse[9];
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        struct adjust_jacobian s;
        if (!a->in[i] || !adjust_jacobian(a, a->point + 4 * (size_t)track, &a->obs[i], &s))
            continue;
        for (int k = 0; k < 9; k++)
            h[k] += s.point[0][k / 3] * s.point[0][k % 3] + s.point[1][k / 3] * s.point[1][k % 3];
        for (int k = 0; k < 3; k++)
            g[k] -= s.point[0][k] * s.error[0] + s.point[1][k] * s.error[1];
    }
    if (!lin_inverse3(h, inverse))
        return false;
    lin_apply(inverse, g, out);
    return true;
}

/* Its squared errors go to s->alone. returns: observations. */
static int add_track(struct sandwich *s, int track, double most)
{
    const struct adjust *a = s->m->a;
    double step[3];
    int n = 0;
    s->part[track] = -1;
    if (!step_point(a, track, step))
        return 0;
    for (int i = a->first[track]; i < a->first[track + 1]; i++) {
        struct adjust_jacobian j;
        double *to = s->slope + (size_t)SLOPES * (size_t)i;
        if (!a->in[i] || !adjust_jacobian(a, a->point + 4 * (size_t)track, &a->obs[i], &j))
            continue;
        for (int k = 0; k < 2; k++) {
            const double left = j.error[k] + lin_dot(j.point[k], step);
            s->alone += j.error[k] * j.error[k];
            for (int p = 0; p < 6; p++)
                to[p] -= j.pose[k][p] * left;
            for (int p = 0; p < ADJUST_LENS; p++)
                to[6 + p] -= j.lens[k][p] * left;
        }
        if (n++ == 0)
            s->part[track] = part_of(&a->obs[i], most);
    }
    return n;
}

/* Parts that have tracks. */
static int count_parts(struct sandwich *s)
{
    int n = 0;
    memset(s->effect, 0, (size_t)s->n * sizeof *s->effect);
    for (int t = 0; t < s->m->a->n_tracks; t++)
        if (s->part[t] >= 0 && s->effect[s->part[t]] == 0) {
            s->effect[s->part[t]] = 1;
            n++;
        }
    return n;
}

err_t sandwich_begin(const struct normal *m, struct sandwich *out)
{
    const struct adjust *a = m->a;
    struct sandwich s = {.m = m};
    err_t e = layout(&s, m->r->tmp,
                     (int[4]){a->n_views, a->n_lenses, a->n_tracks, a->first[a->n_tracks]});
    if (e)
        return e;
    const double most = farthest(a);
    double equations = 0, more = -(m->at[a->n_lenses] - m->at[0]);
    for (int t = 0; t < a->n_tracks; t++)
        equations += num_max(0, 2 * add_track(&s, t, most) - 3);
    for (int v = 0; v < a->n_views; v++)
        more -= a->placed[v] && !a->poses_fixed ? 6 : 0;
    more += equations;
    const double parts = count_parts(&s);
    const bool enough = parts > 1 && more > 0;
    s.alone = enough ? s.alone / more : INFINITY;
    s.factor = enough ? parts / (parts - 1) * equations / more : INFINITY;
    *out = s;
    return OK;
}

static double product(const struct sandwich *s, int i, const double *row)
{
    const struct normal *m = s->m;
    const int view = m->a->obs[i].view, lens = m->a->lens_of[view];
    const double *slope = s->slope + (size_t)SLOPES * (size_t)i, *by_lens = row + m->at[lens];
    double sum = 0;
    for (int p = 0; p < 6; p++)
        sum += slope[p] * row[6 * view + p];
    for (int p = 0; p < ADJUST_LENS; p++)
        sum += m->a->lens[lens].free[p] ? slope[6 + p] * *by_lens++ : 0;
    return sum;
}

double sandwich_variance(struct sandwich *s, const double *row)
{
    const struct adjust *a = s->m->a;
    double *expected = s->effect + CELLS * CELLS * a->n_views, sum = 0;
    memset(s->effect, 0, (size_t)s->n * sizeof *s->effect);
    for (int t = 0; t < a->n_tracks; t++)
        for (int i = a->first[t]; i < a->first[t + 1] && s->part[t] >= 0; i++)
            s->effect[s->part[t]] += a->in[i] ? product(s, i, row) : 0;
    for (int i = 0; i < a->n_lenses; i++)
        for (int p = 0, at = s->m->at[i]; p < ADJUST_LENS; p++)
            if (a->lens[i].free[p])
                expected[ADJUST_LENS * i + p] = row[at++] * adjust_prior_weight(&a->lens[i], p);
    for (int c = 0; c < s->n; c++)
        sum += s->effect[c] * s->effect[c];
    return s->factor * sum;
}
