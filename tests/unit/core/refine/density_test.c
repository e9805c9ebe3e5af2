/* Order, removal and splitting of splats: whole splats move, with their moments and scores. */
#include "core/refine/density.h"

#include "core/base/gaussians.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { CAP = 1024, DEGREE = 1, PLANES = G_SH + 12, ID = G_SH }; // plane ID holds the splat's number

struct world {
    struct arena a;
    struct gaussians g;
    struct density d;
};

static struct world w;

static uint32_t seed;

static float uniform(float lo, float hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (float)(seed >> 8) * 0x1p-24f;
}

/* n opaque splats at random places; everything else tells whose it is. */
static void open_world(int n)
{
    memset(&w, 0, sizeof w);
    seed = 5;
    assert_int_equal(
        arena_init(&w.a, "test", gaussians_need(CAP, DEGREE) + density_plan(CAP, DEGREE)), OK);
    assert_int_equal(gaussians_init(&w.g, &w.a, CAP, DEGREE), OK);
    assert_int_equal(density_init(&w.d, &w.a, &w.g, DEGREE), OK);
    w.g.n = n;
    for (int i = 0; i < n; i++) {
        for (int p = 0; p < PLANES; p++) {
            w.g.plane[p][i] = p < 3 ? uniform(-4, 4) : (float)(p + i);
            w.d.m1[p][i] = (float)(1000 * p + i);
            w.d.m2[p][i] = (float)(2000 * p + i);
        }
        w.g.plane[ID][i] = (float)i;
        w.g.plane[G_LOGIT][i] = 3;
        for (int k = 0; k < 3; k++)
            w.g.plane[G_LOG_SCALE + k][i] = -2;
        w.d.score[i] = (float)(i + 1);
    }
}

/* Place i holds all of one splat of `before`. Returns its number. */
static int check_whole(const struct world *before, int i)
{
    int id = (int)w.g.plane[ID][i];
    assert_in_range(id, 0, before->g.n - 1);
    assert_true(w.d.score[i] == (float)(id + 1));
    for (int p = 0; p < PLANES; p++) {
        assert_true(w.d.m1[p][i] == (float)(1000 * p + id));
        assert_true(w.d.m2[p][i] == (float)(2000 * p + id));
        assert_true(p < G_QUAT || p == ID || p == G_LOGIT || w.g.plane[p][i] == (float)(p + id));
    }
    return id;
}

static double step_length(int i, int j)
{
    double sum = 0;
    for (int k = 0; k < 3; k++)
        sum += pow((double)w.g.plane[k][i] - (double)w.g.plane[k][j], 2);
    return sqrt(sum);
}

static double path_length(void)
{
    double sum = 0;
    for (int i = 1; i < w.g.n; i++)
        sum += step_length(i - 1, i);
    return sum;
}

static void test_sort(void **state)
{
    (void)state;
    static float mu[3][CAP];
    int used[CAP] = {0};
    open_world(1000);
    for (int k = 0; k < 3; k++)
        memcpy(mu[k], w.g.plane[k], sizeof mu[k]);
    double before = path_length();
    struct world start = w;
    density_sort(&w.d);
    assert_int_equal(w.g.n, 1000);
    for (int i = 0; i < w.g.n; i++) {
        int id = check_whole(&start, i);
        used[id]++;
        for (int k = 0; k < 3; k++)
            assert_true(w.g.plane[k][i] == mu[k][id]);
    }
    for (int i = 0; i < 1000; i++)
        assert_int_equal(used[i], 1);
    assert_true(path_length() < 0.3 * before); // random: 5.3 units a step; in order: about 1
    memcpy(mu[0], w.g.plane[ID], sizeof mu[0]);
    density_sort(&w.d); // nothing left to do
    assert_memory_equal(mu[0], w.g.plane[ID], 1000 * sizeof(float));
    arena_free(&w.a);
}

static void test_sort_extremes(void **state)
{
    (void)state;
    open_world(40);
    for (int i = 0; i < 40; i++) // all in one place: the order stays
        for (int k = 0; k < 3; k++)
            w.g.plane[k][i] = 0;
    density_sort(&w.d);
    for (int i = 0; i < 40; i++)
        assert_true(w.g.plane[ID][i] == (float)i);
    for (int k = 0; k < 3; k++) {
        w.g.plane[k][3] = 3e38f;
        w.g.plane[k][4] = -3e38f;
    }
    struct world start = w;
    density_sort(&w.d);
    for (int i = 0; i < 40; i++)
        check_whole(&start, i);
    assert_true(w.g.plane[ID][0] == 4 && w.g.plane[ID][39] == 3);
    arena_free(&w.a);
}

