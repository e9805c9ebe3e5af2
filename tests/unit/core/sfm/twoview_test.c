/* Relative poses from exact, noisy and wrong matches against the poses that made them; the algebra
 * below at its edges. */
#include "core/base/lin.h"
#include "core/base/rotation.h"
#include "core/sfm/twoview.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

enum { MATCHES = 300 };
static const double PI = 3.14159265358979323846, FOCAL = 400;

static uint32_t state;

static double uniform(double lo, double hi)
{
    state = state * 1664525u + 1013904223u;
    return lo + (hi - lo) * (double)(state >> 8) / 16777216.0;
}

static double normal(void)
{
    double u = uniform(1e-9, 1), v = uniform(0, 2 * PI);
    return sqrt(-2 * log(u)) * cos(v);
}

struct pair {
    double r[9], t[3];
    struct twoview_match m[MATCHES];
};

static struct twoview_match match_of(const struct pair *p, const double x[3], double noise)
{
    double y[3];
    lin_apply(p->r, x, y);
    for (int k = 0; k < 3; k++)
        y[k] += p->t[k];
    struct twoview_match m = {.sigma_a = 0.5 / FOCAL, .sigma_b = 0.5 / FOCAL};
    for (int k = 0; k < 2; k++) {
        m.a[k] = x[k] / x[2] + noise / FOCAL * normal();
        m.b[k] = y[k] / y[2] + noise / FOCAL * normal();
    }
    return m;
}

/* A second view `degrees` around a point 3 m away; points 2 to 5 m away or on a slanted plane. */
static void make(struct pair *p, double degrees, double base, bool plane, double noise,
                 double wrong)
{
    double w[3] = {uniform(-1, 1), uniform(-1, 1), uniform(-0.3, 0.3)};
    double dir[3] = {w[1], -w[0], 0.1};
    lin_normalise(w);
    lin_normalise(dir);
    for (int k = 0; k < 3; k++) {
        w[k] *= degrees * PI / 180;
        p->t[k] = base * dir[k];
    }
    rotation_exp(w, p->r);
    for (int i = 0; i < MATCHES; i++) {
        double u = uniform(-0.5, 0.5), v = uniform(-0.5, 0.5);
        double z = plane ? 3 / (1 - 0.4 * u - 0.3 * v) : uniform(2, 5);
        const double x[3] = {u * z, v * z, z};
        p->m[i] = match_of(p, x, noise);
        for (int k = 0; k < 2 && i < wrong * MATCHES; k++)
            p->m[i].b[k] = uniform(-0.55, 0.55);
    }
}

static double turn_error(const double a[9], const double b[9])
{
    double d[9], w[3];
    lin_product_t(a, b, d);
    rotation_log(d, w);
    return sqrt(lin_dot(w, w)) * 180 / PI;
}

static double direction_error(const double a[3], const double b[3])
{
    double x[3], y[3];
    memcpy(x, a, sizeof x);
    memcpy(y, b, sizeof y);
    lin_normalise(x);
    lin_normalise(y);
    return acos(fmax(-1, fmin(1, lin_dot(x, y)))) * 180 / PI;
}

/* Every solution is an essential matrix of the five matches, and one is the true one. */
static void five_exact_matches(void **unused)
{
    (void)unused;
    struct pair p;
    int exact = 0;
    state = 5;
    for (int trial = 0; trial < 200; trial++) {
        double e[TWOVIEW_SOLUTIONS][9], best = 1, x[9], want[9], len = 0;
        make(&p, uniform(0, 60), uniform(0.1, 2), trial % 4 == 0, 0, 0);
        const struct twoview_match *m[5] = {&p.m[0], &p.m[1], &p.m[2], &p.m[3], &p.m[4]};
        const double t[3] = {p.t[0], p.t[1], p.t[2]};
        const double cross[9] = {0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0};
        lin_product(cross, p.r, want);
        for (int k = 0; k < 9; k++)
            len += want[k] * want[k];
        int n = twoview_five(m, e);
        assert_in_range(n, 1, TWOVIEW_SOLUTIONS);
        for (int s = 0; s < n; s++) {
            double own = 0, dot = 0, eet[9], all[9], worst = 0;
            for (int k = 0; k < 9; k++) {
                own += e[s][k] * e[s][k];
                dot += e[s][k] * want[k];
            }
            best = fmin(best, 1 - fabs(dot) / sqrt(own * len));
            lin_product_t(e[s], e[s], eet);
            lin_product(eet, e[s], all);
            for (int k = 0; k < 9; k++) // 2 E E^T E = trace(E E^T) E
                worst = fmax(worst, fabs(2 * all[k] - own * e[s][k]) / (own * sqrt(own)));
            assert_true(worst < 1e-3);
            for (int i = 0; i < 5; i++) {
                const double a[3] = {m[i]->a[0], m[i]->a[1], 1}, b[3] = {m[i]->b[0], m[i]->b[1], 1};
                lin_apply(e[s], a, x);
                assert_true(fabs(lin_dot(b, x)) < 1e-8 * sqrt(own));
            }
        }
        exact += best < 1e-6;
    }
    assert_true(exact >= 198); // roots that nearly coincide lose digits
}

