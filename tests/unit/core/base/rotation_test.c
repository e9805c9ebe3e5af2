/* The three forms of a rotation tell the same, at every angle. */
#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/splitmix.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static uint64_t state_of_rng;

static double uniform(void)
{
    return (double)(splitmix_next(&state_of_rng) >> 11) * 0x1p-52 - 1;
}

static void assert_near(const double *a, const double *b, int n, double most)
{
    for (int i = 0; i < n; i++)
        assert_true(fabs(a[i] - b[i]) <= most);
}

static void forms_agree(void **state)
{
    (void)state;
    for (int i = 0; i < 2000; i++) {
        double w[3] = {uniform(), uniform(), uniform()}, r[9], q[4], back[9], again[3];
        lin_normalise(w);
        const double angle = i % 4 == 0 ? 1e-7 * uniform() : i % 4 == 1 ? NUM_PI - 1e-6 : uniform();
        for (int k = 0; k < 3; k++)
            w[k] *= fabs(angle);
        rotation_exp(w, r);
        rotation_to_quat(r, q);
        assert_true(q[0] >= 0);
        for (int k = 0; k < 4; k++)
            q[k] *= 3; // any length
        rotation_from_quat(q, back);
        assert_near(r, back, 9, 1e-12);
        rotation_log(r, again);
        assert_near(w, again, 3, 1e-8);
    }
}

static void a_product_turns_twice(void **state)
{
    (void)state;
    for (int i = 0; i < 100; i++) {
        const double v[3] = {uniform(), uniform(), uniform()}, w[3] = {2 * uniform(), uniform(), 1};
        double a[9], b[9], ab[9], qa[4], qb[4], q[4], r[9];
        float unit[4], single[9];
        rotation_exp(v, a);
        rotation_exp(w, b);
        lin_product(a, b, ab);
        rotation_to_quat(a, qa);
        rotation_to_quat(b, qb);
        rotation_multiply(qa, qb, q);
        rotation_from_quat(q, r);
        assert_near(ab, r, 9, 1e-12);
        for (int k = 0; k < 4; k++)
            unit[k] = (float)q[k];
        rotation_from_unit(unit, single);
        for (int k = 0; k < 9; k++)
            assert_true(fabs((double)single[k] - r[k]) < 1e-6);
    }
}

static void no_quaternion_is_the_identity(void **state)
{
    (void)state;
    const double zero[4] = {0}, one[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double r[9];
    rotation_from_quat(zero, r);
    assert_near(r, one, 9, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(forms_agree),
        cmocka_unit_test(a_product_turns_twice),
        cmocka_unit_test(no_quaternion_is_the_identity),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
