/* Motions of cameras against the exponential map in double, and the gradient by the twist against
 * finite differences of a function of the pose. */
#include "core/sfm/pose.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

static uint32_t seed = 20240611;

static double uniform(double lo, double hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (double)(seed >> 8) / 16777216.0;
}

static struct camera random_camera(void)
{
    struct camera c = {640, 480, 500, 510, 320, 240, {0}, {0}};
    double q[4], n = 0;
    for (int k = 0; k < 4; k++) {
        q[k] = uniform(-1, 1);
        n += q[k] * q[k];
    }
    for (int k = 0; k < 4; k++)
        c.q[k] = (float)(q[k] / sqrt(n));
    for (int k = 0; k < 3; k++)
        c.t[k] = (float)uniform(-3, 3);
    return c;
}

struct pose {
    double x[12]; // R row-major, t
};

static struct pose pose_of(const struct camera *c)
{
    struct pose p;
    const double w = (double)c->q[0], x = (double)c->q[1], y = (double)c->q[2], z = (double)c->q[3];
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(p.x, r, sizeof r);
    for (int k = 0; k < 3; k++)
        p.x[9 + k] = (double)c->t[k];
    return p;
}

/* exp of the rotation vector w: Rodrigues' formula. */
static void exp_map(const double w[3], double e[9])
{
    const double k[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
    double a2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], a = sqrt(a2);
    double s = a > 1e-6 ? sin(a) / a : 1, c = a > 1e-6 ? (1 - cos(a)) / a2 : 0.5;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double kk = 0;
            for (int l = 0; l < 3; l++)
                kk += k[3 * i + l] * k[3 * l + j];
            e[3 * i + j] = (i == j) + s * k[3 * i + j] + c * kk;
        }
}

static struct pose twisted(const struct pose *p, const double twist[6])
{
    struct pose o;
    double e[9];
    exp_map(twist, e);
    for (int i = 0; i < 3; i++) {
        o.x[9 + i] = twist[3 + i];
        for (int l = 0; l < 3; l++)
            o.x[9 + i] += e[3 * i + l] * p->x[9 + l];
        for (int j = 0; j < 3; j++) {
            o.x[3 * i + j] = 0;
            for (int l = 0; l < 3; l++)
                o.x[3 * i + j] += e[3 * i + l] * p->x[3 * l + j];
        }
    }
    return o;
}

/* Some function of all entries of the pose, and its gradient by them. */
static double value_of(const struct pose *p, const double coef[12], double grad[12])
{
    double sum = 0;
    for (int i = 0; i < 12; i++) {
        double x = p->x[i];
        sum += coef[i] * sin(x + 0.7 * i) + 0.3 * coef[11 - i] * x * x;
        grad[i] = coef[i] * cos(x + 0.7 * i) + 0.6 * coef[11 - i] * x;
    }
    return sum;
}

static void test_gradient(void **state)
{
    (void)state;
    for (int round = 0; round < 50; round++) {
        struct camera c = random_camera();
        struct pose p = pose_of(&c);
        double coef[12], exact[12], unused[12];
        float grad[POSE_GRAD], got[6];
        for (int i = 0; i < 12; i++)
            coef[i] = uniform(-2, 2);
        value_of(&p, coef, exact);
        for (int i = 0; i < POSE_GRAD; i++)
            grad[i] = i < 12 ? (float)exact[i] : 1e30f; // the lens is no part of the twist
        pose_twist_grad(&c, grad, got);
        for (int i = 0; i < 6; i++) {
            double twist[6] = {0}, h = 1e-5;
            twist[i] = h;
            struct pose plus = twisted(&p, twist);
            twist[i] = -h;
            struct pose minus = twisted(&p, twist);
            double want =
                (value_of(&plus, coef, unused) - value_of(&minus, coef, unused)) / (2 * h);
            assert_true(fabs((double)got[i] - want) < 1e-5 * (10 + fabs(want)));
        }
    }
}

/* Moves by `twist` and compares with the double-precision motion. */
static void check_move(const struct camera *c, const float twist[6])
{
    struct camera moved = *c;
    double w[6], n = 0;
    for (int k = 0; k < 6; k++)
        w[k] = (double)twist[k];
    struct pose start = pose_of(c), want = twisted(&start, w);
    pose_move(&moved, twist);
    struct pose got = pose_of(&moved);
    for (int k = 0; k < 4; k++)
        n += (double)moved.q[k] * (double)moved.q[k];
    assert_true(fabs(n - 1) < 5e-7);
    for (int k = 0; k < 12; k++)
        assert_true(fabs(got.x[k] - want.x[k]) < (k < 9 ? 2e-6 : 5e-6));
    memcpy(moved.q, c->q, sizeof moved.q);
    memcpy(moved.t, c->t, sizeof moved.t);
    assert_memory_equal(&moved, c, sizeof moved); // the lens stays
}

