/* H is singular along the motions N of the world, so H + l C C^T is inverted instead, with C what
 * is fixed of the cameras, C^T N = 1, and l of the size of H. Its inverse is that where C^T x = 0,
 * and N N^T / l, which is taken off. The same holds where motions of the world move points and
 * boards along. */
#include "core/sfm/covariance.h"

#include "core/base/lin.h"
#include "core/sfm/sandwich.h"

#include <math.h>
#include <string.h>

enum { TWIST = 6 };
static const double NO_WEIGHTS = 1e6, // errors, width of a loss that lets all of them count
    DAMPING = 1e-9;                   // of what nothing determines

/* ---- gauge ---- */

static bool counts(const struct covariance_gauge *g, int camera)
{
    return !g->in || g->in[camera];
}

/* Centre of a camera, from the middle. */
static void find_centre(const struct covariance_gauge *g, int camera, double out[3])
{
    const double *pose = g->pose + (size_t)ADJUST_POSE * (size_t)camera;
    lin_apply_t(pose, pose + 9, out);
    for (int k = 0; k < 3; k++)
        out[k] = -out[k] - g->middle[k];
}

struct covariance_gauge covariance_find_gauge(const double *pose, const bool *in, int n,
                                              bool scales)
{
    struct covariance_gauge g = {.n = n, .pose = pose, .in = in, .scales = scales};
    double c[3], sum[3] = {0};
    for (int i = 0; i < n; i++) {
        find_centre(&g, i, c);
        for (int k = 0; k < 3 && counts(&g, i); k++)
            sum[k] += c[k];
        g.counted += counts(&g, i);
    }
    for (int k = 0; k < 3 && g.counted; k++)
        g.middle[k] = sum[k] / g.counted;
    for (int i = 0; i < n; i++) {
        find_centre(&g, i, c);
        g.square += counts(&g, i) ? lin_dot(c, c) : 0;
    }
    return g;
}

/* A world that turns by w, shifts by v and grows by s moves a camera at c from the middle by
 * w x c + v + s c, as the twist (-R w, -R (w x c + v + s c)). */
void covariance_gauge_rows(const struct covariance_gauge *g, int camera,
                           double fixed[TWIST][COVARIANCE_GAUGE],
                           double moves[TWIST][COVARIANCE_GAUGE])
{
    const double *r = g->pose + (size_t)ADJUST_POSE * (size_t)camera;
    const double share = 1 / sqrt(g->counted), unit = g->square > 0 ? 1 / sqrt(g->square) : 0;
    double c[3], outward[3];
    memset(fixed, 0, TWIST * sizeof *fixed);
    memset(moves, 0, TWIST * sizeof *moves);
    if (!counts(g, camera))
        return;
    find_centre(g, camera, c);
    lin_apply(r, c, outward);
    for (int k = 0; k < 3; k++) {
        const double axis[3] = {k == 0, k == 1, k == 2};
        double around[3], turned[3];
        lin_cross(axis, c, around);
        lin_apply(r, around, turned);
        for (int i = 0; i < 3; i++) {
            fixed[i][k] = fixed[3 + i][3 + k] = -share * r[3 * i + k];
            moves[3 + i][k] = -share * turned[i];
        }
        fixed[3 + k][6] = g->scales ? -unit * outward[k] : 0;
    }
    for (int i = 0; i < TWIST * COVARIANCE_GAUGE; i++)
        moves[i / COVARIANCE_GAUGE][i % COVARIANCE_GAUGE] +=
            fixed[i / COVARIANCE_GAUGE][i % COVARIANCE_GAUGE];
}

static double weight_of(const struct covariance_gauge *g, int column)
{
    return g->weight[column >= 3];
}

/* Of two cameras, i after j or the same. */
static void fix_pair(const struct covariance_gauge *g, int i, int j, double *h, int n)
{
    double a[TWIST][COVARIANCE_GAUGE], b[TWIST][COVARIANCE_GAUGE], moves[TWIST][COVARIANCE_GAUGE];
    covariance_gauge_rows(g, i, a, moves);
    covariance_gauge_rows(g, j, b, moves);
    for (int u = 0; u < TWIST * TWIST; u++) {
        const int row = TWIST * i + u / TWIST, column = TWIST * j + u % TWIST;
        for (int k = 0; k < COVARIANCE_GAUGE && column <= row; k++)
            h[(size_t)row * (size_t)n + (size_t)column] +=
                weight_of(g, k) * a[u / TWIST][k] * b[u % TWIST][k];
    }
}

void covariance_fix_gauge(struct covariance_gauge *g, double *h, int n)
{
    g->weight[0] = g->weight[1] = 0;
    for (int i = 0; i < TWIST * g->n; i++)
        g->weight[i % TWIST >= 3] += h[(size_t)i * (size_t)n + (size_t)i] / g->n;
    for (int i = 0; i < g->n; i++)
        for (int j = 0; j <= i; j++)
            fix_pair(g, i, j, h, n);
}

