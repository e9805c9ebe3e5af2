/* Extremes of voxel fusion and of the Gaussian adapter; the values of ordinary input are those of
 * tests/golden/voxel_test.c. */
#include "core/splat/voxel.h"

#include "core/base/gaussians.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { MAX = 3000 };

struct world {
    struct arena keep, tmp;
    struct run r;
    atomic_bool cancel;
    float points[3 * MAX], confidence[MAX], features[VOXEL_FEATURES * MAX];
    struct voxel_input in;
    struct voxels v;
    struct gaussians g;
};

static struct world w;

static void assert_near(double got, double want, double bound)
{
    assert_true(fabs(got - want) <= bound);
}

static uint32_t next_random(uint32_t *s)
{
    return *s = *s * 1664525u + 1013904223u;
}

static float uniform(uint32_t *s)
{
    return (float)(next_random(s) >> 8) * 0x1p-24f;
}

/* n points at `at`, feature k of point i is k + i, confidence 0; arenas of the planned size. */
static void open_world(int n, const float at[3])
{
    memset(&w, 0, sizeof w);
    struct plan plan = plan_begin(1);
    voxel_plan(&plan, n);
    assert_int_equal(arena_init(&w.keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&w.tmp, "tmp", plan.tmp.peak), OK);
    w.r = (struct run){.keep = &w.keep, .tmp = &w.tmp, .cancel = &w.cancel};
    w.in = (struct voxel_input){n, w.points, w.features, w.confidence};
    for (int i = 0; i < n; i++) {
        memcpy(w.points + 3 * i, at, 3 * sizeof *at);
        for (int k = 0; k < VOXEL_FEATURES; k++)
            w.features[k * n + i] = (float)(k + i);
    }
}

static void close_world(void)
{
    arena_free(&w.keep);
    arena_free(&w.tmp);
}

static void set_point(int i, float x, float y, float z)
{
    w.points[3 * i] = x;
    w.points[3 * i + 1] = y;
    w.points[3 * i + 2] = z;
}

static float feature(int k, int cell)
{
    return w.v.features[k * w.v.cap + cell];
}

static void merge(float cell)
{
    arena_reset(&w.keep, 0);
    assert_int_equal(voxel_merge(&w.r, &w.in, cell, &w.v), OK);
    assert_int_equal(w.tmp.used, 0);
    assert_int_equal(w.v.cap % 16, 0);
    assert_true(w.v.cap >= 16 && w.v.cap >= w.v.n);
    for (int i = 0; i < w.v.n; i++)
        assert_true(w.v.count[i] > 0);
    for (int i = w.v.n; i < 16 || i % 16 != 0; i++) // vectors reach there
        assert_true(w.v.points[2 * w.v.cap + i] == 0.0f && feature(7, i) == 0.0f);
}

static void check_key(int cell, int x, int y, int z)
{
    const int32_t want[3] = {x, y, z};
    assert_memory_equal(w.v.key + 3 * cell, want, sizeof want);
}

static void test_one_point(void **state)
{
    (void)state;
    open_world(1, (float[3]){0.31f, -0.19f, 7.0f});
    merge(0.1f);
    assert_int_equal(w.v.n, 1);
    assert_int_equal(w.v.count[0], 1);
    check_key(0, 3, -2, 70);
    for (int k = 0; k < VOXEL_FEATURES; k++) // weight 1 / (1 + 1e-6)
        assert_near(feature(k, 0), k / (1 + 1e-6), 1e-7 * (1 + k));
    assert_near(w.v.points[2 * w.v.cap], 7 / (1 + 1e-6), 1e-6);
    close_world();
}

static void test_no_points(void **state)
{
    (void)state;
    open_world(0, (float[3]){0});
    merge(0.1f);
    assert_int_equal(w.v.n, 0);
    assert_int_equal(voxel_adapt(&w.r, &w.v, &w.g), OK);
    assert_int_equal(w.g.n, 0);
    close_world();
}

