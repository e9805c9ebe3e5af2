/* All 65536 halves, and around each of them the floats where rounding changes its mind. The
 * reference is written with doubles and nextafter, not with bits. */
#include "core/base/half.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static double reference(uint16_t h)
{
    int exponent = h >> 10 & 31, mantissa = h & 0x3ff;
    double v = exponent == 0 ? ldexp(mantissa, -24) : ldexp(1024 + mantissa, exponent - 25);
    return h & 0x8000 ? -v : v;
}

static int is_nan_half(uint16_t h)
{
    return (h & 0x7fff) > 0x7c00;
}

static void every_half_survives(void **state)
{
    (void)state;
    for (unsigned u = 0; u < 65536; u++) {
        uint16_t h = (uint16_t)u;
        float f = half_to_float(h);
        if (is_nan_half(h)) {
            assert_true(isnan(f));
            assert_int_equal(half_from_float(f), h | 0x200);
            assert_int_equal(half_from_float_sat(f), h | 0x200);
            continue;
        }
        if ((h & 0x7fff) == 0x7c00) {
            assert_true(isinf(f) && (f < 0) == (h >> 15));
            assert_int_equal(half_from_float_sat(f), (h & 0x8000) | 0x7bff);
        } else {
            assert_true((double)f == reference(h));
            assert_int_equal(half_from_float_sat(f), h);
        }
        assert_int_equal(signbit(f) != 0, h >> 15);
        assert_int_equal(half_from_float(f), h);
    }
}

/* Between neighbours a < b the float at the middle goes to the even one, its own neighbours to the
 * nearer. */
static void middles_go_to_even(void **state)
{
    (void)state;
    for (unsigned u = 0; u < 0x7c00; u++) {
        uint16_t a = (uint16_t)u, b = (uint16_t)(u + 1);
        double top = b == 0x7c00 ? 65536.0 : reference(b);
        float middle = (float)((reference(a) + top) / 2); // exact: one bit more than a half has
        for (unsigned sign = 0; sign <= 0x8000; sign += 0x8000) {
            float s = sign ? -1.0f : 1.0f;
            assert_int_equal(half_from_float(s * middle), sign | (a & 1 ? b : a));
            assert_int_equal(half_from_float(s * nextafterf(middle, 0.0f)), sign | a);
            assert_int_equal(half_from_float(s * nextafterf(middle, INFINITY)), sign | b);
        }
    }
}

static void ends_of_the_range(void **state)
{
    (void)state;
    assert_int_equal(half_from_float(0x1p-149f), 0);
    assert_int_equal(half_from_float(-0x1p-149f), 0x8000);
    assert_int_equal(half_from_float(1e30f), 0x7c00);
    assert_int_equal(half_from_float(65519.99f), 0x7bff);
    assert_int_equal(half_from_float(65520.0f), 0x7c00);
    assert_int_equal(half_from_float_sat(-1e30f), 0xfbff);
    assert_true(half_to_float(0x7bff) == HALF_MAX);
}

static void arrays(void **state)
{
    (void)state;
    const float in[6] = {1.0f, -INFINITY, 70000.0f, 65519.0f, NAN, -0.0f};
    const uint16_t want[6] = {0x3c00, 0xfbff, 0x7bff, 0x7bff, 0x7e00, 0x8000};
    uint16_t h[6];
    float back[6];
    assert_int_equal(half_from_floats_sat(in, 6, h), 2);
    half_to_floats(h, 6, back);
    for (int i = 0; i < 6; i++) {
        assert_int_equal(h[i], want[i]);
        assert_true(isnan(in[i]) ? isnan(back[i]) : back[i] == half_to_float(want[i]));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_half_survives),
        cmocka_unit_test(middles_go_to_even),
        cmocka_unit_test(ends_of_the_range),
        cmocka_unit_test(arrays),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
