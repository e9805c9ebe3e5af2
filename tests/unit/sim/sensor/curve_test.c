/* Every family rises from 0 to 1, whatever its parameter; lookup agrees with formulas; the inverse
 * inverts. */
#include "sim/sensor/curve.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static void check_shape(const struct curve *c)
{
    float last = 0.0f, largest = 0.0f;
    for (int i = -3000; i <= 300; i++) {
        float y = curve_display(c, exp2f((float)i * 0.01f));
        assert_true(isfinite(y) && y >= last && y <= 1.0f);
        largest = fmaxf(largest, y - last);
        last = y;
    }
    assert_true(largest < 0.06f); // continuous: 0.01 stops never jump
    assert_true(curve_display(c, 1.0f) == 1.0f);
    assert_true(curve_display(c, exp2f(-30.0f)) < 0.5f / 255.0f);
}

static void test_shape(void **state)
{
    static const float param[] = {-1e30f, -1.0f, 0.0f, 0.3f, 1.0f,     1.7f,      2.2f,
                                  3.0f,   6.0f,  9.0f, 16.f, INFINITY, -INFINITY, NAN};
    (void)state;
    for (int f = 0; f < CURVE_FAMILIES; f++)
        for (size_t k = 0; k < sizeof param / sizeof param[0]; k++) {
            struct curve c;
            curve_make((enum curve_family)f, param[k], k, &c);
            assert_int_equal(c.family, f);
            check_shape(&c);
        }
}

static void test_extremes(void **state)
{
    (void)state;
    for (int f = 0; f < CURVE_FAMILIES; f++) {
        struct curve c;
        curve_make((enum curve_family)f, 2.0f, 5, &c);
        assert_true(curve_display(&c, 0.0f) == 0.0f && curve_display(&c, -1.0f) == 0.0f);
        assert_true(curve_display(&c, NAN) == 0.0f && curve_display(&c, -INFINITY) == 0.0f);
        assert_true(curve_display(&c, INFINITY) == 1.0f && curve_display(&c, 3e38f) == 1.0f);
        float tiny = curve_display(&c, 1e-44f);
        assert_true(tiny >= 0.0f && tiny < 1e-3f);
        assert_true(curve_exposure(&c, 0.0f) == 0.0f && curve_exposure(&c, NAN) == 0.0f);
        assert_true(curve_exposure(&c, 1.5f) <= 1.0f && curve_exposure(&c, -1.0f) == 0.0f);
    }
}

static void test_formulas(void **state)
{
    struct curve c;
    (void)state;
    for (int i = 1; i < 2000; i++) {
        double x = i / 2000.0;
        curve_make(CURVE_LINEAR, 0.0f, 0, &c);
        assert_true(fabs(curve_display(&c, (float)x) - x) < 1e-4);
        double srgb = x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1.0 / 2.4) - 0.055;
        curve_make(CURVE_SRGB, 0.0f, 0, &c);
        assert_true(fabs(curve_display(&c, (float)x) - srgb) < 1e-4);
        curve_make(CURVE_GAMMA, 2.2f, 0, &c);
        assert_true(fabs(curve_display(&c, (float)x) - pow(x, 1.0 / 2.2)) < 1e-4);
        curve_make(CURVE_LOG, 8.0f, 0, &c);
        assert_true(fabs(curve_display(&c, (float)x) - log2(1.0 + 256.0 * x) / log2(257.0)) < 1e-4);
    }
}

/* 18 % is neither black nor white to any camera. */
static void test_middle_grey(void **state)
{
    (void)state;
    for (int f = CURVE_SRGB; f < CURVE_FAMILIES; f++)
        for (int p = 0; p <= 10; p++) {
            struct curve c;
            static const float lo[] = {0.0f, 0.0f, 1.6f, 0.0f, 8.0f, 3.0f, 0.0f};
            static const float hi[] = {0.0f, 0.0f, 3.0f, 1.0f, 16.0f, 10.0f, 0.5f};
            curve_make((enum curve_family)f, lo[f] + (hi[f] - lo[f]) * 0.1f * (float)p, 3, &c);
            float y = curve_display(&c, 0.18f);
            assert_true(y > 0.25f && y < 0.85f);
        }
}

static void test_inverse(void **state)
{
    (void)state;
    for (uint64_t seed = 0; seed < 64; seed++) {
        struct curve c;
        curve_draw(seed, &c);
        for (int z = 1; z < 255; z++) {
            float y = (float)z / 255.0f, x = curve_exposure(&c, y);
            assert_true(fabsf(curve_display(&c, x) - y) < 1e-3f);
            assert_true(curve_display(&c, x * exp2f(-(c.hi - c.lo) / CURVE_STEPS)) < y);
        }
    }
}

/* The smallest of all exposures with the same display value. */
static void test_plateau(void **state)
{
    struct curve c;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    for (int i = 600; i < 800; i++)
        c.table[i] = c.table[600];
    float x = curve_exposure(&c, c.table[600]);
    assert_true(fabsf(log2f(x) - (c.lo + 600.0f * (c.hi - c.lo) / CURVE_STEPS)) < 0.03f);
}

static void test_usual_parameter(void **state)
{
    static const float usual[CURVE_FAMILIES] = {0.0f, 0.0f, 2.2f, 0.5f, 12.0f, 8.0f, 0.5f};
    struct curve a, b;
    (void)state;
    for (int f = 0; f < CURVE_FAMILIES; f++) {
        curve_make((enum curve_family)f, NAN, 1, &a);
        curve_make((enum curve_family)f, usual[f], 1, &b);
        assert_memory_equal(&a, &b, sizeof a);
    }
}

static void test_draw(void **state)
{
    int seen[CURVE_FAMILIES] = {0};
    struct curve a, b;
    (void)state;
    for (uint64_t seed = 0; seed < 400; seed++) {
        curve_draw(seed, &a);
        curve_draw(seed, &b);
        assert_memory_equal(&a, &b, sizeof a);
        check_shape(&a);
        seen[a.family]++;
    }
    assert_int_equal(seen[CURVE_LINEAR], 0);
    for (int f = CURVE_SRGB; f < CURVE_FAMILIES; f++)
        assert_true(seen[f] > 20);
    curve_make(CURVE_RANDOM, 0.5f, 1, &a);
    curve_make(CURVE_RANDOM, 0.5f, 2, &b);
    assert_true(fabsf(curve_display(&a, 0.1f) - curve_display(&b, 0.1f)) > 1e-3f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_shape),    cmocka_unit_test(test_extremes),
        cmocka_unit_test(test_formulas), cmocka_unit_test(test_middle_grey),
        cmocka_unit_test(test_inverse),  cmocka_unit_test(test_plateau),
        cmocka_unit_test(test_draw),     cmocka_unit_test(test_usual_parameter),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