static void test_one_cell(void **state)
{
    (void)state;
    open_world(MAX, (float[3]){0, 0, 0});
    uint32_t s = 1;
    double sum = 1e-6, mean[2] = {0, 0};
    for (int i = 0; i < MAX; i++) {
        set_point(i, uniform(&s) - 0.5f, uniform(&s) - 0.5f, uniform(&s) - 0.5f);
        w.confidence[i] = 8 * uniform(&s) - 4;
    }
    for (int i = 0; i < MAX; i++) {
        double e = exp((double)w.confidence[i] - 4);
        sum += e;
        mean[0] += e * (double)w.points[3 * i + 1];
        mean[1] += e * i;
    }
    merge(1.01f);
    assert_int_equal(w.v.n, 1);
    assert_int_equal(w.v.count[0], MAX);
    assert_near(w.v.points[w.v.cap], mean[0] / sum, 1e-6);
    assert_near(feature(0, 0), mean[1] / sum, 1e-6 * MAX);
    close_world();
}

static void test_order_and_ties(void **state)
{
    (void)state;
    open_world(8, (float[3]){0, 0, 0});
    set_point(0, 2.5f, 0, 0);  // ties to even: 2
    set_point(1, 1.5f, 0, 0);  // 2
    set_point(2, -0.5f, 9, 9); // 0
    set_point(3, -70000, 0, 5000);
    set_point(4, -70000, 0, -5000);
    set_point(5, 2, -1, 0);
    set_point(6, -70000, -1, 9000);
    set_point(7, 3, 0, 0);
    merge(1.0f);
    assert_int_equal(w.v.n, 7);
    check_key(0, -70000, -1, 9000);
    check_key(1, -70000, 0, -5000);
    check_key(2, -70000, 0, 5000);
    check_key(3, 0, 9, 9);
    check_key(4, 2, -1, 0);
    check_key(5, 2, 0, 0);
    check_key(6, 3, 0, 0);
    assert_int_equal(w.v.count[5], 2);
    assert_near(feature(0, 5), 0.5, 1e-5);
    close_world();
}

static void test_sorted(void **state)
{
    (void)state;
    for (int axis = 0; axis < 3; axis++) {
        open_world(MAX, (float[3]){0, 0, 0});
        for (int i = 0; i < MAX; i++)
            w.points[3 * i + axis] = (float)(i * 1007 % MAX * 1001); // 1007 and MAX share no factor
        merge(1.0f);
        assert_int_equal(w.v.n, MAX);
        for (int i = 0; i < MAX; i++)
            assert_int_equal(w.v.key[3 * i + axis], 1001 * i);
        close_world();
    }
}

static void test_far_points(void **state)
{
    (void)state;
    open_world(7, (float[3]){1e9f, 1e9f, 1e9f});
    set_point(1, -1e9f, 0, 0);
    set_point(2, 3e38f, 1e9f, 2e9f);
    set_point(3, -3e38f, 0, 0);
    set_point(4, 0, 0, 0);
    set_point(5, 4.2e6f, 0, 0); // still a key of its own
    set_point(6, -1e9f, 0, 0);
    merge(0.002f);
    assert_int_equal(w.v.n, 4);
    check_key(0, -2147483520, 0, 0);
    check_key(1, 0, 0, 0);
    check_key(3, 2147483520, 2147483520, 2147483520);
    assert_int_equal(w.v.count[0], 3);
    assert_true(w.v.key[6] > 2099000000 && w.v.key[6] < 2101000000);
    for (int i = 0; i < w.v.n; i++)
        for (int k = 0; k < 3; k++)
            assert_true(isfinite(w.v.points[k * w.v.cap + i]));
    merge(1e-38f); // quotients overflow
    assert_int_equal(w.v.n, 4);
    merge(3e38f); // everything but two points in cell 0
    assert_int_equal(w.v.n, 3);
    close_world();
}

static void test_not_finite(void **state)
{
    (void)state;
    open_world(6, (float[3]){0, 0, 0});
    w.points[0] = NAN;
    w.points[3 + 1] = INFINITY;
    w.points[6 + 2] = -INFINITY;
    w.confidence[3] = NAN;
    w.confidence[4] = INFINITY;
    merge(1.0f);
    assert_int_equal(w.v.n, 1);
    assert_int_equal(w.v.count[0], 1);
    assert_near(feature(0, 0), 5, 1e-5);
    w.points[3 * 5] = NAN; // nothing is left
    merge(1.0f);
    assert_int_equal(w.v.n, 0);
    close_world();
}

