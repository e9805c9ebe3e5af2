/* The noise estimate on pictures whose noise is known. */
#include "core/photo/noise.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

enum { S = 128, V = 2 };

static uint8_t rgb[V * S * S * 3];
static uint32_t seed;

static double normal(void) // sum of 12 uniform numbers
{
    double sum = -6;
    for (int i = 0; i < 12; i++) {
        seed = seed * 1664525u + 1013904223u;
        sum += (double)(seed >> 8) / 16777216.0;
    }
    return sum;
}

static float estimate(double deviation)
{
    struct arena tmp;
    struct views v = {.n = V, .size = S, .extent = squares(V, S), .rgb = rgb};
    struct run r = {.tmp = &tmp};
    float db;
    seed = 1;
    for (int i = 0; i < V * S * S * 3; i++) {
        int x = i / 3 % S, y = i / 3 / S % S;
        double clean =
            128 + 60 * sin(x * 0.1) * cos(y * 0.07) + (x / 16 % 2 ? 20 : 0); // with edges
        rgb[i] = (uint8_t)fmin(fmax(clean + deviation * normal() + 0.5, 0), 255);
    }
    assert_int_equal(arena_init(&tmp, "test", 4096), OK);
    assert_int_equal(noise_run(&r, &v, &db), OK);
    arena_free(&tmp);
    return db;
}

static void test_known_noise(void **state)
{
    (void)state;
    for (double d = 2; d < 20; d *= 2) {
        double want = -20 * log10(d / 255);
        float got = estimate(d);
        print_message("  noise of %.0f codes: %.2f dB, estimated %.2f dB\n", d, want, (double)got);
        assert_true(fabs((double)got - want) < 1);
    }
    assert_true(estimate(0) > 45);
}

static void test_extremes(void **state)
{
    (void)state;
    struct arena tmp;
    struct views v = {.n = V, .size = S, .extent = squares(V, S), .rgb = rgb};
    struct run r = {.tmp = &tmp};
    float db;
    assert_int_equal(arena_init(&tmp, "test", 4096), OK);
    for (int value = 0; value < 256; value += 255) { // nothing but saturation says nothing
        memset(rgb, value, sizeof rgb);
        assert_int_equal(noise_run(&r, &v, &db), OK);
        assert_float_equal(db, 100, 1e-3);
    }
    v.size = 2; // no pixel has all neighbours
    assert_int_equal(noise_run(&r, &v, &db), OK);
    assert_float_equal(db, 100, 1e-3);
    arena_free(&tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_known_noise),
                                       cmocka_unit_test(test_extremes)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
