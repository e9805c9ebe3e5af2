/* Gaussians taken from one world to another: what a camera sees of them must not change. */
#include "core/net/tonemap.h"
#include "core/splat/gaussians.h"
#include "core/splat/raster.h"
#include "core/splat/turn.h"
#include "core/splat/voxel.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { N = 300, SIZE = 48 };

static uint64_t rng;

static float uniform(void)
{
    rng = rng * 6364136223846793005ull + 1442695040888963407ull;
    return (float)(rng >> 40) * 0x1p-23f - 1.0f;
}

static struct camera random_camera(void)
{
    struct camera c = {SIZE, SIZE, 50, 50, SIZE / 2, SIZE / 2, {0}, {uniform(), uniform(), 0}};
    float len = 0;
    for (int k = 0; k < 4; k++) {
        c.q[k] = uniform();
        len += c.q[k] * c.q[k];
    }
    for (int k = 0; k < 4; k++)
        c.q[k] /= sqrtf(len);
    return c;
}

static void scale_of_worlds(void **state)
{
    (void)state;
    struct arena tmp;
    struct camera a[6], b[6];
    float s;
    assert_int_equal(arena_init(&tmp, "tmp", turn_plan(6)), OK);
    struct run r = {.tmp = &tmp};
    rng = 3;
    for (int i = 0; i < 6; i++) {
        a[i] = b[i] = random_camera();
        for (int k = 0; k < 3; k++)
            b[i].t[k] *= 2.5f;
    }
    assert_int_equal(turn_scale(&r, a, b, 6, &s), OK);
    assert_float_equal(s, 2.5f, 1e-5f);
    b[5].t[0] += 100; // one camera is wrong
    assert_int_equal(turn_scale(&r, a, b, 6, &s), OK);
    assert_true(s > 1.5f && s < 4.5f);
    for (int i = 0; i < 6; i++) { // they only turned
        memset(b[i].t, 0, sizeof b[i].t);
        memcpy(b[i].q, a[i].q, sizeof b[i].q);
    }
    assert_int_equal(turn_scale(&r, a, b, 6, &s), OK);
    assert_float_equal(s, 1, 0);
    assert_int_equal(turn_scale(&r, b, a, 6, &s), OK);
    assert_float_equal(s, 1, 0);
    a[0].t[0] = NAN;
    assert_int_equal(turn_scale(&r, b, a, 2, &s), OK);
    assert_float_equal(s, 1, 0);
    assert_int_equal(turn_scale(&r, a, b, 1, &s), OK);
    assert_float_equal(s, 1, 0);
    arena_free(&tmp);
}

/* One world is the other turned, moved and 2.5 times as large. */
static void a_world_is_found_again(void **state)
{
    (void)state;
    struct arena tmp;
    struct camera a[5], b[5], c;
    struct turn_world w = {2.5, {0.5, -0.5, 0.5, 0.5}, {1, -2, 3}}, found;
    double x[3], y[3];
    assert_int_equal(arena_init(&tmp, "tmp", turn_plan(5)), OK);
    struct run r = {.tmp = &tmp};
    rng = 9;
    for (int i = 0; i < 5; i++) {
        a[i] = random_camera();
        b[i] = turn_camera(&w, &a[i]);
        for (int k = 0; k < 4 && i % 2; k++)
            b[i].q[k] = -b[i].q[k]; // the same rotation
    }
    turn_centre(&a[0], x);
    turn_centre(&b[0], y); // (x, y, z) -> (-y, z, -x) is this quaternion's rotation
    assert_float_equal((float)y[0], (float)(1 + 2.5 * -x[1]), 1e-4f);
    assert_float_equal((float)y[1], (float)(-2 + 2.5 * x[2]), 1e-4f);
    assert_float_equal((float)y[2], (float)(3 + 2.5 * -x[0]), 1e-4f);
    assert_int_equal(turn_fit(&r, a, b, 5, &found), OK);
    assert_float_equal((float)found.scale, 2.5f, 1e-5f);
    for (int i = 0; i < 5; i++) {
        float p[9], q[9];
        c = turn_camera(&found, &a[i]);
        raster_rotation(c.q, p);
        raster_rotation(b[i].q, q);
        for (int k = 0; k < 9; k++)
            assert_float_equal(p[k], q[k], 1e-5f);
        for (int k = 0; k < 3; k++)
            assert_float_equal(c.t[k], b[i].t[k], 1e-4f);
    }
    arena_free(&tmp);
}

static void no_rotation_no_change(void **state)
{
    (void)state;
    const float one[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    float m[SH_COEFS_MAX][SH_COEFS_MAX];
    turn_bands(one, m);
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
    raster_rotation(cam->q, r);
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
    assert_int_equal(arena_init(&w.keep, "keep", voxel_keep(N)), OK);
    assert_int_equal(
        arena_init(&w.tmp, "tmp", voxel_plan(N) + raster_plan(N + 16, SIZE, SIZE, false)), OK);
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
        turn_rotation(&a, &b, turn);
        raster_rotation(a.q, ra);
        raster_rotation(b.q, rb);
        for (int i = 0; i < N; i++) { // the same place before the other camera
            float x[3];
            for (int k = 0; k < 3; k++)
                x[k] = ra[3 * k] * w.points[i][0] + ra[3 * k + 1] * w.points[i][1] +
                       ra[3 * k + 2] * w.points[i][2] + a.t[k] - b.t[k];
            for (int k = 0; k < 3; k++)
                w.points[i][k] = rb[k] * x[0] + rb[3 + k] * x[1] + rb[6 + k] * x[2];
        }
        assert_int_equal(turn_features(&w.r, turn, w.features, N, (int[2]){0, 100}), OK);
        assert_int_equal(turn_features(&w.r, turn, w.features, N, (int[2]){100, N - 100}), OK);
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
        cmocka_unit_test(scale_of_worlds),
        cmocka_unit_test(a_world_is_found_again),
        cmocka_unit_test(no_rotation_no_change),
        cmocka_unit_test(pictures_do_not_change),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