static void test_prune(void **state)
{
    (void)state;
    open_world(200);
    struct world start = w;
    const float logit = -4.59511985f; // logit of 0.01
    int want[200], left = 0;
    for (int i = 0; i < 200; i++) {
        w.g.plane[G_LOGIT][i] = i % 5 == 0 ? logit - 0.001f : logit + 0.001f;
        if (i % 5)
            want[left++] = i;
    }
    assert_int_equal(density_prune(&w.d, 0.01f), 40);
    assert_int_equal(w.g.n, left);
    for (int i = 0; i < left; i++)
        assert_int_equal(check_whole(&start, i), want[i]); // the others keep their order
    assert_int_equal(density_prune(&w.d, 0.01f), 0);
    assert_int_equal(density_prune(&w.d, 0.5f), left);
    assert_int_equal(w.g.n, 0);
    arena_free(&w.a);
}

static void test_prune_not_finite(void **state)
{
    (void)state;
    const float bad[] = {NAN, INFINITY, -INFINITY};
    for (int p = 0; p < PLANES; p++) {
        open_world(6);
        struct world start = w;
        for (int k = 0; k < 3; k++)
            w.g.plane[p][1 + k] = bad[k];
        assert_int_equal(density_prune(&w.d, 0.01f), 3);
        assert_int_equal(w.g.n, 3);
        assert_int_equal(check_whole(&start, 0), 0);
        assert_int_equal(check_whole(&start, 1), 4);
        assert_int_equal(check_whole(&start, 2), 5);
        arena_free(&w.a);
    }
}

/* The matrix of a unit quaternion times e_axis. */
static void turned_axis(const double q[4], int axis, double out[3])
{
    const double r[9] = {1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]),
                         2 * (q[1] * q[3] + q[0] * q[2]),     2 * (q[1] * q[2] + q[0] * q[3]),
                         1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[2] * q[3] - q[0] * q[1]),
                         2 * (q[1] * q[3] - q[0] * q[2]),     2 * (q[2] * q[3] + q[0] * q[1]),
                         1 - 2 * (q[1] * q[1] + q[2] * q[2])};
    for (int k = 0; k < 3; k++)
        out[k] = r[3 * k + axis];
}

/* One splat with the longest axis `axis`, e^0.5 long: halves at -+0.5 s along it, each 0.8 s. */
static void check_halves(int axis)
{
    open_world(3);
    double q[4], n = 0, mu[3], dir[3];
    for (int k = 0; k < 3; k++)
        w.g.plane[G_LOG_SCALE + k][1] = k == axis ? 0.5f : 0.3f - 0.1f * (float)k;
    for (int k = 0; k < 4; k++) {
        w.g.plane[G_QUAT + k][1] = uniform(-3, 3); // any length
        q[k] = (double)w.g.plane[G_QUAT + k][1];
        n += q[k] * q[k];
    }
    for (int k = 0; k < 4; k++)
        q[k] /= sqrt(n);
    for (int k = 0; k < 3; k++)
        mu[k] = (double)w.g.plane[k][1];
    turned_axis(q, axis, dir);
    w.d.score[0] = w.d.score[2] = 0;
    assert_int_equal(density_split(&w.d, 3), 1);
    assert_int_equal(w.g.n, 4);
    for (int k = 0; k < 3; k++) {
        double half = 0.5 * exp(0.5) * dir[k];
        assert_true(fabs((double)w.g.plane[k][1] - (mu[k] - half)) < 2e-6);
        assert_true(fabs((double)w.g.plane[k][3] - (mu[k] + half)) < 2e-6);
        double s = k == axis ? 0.5 + log(0.8) : 0.3 - 0.1 * k;
        assert_true(fabs((double)w.g.plane[G_LOG_SCALE + k][1] - s) < 1e-6);
        assert_true(fabs((double)w.g.plane[G_LOG_SCALE + k][3] - s) < 1e-6);
    }
    for (int p = 0; p < PLANES; p++) { // both halves inherit these
        assert_true(p < G_QUAT || w.g.plane[p][3] == w.g.plane[p][1]);
        assert_true(w.d.m1[p][1] == 0.0f && w.d.m1[p][3] == 0.0f);
        assert_true(w.d.m2[p][3] == (float)(2000 * p + 1) && w.d.m2[p][1] == w.d.m2[p][3]);
        assert_true(w.d.m1[p][2] == (float)(1000 * p + 2)); // neighbours are left alone
    }
    for (int i = 0; i < 4; i++)
        assert_true(w.d.score[i] == 0.0f);
    arena_free(&w.a);
}