static void test_move(void **state)
{
    (void)state;
    const double pi = 3.14159265358979323846;
    const double angle[] = {0, 1e-30,     1e-12, 1e-7,      1e-3,   0.5,
                            2, pi - 1e-6, pi,    pi + 1e-6, 2 * pi, 9};
    for (size_t a = 0; a < sizeof angle / sizeof *angle; a++)
        for (int round = 0; round < 10; round++) {
            struct camera c = random_camera();
            double axis[3], n = 0;
            float twist[6];
            for (int k = 0; k < 3; k++) {
                axis[k] = uniform(-1, 1);
                n += axis[k] * axis[k];
            }
            for (int k = 0; k < 3; k++) {
                twist[k] = (float)(angle[a] * axis[k] / sqrt(n));
                twist[3 + k] = (float)uniform(-1, 1);
            }
            check_move(&c, twist);
        }
}

static void test_half_turns(void **state)
{
    (void)state;
    for (int axis = 0; axis < 3; axis++) {
        struct camera c = random_camera(), start = c;
        float twist[6] = {0};
        twist[axis] = 3.14159265f;
        check_move(&c, twist);
        pose_move(&c, twist);
        pose_move(&c, twist); // a whole turn
        double dot = 0;
        for (int k = 0; k < 4; k++)
            dot += (double)c.q[k] * (double)start.q[k];
        assert_true(fabs(fabs(dot) - 1) < 1e-6);
        for (int k = 0; k < 3; k++)
            assert_true(fabs((double)(c.t[k] - start.t[k])) < 5e-6);
    }
}

static void test_many_moves(void **state)
{
    (void)state;
    struct camera c = random_camera();
    for (int i = 0; i < 20000; i++) {
        float twist[6];
        for (int k = 0; k < 6; k++)
            twist[k] = (float)uniform(-0.01, 0.01);
        pose_move(&c, twist);
    }
    double n = 0;
    for (int k = 0; k < 4; k++)
        n += (double)c.q[k] * (double)c.q[k];
    assert_true(fabs(n - 1) < 5e-7);
}

static void test_not_finite(void **state)
{
    (void)state;
    const float bad[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 6; i++)
        for (int b = 0; b < 3; b++) {
            struct camera c = random_camera(), start = c;
            float twist[6] = {0.1f, 0.1f, 0.1f, 0.1f, 0.1f, 0.1f};
            twist[i] = bad[b];
            pose_move(&c, twist);
            assert_memory_equal(&c, &start, sizeof c);
        }
    struct camera c = random_camera(), start = c;
    pose_move(&c, (const float[6]){INFINITY, -INFINITY, 0, 0, 0, 0});
    assert_memory_equal(&c, &start, sizeof c);
}

static void test_scaled(void **state)
{
    (void)state;
    struct camera c = random_camera(), s = pose_scaled(&c, 320, 120);
    assert_true(s.w == 320 && s.h == 120);
    assert_true(s.fx == 250 && s.cx == 160 && s.fy == 127.5f && s.cy == 60);
    assert_memory_equal(s.q, c.q, sizeof c.q);
    assert_memory_equal(s.t, c.t, sizeof c.t);
    assert_true(c.w == 640 && c.fx == 500);
}

/* A wall 4 before a row of cameras; what is far behind it, a fifth of all, and the sky. */
static void test_extent(void **state)
{
    enum { N = 500 };
    static float plane[3][N];
    struct gaussians g = {.n = N};
    struct camera cams[3];
    (void)state;
    for (int v = 0; v < 3; v++)
        cams[v] = (struct camera){640, 480, 500, 500, 320, 240, {1, 0, 0, 0}, {1 - (float)v, 0, 0}};
    for (int k = 0; k < 3; k++)
        g.plane[G_MU + k] = plane[k];
    for (int i = 0; i < N; i++) {
        plane[0][i] = (float)uniform(-2, 2);
        plane[1][i] = (float)uniform(-2, 2);
        plane[2][i] = i % 5 ? 4 : i % 10 ? 60 : 290;
    }
    assert_float_equal(pose_extent(&g, cams, 3), 4.08f, 0.05f);
    g.n = 0;
    assert_float_equal(pose_extent(&g, cams, 3), 2.0f / 3, 1e-5f);
    assert_true(pose_extent(&g, cams + 1, 1) == 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gradient),   cmocka_unit_test(test_move),
        cmocka_unit_test(test_half_turns), cmocka_unit_test(test_many_moves),
        cmocka_unit_test(test_not_finite), cmocka_unit_test(test_scaled),
        cmocka_unit_test(test_extent),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