static void five_matches_that_say_nothing(void **unused)
{
    (void)unused;
    struct twoview_match same = {{0.1, 0.2}, {0.1, 0.2}, 0.001, 0.001};
    const struct twoview_match *m[5] = {&same, &same, &same, &same, &same};
    double e[TWOVIEW_SOLUTIONS][9];
    assert_int_equal(twoview_five(m, e), 0);
}

static void noisy_and_wrong_matches(void **unused)
{
    (void)unused;
    static const double degrees[] = {2.5, 5, 15, 40};
    struct pair p;
    struct twoview v;
    state = 9;
    for (int trial = 0; trial < 24; trial++) {
        double d = degrees[trial % 4], wrong = trial % 3 * 0.2;
        make(&p, d, 3 * 2 * sin(d * PI / 360), false, 0.5, wrong);
        twoview_run(p.m, MATCHES, 3, &v);
        assert_true(v.parallax);
        assert_true(v.inliers > 0.9 * (1 - wrong) * MATCHES);
        assert_true(v.inliers < ((1 - wrong) + 0.15 * wrong) * MATCHES + 1);
        assert_true(turn_error(v.r, p.r) < 0.6);
        assert_true(direction_error(v.t, p.t) < 10);
        assert_float_equal(lin_dot(v.t, v.t), 1, 1e-9);
    }
}

/* A plane has two readings, and which one fits better is chance: both fit, and one is right. */
static void plane(void **unused)
{
    (void)unused;
    struct pair p;
    struct twoview v;
    state = 21;
    int good = 0;
    for (int trial = 0; trial < 20; trial++) {
        make(&p, 15, 0.8, true, 0.5, 0.3);
        twoview_run(p.m, MATCHES, 3, &v);
        assert_true(v.inliers > 0.6 * MATCHES);
        good += turn_error(v.r, p.r) < 1.5;
    }
    assert_true(good >= 5);
}

/* A plane with little in front of it, and no wrong match: some poses fit every line but have half
 * of the points behind the views. The right one has them all in front. */
static void shallow_relief(void **unused)
{
    (void)unused;
    struct pair p;
    struct twoview v;
    state = 23;
    for (int trial = 0; trial < 60; trial++) {
        double angle = 10 + trial % 3 * 10;
        make(&p, angle, 2 * 3 * sin(angle * PI / 360), true, 0.5, 0);
        for (int i = 0; i < MATCHES; i += 8) {
            double u = uniform(-0.5, 0.5), w = uniform(-0.5, 0.5);
            double z = 2.9 / (1 - 0.4 * u - 0.3 * w);
            p.m[i] = match_of(&p, (const double[3]){u * z, w * z, z}, 0.5);
        }
        twoview_run(p.m, MATCHES, 3, &v);
        assert_true(v.parallax);
        assert_true(v.inliers > 0.93 * MATCHES);
    }
}

static void no_parallax(void **unused)
{
    (void)unused;
    struct pair p;
    struct twoview v;
    state = 33;
    for (int trial = 0; trial < 10; trial++) {
        make(&p, trial * 2, 0, false, 0.5, 0.3);
        twoview_run(p.m, MATCHES, 3, &v);
        assert_false(v.parallax);
        assert_true(v.inliers > 0.6 * MATCHES);
        assert_true(turn_error(v.r, p.r) < 0.1);
        assert_true(lin_dot(v.t, v.t) == 0);
        assert_true(twoview_distance(&v, &p.m[MATCHES - 1]) < 25);
    }
}

static void nothing_to_find(void **unused)
{
    (void)unused;
    struct pair p;
    struct twoview v;
    state = 40;
    make(&p, 5, 0.3, false, 0.5, 1);
    twoview_run(p.m, MATCHES, 3, &v);
    assert_true(v.inliers < 0.2 * MATCHES);
    for (int k = 0; k < 9; k++)
        assert_true(isfinite(v.r[k]));
    for (int n = 0; n < TWOVIEW_LEAST; n++) {
        twoview_run(p.m, n, 3, &v);
        assert_int_equal(v.inliers, 0);
        assert_true(v.r[0] == 1 && v.r[4] == 1 && v.r[8] == 1);
    }
    for (int i = 1; i < MATCHES; i++)
        p.m[i] = p.m[0];
    twoview_run(p.m, MATCHES, 3, &v);
    for (int k = 0; k < 9; k++)
        assert_true(isfinite(v.r[k]));
}