static void test_confidence(void **state)
{
    (void)state;
    open_world(3, (float[3]){0, 0, 0});
    w.confidence[0] = -1e4f;
    w.confidence[1] = 1e4f;
    w.confidence[2] = 0;
    merge(1.0f);
    assert_near(feature(0, 0), 1, 1e-5);
    w.confidence[0] = w.confidence[1] = w.confidence[2] = -1e4f;
    merge(1.0f);
    assert_near(feature(0, 0), 1, 1e-5); // mean of 0, 1, 2
    w.confidence[0] = -3e38f;            // the difference overflows
    w.confidence[1] = w.confidence[2] = 3e38f;
    merge(1.0f);
    assert_near(feature(0, 0), 1.5, 1e-5);
    close_world();
}

/* Every feature of one point, so that the mean is the feature but for 1e-6. */
static void adapt_features(float logit, float scale, float quat, float sh)
{
    close_world();
    open_world(1, (float[3]){0, 0, 0});
    w.features[VOXEL_LOGIT] = logit;
    for (int k = 0; k < 3; k++)
        w.features[VOXEL_SCALE + k] = scale;
    for (int k = 0; k < 4; k++)
        w.features[VOXEL_QUAT + k] = quat * (float)(k + 1);
    for (int k = 0; k < 75; k++)
        w.features[VOXEL_SH + k] = sh;
    merge(1.0f);
    assert_int_equal(voxel_adapt(&w.r, &w.v, &w.g), OK);
    assert_int_equal(w.g.n, 1);
    assert_int_equal(w.g.cap, w.v.cap);
    assert_int_equal(w.g.degree, 4);
}

static void test_adapt_extremes(void **state)
{
    (void)state;
    const float scale[][2] = {{0, 0.001f * 0.69314718f},
                              {19.99f, 0.01999f},
                              {20.01f, 0.02001f},
                              {299, 0.299f},
                              {301, 0.3f},
                              {3e38f, 0.3f},
                              {-10, 0.001f * 4.53989e-5f},
                              {-50, 1e-12f},
                              {-1e30f, 1e-12f}};
    for (size_t i = 0; i < sizeof scale / sizeof *scale; i++) {
        adapt_features(0, scale[i][0], 1, 1);
        assert_near(w.g.plane[G_LOG_SCALE + 1][0], log((double)scale[i][1]), 3e-5);
    }
    const float size[] = {1e-3f, 1, 1e18f, 8e37f};
    for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
        const double len = sqrt(30.0);
        adapt_features(1e4f, 0, size[i], 1e30f);
        assert_near(w.g.plane[G_QUAT][0], 4 / len, 1e-5);
        for (int k = 0; k < 3; k++)
            assert_near(w.g.plane[G_QUAT + 1 + k][0], (k + 1) / len, 1e-5);
        for (int p = 0; p < gaussians_planes(4); p++)
            assert_true(isfinite(w.g.plane[p][0]));
        assert_near(w.g.plane[G_LOGIT][0], 1e4, 0.1);
    }
    adapt_features(0, 0, 0, 0);
    for (int k = 0; k < 4; k++)
        assert_true(w.g.plane[G_QUAT + k][0] == 0.0f);
    close_world();
}

static void test_adapt_keeps_damage(void **state)
{
    (void)state;
    struct gaussians_report report;
    const float bad[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++) {
        adapt_features(bad[i], 0, 1, 0);
        gaussians_sanitize(&w.g, &report);
        assert_int_equal(report.dropped, 1);
        adapt_features(0, 0, 1, bad[i]);
        gaussians_sanitize(&w.g, &report);
        assert_int_equal(report.dropped, 1);
    }
    adapt_features(0, NAN, 1, 0);
    gaussians_sanitize(&w.g, &report);
    assert_int_equal(report.dropped, 1);
    adapt_features(0, 0, NAN, 0);
    gaussians_sanitize(&w.g, &report);
    assert_int_equal(report.dropped, 1);
    close_world();
}

