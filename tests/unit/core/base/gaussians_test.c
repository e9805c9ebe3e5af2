#include "core/base/gaussians.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct arena arena;

static struct gaussians make(int cap, int degree)
{
    struct gaussians g;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", gaussians_need(cap, degree)), OK);
    assert_int_equal(gaussians_init(&g, &arena, cap, degree), OK);
    return g;
}

/* n splats in range, every value different. */
static struct gaussians make_filled(int n, int degree)
{
    struct gaussians g = make(n, degree);
    for (int p = 0; p < gaussians_planes(degree); p++)
        for (int i = 0; i < n; i++)
            g.plane[p][i] = (float)(i + 1) + (float)p / 128;
    g.n = n;
    return g;
}

static void need_is_exact_for_every_size(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        for (int cap = 0; cap < 70; cap += 17) {
            struct gaussians g = make(cap, degree);
            assert_true(arena.used == gaussians_need(cap, degree) && arena.used == arena.peak);
            assert_true(g.cap >= 16 && g.cap >= cap && g.cap % 16 == 0 && g.n == 0);
            assert_true(g.plane[gaussians_planes(degree) - 1][g.cap - 1] == 0);
            if (degree < SH_DEGREE_MAX)
                assert_null(g.plane[gaussians_planes(degree)]);
        }
    }
}

static void wrong_sizes_are_refused(void **state)
{
    (void)state;
    static const int wrong[][2] = {
        {-1, 0}, {1, -1}, {1, SH_DEGREE_MAX + 1}, {GAUSSIANS_MAX + 1, 0}};
    struct gaussians g;
    make(16, 0);
    for (int k = 0; k < 4; k++) {
        assert_int_equal(gaussians_init(&g, &arena, wrong[k][0], wrong[k][1]), ERR_ARG);
        assert_true(gaussians_need(wrong[k][0], wrong[k][1]) == SIZE_MAX);
    }
    size_t used = arena.used;
    assert_int_equal(gaussians_init(&g, &arena, 16, 0), ERR_NOMEM); // full: nothing may stay taken
    assert_int_equal(arena.used, used);
    assert_null(g.plane[0]);
}

static void splats_in_range_keep_every_bit(void **state)
{
    (void)state;
    struct gaussians g = make_filled(9, 2);
    struct gaussians_report report;
    gaussians_sanitize(&g, &report);
    assert_int_equal(report.dropped, 0);
    assert_int_equal(report.repaired, 0);
    assert_int_equal(g.n, 9);
    for (int p = 0; p < gaussians_planes(2); p++)
        for (int i = 0; i < 9; i++)
            assert_true(g.plane[p][i] == (float)(i + 1) + (float)p / 128);
}

static void a_bad_value_in_any_plane_drops_its_splat(void **state)
{
    (void)state;
    for (int p = 0; p < gaussians_planes(1); p++) {
        struct gaussians g = make_filled(5, 1);
        struct gaussians_report report;
        g.plane[p][1] = p % 2 ? NAN : INFINITY;
        g.plane[p][4] = -INFINITY;
        gaussians_sanitize(&g, &report);
        assert_int_equal(report.dropped, 2);
        assert_int_equal(g.n, 3);
        assert_true(g.plane[G_MU][0] == 1 && g.plane[G_MU][1] == 3 && g.plane[G_MU][2] == 4);
    }
}

static void values_out_of_range_are_brought_back(void **state)
{
    (void)state;
    struct gaussians g = make_filled(4, 0);
    struct gaussians_report report;
    g.plane[G_LOG_SCALE + 1][0] = -100;
    g.plane[G_LOG_SCALE + 2][0] = 100;
    g.plane[G_LOGIT][1] = 31;
    for (int k = 0; k < 4; k++) {
        g.plane[G_QUAT + k][2] = 0;
        g.plane[G_QUAT + k][3] = -3e37f; // the sum of squares does not fit a float
    }
    gaussians_sanitize(&g, &report);
    assert_int_equal(report.dropped, 0);
    assert_int_equal(report.repaired, 4);
    assert_true(g.plane[G_LOG_SCALE + 1][0] == GAUSSIANS_LOG_SCALE_MIN);
    assert_true(g.plane[G_LOG_SCALE + 2][0] == GAUSSIANS_LOG_SCALE_MAX);
    assert_true(g.plane[G_LOGIT][1] == GAUSSIANS_LOGIT_MAX);
    assert_true(g.plane[G_QUAT][2] == 1 && g.plane[G_QUAT + 1][2] == 0);
    assert_true(fabsf(g.plane[G_QUAT + 3][3] + 0.5f) < 1e-6f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(need_is_exact_for_every_size),
        cmocka_unit_test(wrong_sizes_are_refused),
        cmocka_unit_test(splats_in_range_keep_every_bit),
        cmocka_unit_test(a_bad_value_in_any_plane_drops_its_splat),
        cmocka_unit_test(values_out_of_range_are_brought_back),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    return failed;
}