static void test_split_halves(void **state)
{
    (void)state;
    for (int axis = 0; axis < 3; axis++)
        check_halves(axis);
}

static void test_split_choice(void **state)
{
    (void)state;
    open_world(100);
    for (int i = 0; i < 100; i++)
        w.d.score[i] = i % 10 == 3 ? 2.0f : 1.0f;
    w.d.score[50] = NAN;
    w.d.score[51] = INFINITY;
    w.d.score[52] = -5;
    w.d.score[53] = 0; // would have been a 2
    w.d.score[99] = 9;
    assert_int_equal(density_split(&w.d, 12), 12);
    assert_int_equal(w.g.n, 112);
    const float want[] = {99, 3, 13, 23, 33, 43, 63, 73, 83, 93, 0, 1}; // ties by number
    for (int i = 0; i < 12; i++)
        assert_true(w.g.plane[ID][100 + i] == want[i]);
    for (int i = 0; i < 112; i++)
        w.d.score[i] = i < 3 ? 1.0f : 0.0f;
    assert_int_equal(density_split(&w.d, 1000), 3); // only those that want to
    assert_int_equal(density_split(&w.d, 1000), 0); // scores have been reset
    assert_int_equal(w.g.n, 115);
    arena_free(&w.a);
}

static void test_split_room(void **state)
{
    (void)state;
    open_world(CAP - 5);
    assert_int_equal(density_split(&w.d, 100), 5);
    assert_int_equal(w.g.n, CAP);
    for (int i = 0; i < CAP; i++)
        w.d.score[i] = 1;
    assert_int_equal(density_split(&w.d, 100), 0);
    assert_int_equal(w.g.n, CAP);
    assert_int_equal(density_split(&w.d, 0), 0);
    arena_free(&w.a);
}

/* The sum of the two halves has the centre of the whole, whatever the splat. */
static void test_split_balance(void **state)
{
    (void)state;
    static float mu[3][CAP];
    open_world(500);
    for (int i = 0; i < 500; i++) {
        for (int k = 0; k < 3; k++)
            w.g.plane[G_LOG_SCALE + k][i] = uniform(-5, 0);
        for (int k = 0; k < 4; k++)
            w.g.plane[G_QUAT + k][i] = i == 0 ? 0.0f : uniform(-1, 1); // one without direction
    }
    for (int k = 0; k < 3; k++)
        memcpy(mu[k], w.g.plane[k], sizeof mu[k]);
    assert_int_equal(density_split(&w.d, 500), 500);
    for (int j = 500; j < 1000; j++) {
        int i = (int)w.g.plane[ID][j];
        for (int k = 0; k < 3; k++) {
            assert_true(isfinite(w.g.plane[k][j]));
            double mean = 0.5 * ((double)w.g.plane[k][i] + (double)w.g.plane[k][j]);
            assert_true(fabs(mean - (double)mu[k][i]) < 1e-6);
        }
        assert_true(i == 0 || step_length(i, j) > 0);
    }
    arena_free(&w.a);
}

static void test_no_splats(void **state)
{
    (void)state;
    open_world(0);
    density_sort(&w.d);
    assert_int_equal(density_prune(&w.d, 0.01f), 0);
    assert_int_equal(density_split(&w.d, 10), 0);
    assert_int_equal(w.g.n, 0);
    arena_free(&w.a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sort),         cmocka_unit_test(test_sort_extremes),
        cmocka_unit_test(test_prune),        cmocka_unit_test(test_prune_not_finite),
        cmocka_unit_test(test_split_halves), cmocka_unit_test(test_split_choice),
        cmocka_unit_test(test_split_room),   cmocka_unit_test(test_split_balance),
        cmocka_unit_test(test_no_splats),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
