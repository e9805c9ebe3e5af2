/* bundle_job.h - one bundle adjustment of a rig in a room, with the memory that its plan asks for,
 * and its cameras against the true ones. */
#ifndef SFM_BUNDLE_JOB_H
#define SFM_BUNDLE_JOB_H

#include "core/base/rotation.h"
#include "core/sfm/similarity.h"
#include "tests/unit/core/sfm/bundle_scene.h"
#include "tests/unit/squares.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static const double DEGREE = 3.14159265358979323846 / 180;

/* One lens whose focal length is known, px. */
#define KNOWN_LENS(f)                                                                              \
    .n_lenses = 1, .lens = &(struct bundle_lens)                                                   \
    {                                                                                              \
        .start = {.fx = f }                                                                        \
    }

/* ---- one job with the room that the plan asks for ---- */

struct job {
    struct scene_rig rig;
    struct scene_tracks tracks;
    struct arena keep, tmp;
    struct bundle_result out;
};

static float squeezed = 1; // height over width of the photographs

static inline struct views views_of(int n)
{
    return (struct views){
        .n = n, .size = SCENE_SIZE, .aspect = squeezed, .extent = squares(n, SCENE_SIZE)};
}

static inline err_t run_on(struct job *j, const struct bundle_config *cfg, int threads)
{
    struct pool *pool = NULL;
    struct run r = {.keep = &j->keep, .tmp = &j->tmp};
    arena_free(&j->keep);
    arena_free(&j->tmp);
    struct plan plan = plan_begin(threads);
    bundle_plan(&plan, j->rig.n_views, SCENE_LENSES, &j->tracks.t);
    assert_int_equal(arena_init(&j->keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&j->tmp, "tmp", plan.tmp.peak), OK);
    if (threads > 1)
        assert_int_equal(pool_open(&pool, threads), OK);
    r.pool = pool;
    const struct views v = views_of(j->rig.n_views);
    err_t e = bundle_run(&r, &v, &j->tracks.t, cfg, &j->out);
    pool_close(pool);
    assert_int_equal(j->tmp.used, 0);
    return e;
}

static inline void run_ok(struct job *j, const struct bundle_config *cfg)
{
    assert_int_equal(run_on(j, cfg, 2), OK);
    for (int v = 0; v < j->rig.n_views; v++) {
        const struct camera *c = &j->out.cams[v];
        float length = 0;
        for (int k = 0; k < 4; k++)
            length += c->q[k] * c->q[k];
        assert_float_equal(length, 1, 1e-4f);
        assert_true(isfinite(c->t[0] + c->t[1] + c->t[2]) && c->fx > 0 && isfinite(c->fx));
        assert_true(c->fx == c->fy && c->w == SCENE_SIZE);
        assert_true(cfg->n_lenses > 1 || c->fx == j->out.cams[0].fx);
        assert_true(c->cx == SCENE_SIZE / 2 && c->cy == SCENE_SIZE / 2);
        assert_true(j->out.depth_scale[v] > 0 && isfinite(j->out.depth_scale[v]));
    }
    assert_true(j->out.confidence >= 0 && j->out.confidence <= 1);
    assert_true(isfinite(j->out.rms_px));
    assert_int_equal(j->out.observations, j->tracks.t.n);
}

static inline void job_free(struct job *j)
{
    scene_free(&j->tracks);
    arena_free(&j->keep);
    arena_free(&j->tmp);
}

static inline struct scene_rig make_room(int n_points, double focal, double wrong, double reach)
{
    return (struct scene_rig){.n_points = n_points,
                              .focal = focal,
                              .noise = 0.5,
                              .wrong = wrong,
                              .reach = reach,
                              .seed = 11};
}

static inline int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Medians after the best similarity: degrees, and distances over the spread of the centres. */
static inline void compare(const struct job *j, double *turn, double *centre)
{
    const int n = j->rig.n_views;
    double angle[SCENE_VIEWS], off[SCENE_VIEWS], at[SCENE_VIEWS][3], mean[3] = {0}, spread = 0;
    struct similarity w;
    struct arena tmp;
    assert_int_equal(arena_init(&tmp, "tmp", similarity_plan(n)), OK);
    struct run r = {.tmp = &tmp};
    assert_int_equal(similarity_fit(&r, j->out.cams, j->rig.cams, n, &w), OK);
    arena_free(&tmp);
    for (int v = 0; v < n; v++) {
        struct camera moved = similarity_apply(&w, &j->out.cams[v]);
        double p[3];
        angle[v] = scene_between(&moved, &j->rig.cams[v]);
        rotation_centre(&moved, p);
        rotation_centre(&j->rig.cams[v], at[v]);
        off[v] = 0;
        for (int k = 0; k < 3; k++) {
            off[v] += (p[k] - at[v][k]) * (p[k] - at[v][k]);
            mean[k] += at[v][k] / n;
        }
    }
    for (int i = 0; i < 3 * n; i++)
        spread += (at[i / 3][i % 3] - mean[i % 3]) * (at[i / 3][i % 3] - mean[i % 3]) / n;
    qsort(angle, (size_t)n, sizeof *angle, ascending);
    qsort(off, (size_t)n, sizeof *off, ascending);
    *turn = angle[n / 2];
    *centre = sqrt(off[n / 2] / fmax(spread, 1e-30));
}

static inline void assert_right(const struct job *j, double degrees, double centres, double focal)
{
    double turn, centre;
    compare(j, &turn, &centre);
    assert_int_equal(j->out.n_placed, j->rig.n_views);
    assert_true(turn < degrees);
    assert_true(centre < centres);
    assert_true(fabs((double)j->out.cams[0].fx / j->rig.focal - 1) < focal);
}

#endif
