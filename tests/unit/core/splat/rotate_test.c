/* Gaussians rotated from one world to another: what a camera sees of them must not change. */
#include "core/base/gaussians.h"
#include "core/base/rotation.h"
#include "core/photo/tonemap.h"
#include "core/sfm/similarity.h"
#include "core/splat/raster.h"
#include "core/splat/rotate.h"
#include "core/splat/voxel.h"
#include "tests/unit/random_camera.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { N = 300 };

static void no_rotation_no_change(void **state)
{
    (void)state;
    const float one[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    float m[SH_COEFS_MAX][SH_COEFS_MAX];
    rotate_bands(one, m);
    for (int i = 0; i < SH_COEFS_MAX; i++)
        for (int j = 0; j < SH_COEFS_MAX; j++)
            assert_float_equal(m[i][j], i == j, 1e-6f);
}

/* ---- the same picture from the same camera in both worlds ---- */

struct world {
    struct arena keep, tmp;
    struct kernels kernels;
    struct run r;
    float points[N][3], confidence[N], *features;
};

static void fill(struct world *w, const struct camera *cam)
{
    float r[9], *f = w->features;
    rotation_from_unit(cam->q, r);
    for (int i = 0; i < N; i++) {
        float z = 3 + uniform(), x[3] = {uniform() * z * 0.4f, uniform() * z * 0.4f, z};
        for (int k = 0; k < 3; k++)
            w->points[i][k] = r[k] * (x[0] - cam->t[0]) + r[3 + k] * (x[1] - cam->t[1]) +
                              r[6 + k] * (x[2] - cam->t[2]);
        w->confidence[i] = 0;
        for (int k = 0; k < VOXEL_FEATURES; k++)
            f[k * N + i] = uniform();
        for (int k = 0; k < 3; k++)
            f[(VOXEL_SCALE + k) * N + i] = 100 + 80 * uniform(); // about 0.1
        for (int k = 0; k < 75; k++)
            f[(VOXEL_SH + k) * N + i] *= k % 25 ? 60.0f : 2.0f; // so that bands are seen
    }
}

static void draw(struct world *w, const struct camera *cam, float *px)
{
    struct voxel_input in = {N, w->points[0], w->features, w->confidence};
    struct voxels v;
    struct gaussians g;
    struct raster rs;
    struct render out = {.radiance = px, .alpha = px + 3 * SIZE * SIZE};
    size_t keep = arena_mark(&w->keep);
    assert_int_equal(voxel_merge(&w->r, &in, 1e-6f, &v), OK);
    assert_int_equal(v.n, N);
    assert_int_equal(voxel_adapt(&w->r, &v, &g), OK);
    size_t mark = arena_mark(&w->tmp);
    assert_int_equal(raster_init(&rs, &w->tmp, g.cap, SIZE, SIZE, false), OK);
    struct raster_input ri = {&g, cam, {0.5f, 0.5f, 0.5f}};
    assert_int_equal(raster_run(&w->r, &rs, &ri, &out), OK);
    arena_reset(&w->tmp, mark);
    arena_reset(&w->keep, keep);
}

static void pictures_do_not_change(void **state)
{
    (void)state;
    static struct world w;
    static float before[4 * SIZE * SIZE], after[4 * SIZE * SIZE];
    struct plan plan = plan_begin(1);
    voxel_plan(&plan, N);
    assert_int_equal(arena_init(&w.keep, "keep", plan.keep.peak), OK);
    assert_int_equal(
        arena_init(&w.tmp, "tmp", plan.tmp.peak + raster_plan(N + 16, SIZE, SIZE, false)), OK);
    kernels_init(&w.kernels, 0);
    w.r = (struct run){.k = &w.kernels, .keep = &w.keep, .tmp = &w.tmp};
    w.features = calloc(VOXEL_FEATURES * N, sizeof(float));
    assert_non_null(w.features);
    for (rng = 1; rng < 5; rng++) {
        uint64_t seed = rng;
        struct camera a = random_camera(), b = random_camera();
        if (seed == 2) // half a turn
            b = a, b.q[0] = -a.q[1], b.q[1] = a.q[0], b.q[2] = -a.q[3], b.q[3] = a.q[2];
        float turn[9], ra[9], rb[9];
        fill(&w, &a);
        draw(&w, &a, before);
        similarity_rotation(&a, &b, turn);
        rotation_from_unit(a.q, ra);
        rotation_from_unit(b.q, rb);
        for (int i = 0; i < N; i++) { // the same place before the other camera
            float x[3];
            for (int k = 0; k < 3; k++)
                x[k] = ra[3 * k] * w.points[i][0] + ra[3 * k + 1] * w.points[i][1] +
                       ra[3 * k + 2] * w.points[i][2] + a.t[k] - b.t[k];
            for (int k = 0; k < 3; k++)
                w.points[i][k] = rb[k] * x[0] + rb[3 + k] * x[1] + rb[6 + k] * x[2];
        }
        assert_int_equal(rotate_features(&w.r, turn, w.features, N, (int[2]){0, 100}), OK);
        assert_int_equal(rotate_features(&w.r, turn, w.features, N, (int[2]){100, N - 100}), OK);
        draw(&w, &b, after);
        double worst = 0, sum = 0;
        for (int i = 0; i < 4 * SIZE * SIZE; i++) {
            double d = fabs((double)(after[i] - before[i]));
            worst = d > worst ? d : worst;
            sum += fabs((double)before[i] - 0.5);
        }
        print_message("  largest difference %.1e\n", worst);
        assert_true(sum > 100);
        assert_true(worst < 1e-2); // one splat may cross 1/255
        rng = seed;
    }
    free(w.features);
    arena_free(&w.keep);
    arena_free(&w.tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(no_rotation_no_change),
        cmocka_unit_test(pictures_do_not_change),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