/* ---- inverse ---- */

/* Column k. */
static void invert_column(const double *factor, int n, int k, double *out)
{
    memset(out, 0, (size_t)n * sizeof *out);
    out[k] = 1;
    lin_solve(factor, n, out);
}

double covariance_of_unknown(const double *factor, int n, int k, double *step)
{
    invert_column(factor, n, k, step);
    return fmax(0, step[k]);
}

void covariance_of_pose(const struct covariance_gauge *g, const double *factor, int n, int camera,
                        double *step, double out[COVARIANCE_POSE])
{
    double fixed[TWIST][COVARIANCE_GAUGE], moves[TWIST][COVARIANCE_GAUGE];
    covariance_gauge_rows(g, camera, fixed, moves);
    for (int i = 0; i < TWIST; i++) {
        invert_column(factor, n, TWIST * camera + i, step);
        for (int j = 0; j < TWIST; j++) {
            double *to = out + TWIST * i + j;
            *to = step[TWIST * camera + j];
            for (int k = 0; k < COVARIANCE_GAUGE; k++)
                *to -= moves[i][k] * moves[j][k] / weight_of(g, k);
        }
    }
}

void covariance_deviations(const double pose[COVARIANCE_POSE], double out[2])
{
    for (int k = 0; k < 2; k++) {
        const double *c = pose + 3 * (TWIST + 1) * k;
        out[k] = sqrt(fmax(0, c[0] + c[TWIST + 1] + c[2 * (TWIST + 1)]));
    }
}

/* ---- of adjustment ---- */

static void write_lenses(struct normal *m, struct sandwich *s, bool ok, double *out)
{
    const struct adjust *a = m->a;
    for (int i = 0; i < a->n_lenses; i++)
        for (int p = 0, k = m->at[i]; p < ADJUST_LENS; p++) {
            double *to = out + ADJUST_LENS * i + p;
            *to = a->lens[i].free[p] ? INFINITY : 0;
            if (!ok || !a->lens[i].free[p])
                continue;
            const double alone = s->alone * covariance_of_unknown(m->sum, m->n, k++, m->step);
            *to = sqrt(fmax(alone, sandwich_variance(s, m->step)));
        }
}

/* Of errors that share nothing, all of it larger by what variances are on the mean. */
static void write_pose(struct normal *m, struct sandwich *s, const struct covariance_gauge *g,
                       int view, double *out)
{
    double larger = 0;
    covariance_of_pose(g, m->sum, m->n, view, m->step, out);
    for (int k = 0; k < TWIST; k++) {
        const double alone = s->alone * out[(TWIST + 1) * k];
        invert_column(m->sum, m->n, TWIST * view + k, m->step);
        larger += alone > 0 ? fmax(1, sandwich_variance(s, m->step) / alone) : 1;
    }
    for (int k = 0; k < COVARIANCE_POSE; k++)
        out[k] *= s->alone * larger / TWIST;
}

static void write_poses(struct normal *m, struct sandwich *s, const struct covariance_gauge *g,
                        bool ok, double *out)
{
    for (int v = 0; v < m->a->n_views; v++) {
        double *to = out + (size_t)COVARIANCE_POSE * (size_t)v;
        const bool fixed = !m->a->placed[v] || m->a->poses_fixed;
        for (int k = 0; k < COVARIANCE_POSE; k++)
            to[k] = fixed ? 0 : INFINITY;
        if (ok && !fixed)
            write_pose(m, s, g, v, to);
    }
}

size_t covariance_plan(int n_views, int n_lenses, int n_tracks, int n_obs)
{
    return arena_add(adjust_plan(n_views, n_lenses, n_tracks),
                     sandwich_plan(n_views, n_lenses, n_tracks, n_obs));
}

err_t covariance_run(const struct run *r, struct adjust *a, double *lens, double *pose)
{
    const size_t mark = arena_mark(r->tmp);
    struct normal m;
    struct backup before;
    struct sandwich s = {0};
    err_t e = adjust_begin_system(r, a, NO_WEIGHTS, &m, &before);
    m.damping = DAMPING;
    if (!e)
        e = adjust_sum_system(&m);
    if (!e)
        e = sandwich_begin(&m, &s);
    if (!e) {
        struct covariance_gauge g = covariance_find_gauge(a->pose, a->placed, a->n_views, true);
        if (!a->poses_fixed)
            covariance_fix_gauge(&g, m.sum, m.n);
        const bool ok = isfinite(s.factor) && lin_cholesky(m.sum, m.n);
        write_lenses(&m, &s, ok, lens);
        if (pose)
            write_poses(&m, &s, &g, ok, pose);
    }
    arena_reset(r->tmp, mark);
    return e;
}