static void random_points(void)
{
    uint32_t s = 7;
    for (int i = 0; i < MAX; i++) {
        set_point(i, 4 * uniform(&s), 4 * uniform(&s), 4 * uniform(&s) - 2);
        w.confidence[i] = 20 * uniform(&s) - 10;
    }
    for (int i = 0; i < VOXEL_FEATURES * MAX; i++)
        w.features[i] = 6 * uniform(&s) - 3;
}

static void test_threads(void **state)
{
    (void)state;
    static float first[VOXEL_FEATURES * MAX];
    int n = 0;
    for (int threads = 1; threads <= 5; threads += 2) {
        open_world(MAX, (float[3]){0, 0, 0});
        random_points();
        assert_int_equal(pool_open(&w.r.pool, threads), OK);
        merge(0.3f);
        assert_true(w.v.n > 1000 && w.v.n < MAX);
        assert_int_equal(voxel_adapt(&w.r, &w.v, &w.g), OK);
        if (threads == 1)
            n = w.v.n;
        assert_int_equal(w.v.n, n);
        for (int k = 0; k < VOXEL_FEATURES; k++) {
            float *one = first + k * n, *now = w.v.features + k * w.v.cap;
            if (threads == 1)
                memcpy(one, now, (size_t)n * sizeof *now);
            assert_memory_equal(one, now, (size_t)n * sizeof *now);
        }
        pool_close(w.r.pool);
        close_world();
    }
}

static void test_all_cells_apart(void **state)
{
    (void)state;
    open_world(MAX, (float[3]){0, 0, 0});
    random_points();
    merge(1e-5f); // as many cells as points: the plan of `keep` is exact
    assert_true(w.v.n > MAX - 5);
    close_world();
}

static void check_refused(err_t want, float cell)
{
    w.v.n = 1;
    assert_int_equal(voxel_merge(&w.r, &w.in, cell, &w.v), want);
    static const struct voxels none;
    assert_memory_equal(&w.v, &none, sizeof none);
    assert_int_equal(w.tmp.used, 0);
    assert_int_equal(w.keep.used, 0);
}

static void test_errors(void **state)
{
    (void)state;
    open_world(2, (float[3]){0, 0, 0});
    check_refused(ERR_ARG, 0);
    check_refused(ERR_ARG, -1);
    check_refused(ERR_ARG, NAN);
    check_refused(ERR_ARG, INFINITY);
    w.in.n = -1;
    check_refused(ERR_ARG, 1);
    w.in.n = GAUSSIANS_MAX + 1;
    check_refused(ERR_ARG, 1);
    w.in.n = MAX;
    check_refused(ERR_NOMEM, 1);
    w.in.n = 2;
    w.points[0] = 9; // two cells
    size_t size = w.keep.size;
    struct plan two = plan_begin(1), wrong = plan_begin(1);
    voxel_plan(&two, 2);
    w.keep.size = two.keep.peak - 1;
    check_refused(ERR_NOMEM, 1);
    w.keep.size = size;
    atomic_store(&w.cancel, true);
    check_refused(ERR_CANCELLED, 1);
    atomic_store(&w.cancel, false);
    merge(1);
    atomic_store(&w.cancel, true);
    assert_int_equal(voxel_adapt(&w.r, &w.v, &w.g), ERR_CANCELLED);
    assert_int_equal(w.g.n, 0);
    voxel_plan(&wrong, -1);
    assert_true(wrong.keep.peak == SIZE_MAX && wrong.tmp.peak == SIZE_MAX);
    close_world();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_one_point),      cmocka_unit_test(test_no_points),
        cmocka_unit_test(test_one_cell),       cmocka_unit_test(test_order_and_ties),
        cmocka_unit_test(test_sorted),         cmocka_unit_test(test_far_points),
        cmocka_unit_test(test_not_finite),     cmocka_unit_test(test_confidence),
        cmocka_unit_test(test_adapt_extremes), cmocka_unit_test(test_adapt_keeps_damage),
        cmocka_unit_test(test_threads),        cmocka_unit_test(test_all_cells_apart),
        cmocka_unit_test(test_errors),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