static void the_same_seed_is_the_same_result(void **unused)
{
    (void)unused;
    struct pair p;
    struct twoview v, w;
    state = 50;
    make(&p, 5, 0.3, false, 0.5, 0.4);
    twoview_run(p.m, MATCHES, 3, &v);
    twoview_run(p.m, MATCHES, 3, &w);
    assert_memory_equal(v.r, w.r, sizeof v.r);
    assert_memory_equal(v.t, w.t, sizeof v.t);
}

/* ---- algebra ---- */

static void rotations_and_back(void **unused)
{
    (void)unused;
    static const double angles[] = {0, 1e-12, 1e-6, 0.3, 2, 3.1, 3.14159265, 3.1415926535};
    state = 60;
    for (int i = 0; i < 80; i++) {
        double w[3] = {uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)}, r[9], back[3], q[4], s[9];
        lin_normalise(w);
        for (int k = 0; k < 3; k++)
            w[k] *= angles[i % 8];
        rotation_exp(w, r);
        rotation_log(r, back);
        for (int k = 0; k < 3; k++)
            assert_float_equal(back[k], w[k], 1e-7);
        rotation_to_quat(r, q);
        rotation_from_quat(q, s);
        assert_true(q[0] >= 0);
        for (int k = 0; k < 9; k++)
            assert_float_equal(r[k], s[k], 1e-12);
    }
}

static void systems(void **unused)
{
    (void)unused;
    enum { N = 7 };
    double a[N * N], m[N * N], x[N], b[N];
    state = 70;
    for (int i = 0; i < N * N; i++)
        m[i] = uniform(-1, 1);
    for (int i = 0; i < N; i++) {
        x[i] = uniform(-1, 1);
        for (int j = 0; j < N; j++) {
            a[i * N + j] = i == j ? 0.1 : 0;
            for (int k = 0; k < N; k++)
                a[i * N + j] += m[i * N + k] * m[j * N + k];
        }
    }
    for (int i = 0; i < N; i++) {
        b[i] = 0;
        for (int j = 0; j < N; j++)
            b[i] += a[i * N + j] * x[j];
    }
    assert_true(lin_cholesky(a, N));
    lin_solve(a, N, b);
    for (int i = 0; i < N; i++)
        assert_float_equal(b[i], x[i], 1e-10);
    double bad[4] = {1, 0, 2, 1}, nan[1] = {NAN}, inverse[9];
    assert_false(lin_cholesky(bad, 2));
    assert_false(lin_cholesky(nan, 1));
    assert_false(lin_inverse3((const double[9]){1, 2, 3, 2, 4, 6, 3, 6, 9}, inverse));
    assert_true(lin_inverse3((const double[9]){2, 1, 0, 1, 2, 0, 0, 0, 4}, inverse));
    assert_float_equal(inverse[0], 2.0 / 3, 1e-12);
    assert_float_equal(inverse[1], -1.0 / 3, 1e-12);
    assert_float_equal(inverse[8], 0.25, 1e-12);
}

static void axes_across(void **unused)
{
    (void)unused;
    state = 80;
    for (int i = 0; i < 50; i++) {
        double t[3] = {uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)}, b[3], c[3];
        for (int k = 0; k < 3 && i < 3; k++)
            t[k] = k == i;
        lin_normalise(t);
        lin_tangents(t, b, c);
        assert_float_equal(lin_dot(b, b), 1, 1e-12);
        assert_float_equal(lin_dot(c, c), 1, 1e-12);
        assert_float_equal(lin_dot(t, b), 0, 1e-12);
        assert_float_equal(lin_dot(t, c), 0, 1e-12);
        assert_float_equal(lin_dot(b, c), 0, 1e-12);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(five_exact_matches),
        cmocka_unit_test(five_matches_that_say_nothing),
        cmocka_unit_test(noisy_and_wrong_matches),
        cmocka_unit_test(plane),
        cmocka_unit_test(shallow_relief),
        cmocka_unit_test(no_parallax),
        cmocka_unit_test(nothing_to_find),
        cmocka_unit_test(the_same_seed_is_the_same_result),
        cmocka_unit_test(rotations_and_back),
        cmocka_unit_test(systems),
        cmocka_unit_test(axes_across),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
