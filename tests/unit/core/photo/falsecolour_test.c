#include "core/photo/falsecolour.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void colour_is(float stops, int r, int g, int b, int bound)
{
    uint8_t rgb[3];
    falsecolour_of(stops, rgb);
    if (abs(rgb[0] - r) > bound || abs(rgb[1] - g) > bound || abs(rgb[2] - b) > bound)
        fail_msg("%g stops: %d %d %d, wanted %d %d %d", (double)stops, rgb[0], rgb[1], rgb[2], r, g,
                 b);
}

/* The published table at 1/4, 1/2 and 3/4, which the polynomial follows to within 8 %. */
static void follows_the_table(void **state)
{
    (void)state;
    colour_is(-4, 40, 188, 235, 20);
    colour_is(0, 164, 252, 60, 20);
    colour_is(4, 251, 126, 33, 20);
}

static void ends_and_beyond(void **state)
{
    (void)state;
    uint8_t low[3], high[3];
    falsecolour_of(-8, low);
    falsecolour_of(8, high);
    colour_is(-8, 35, 23, 27, 0); // the constant terms
    assert_true(high[0] > 120 && high[1] < 30 && high[2] < 30);
    colour_is(-8.0001f, 0, 0, 0, 0);
    colour_is(8.0001f, 255, 255, 255, 0);
    colour_is(-INFINITY, 0, 0, 0, 0);
    colour_is(INFINITY, 255, 255, 255, 0);
    colour_is(NAN, 255, 0, 255, 0);
}

/* 1/8 stop further is another colour, also in 8 bits. */
static void neighbours_differ(void **state)
{
    (void)state;
    for (int i = -64; i < 64; i++) {
        uint8_t a[3], b[3];
        falsecolour_of((float)i / 8, a);
        falsecolour_of((float)(i + 1) / 8, b);
        assert_true(memcmp(a, b, 3) != 0);
    }
}

static void luminance_in_stops(void **state)
{
    (void)state;
    const float grey[3] = {8, 8, 8}, green[3] = {0, 1, 0}, red[3] = {1, 0, 0};
    const float black[3] = {0, 0, 0}, below[3] = {-1, -1, -1}, none[3] = {1, NAN, 1};
    const float lamp[3] = {1e38f, 1e38f, 1e38f}, over[3] = {0, INFINITY, 0};
    assert_true(fabsf(falsecolour_stops(grey) - 3) < 1e-5f);
    assert_true(fabsf(falsecolour_stops(green) - log2f(0.7152f)) < 1e-5f);
    assert_true(fabsf(falsecolour_stops(red) - log2f(0.2126f)) < 1e-5f);
    assert_true(isinf(falsecolour_stops(black)) && falsecolour_stops(black) < 0);
    assert_true(isinf(falsecolour_stops(below)) && falsecolour_stops(below) < 0);
    assert_true(isnan(falsecolour_stops(none)));
    assert_true(fabsf(falsecolour_stops(lamp) - 126.233f) < 1e-3f);
    assert_true(isinf(falsecolour_stops(over)) && falsecolour_stops(over) > 0);
}

static void picture(void **state)
{
    (void)state;
    /* planes of 3 px: 2^-3, NaN in blue, 0 */
    float px[9] = {0.125f, 1, 0, 0.125f, 1, 0, 0.125f, NAN, 0};
    const struct image radiance = {3, 1, 3, px};
    uint8_t got[9], want[3];
    const struct image8 out = {3, 1, 3, got};
    falsecolour_run(&radiance, 5, &out);
    falsecolour_of(2, want);
    assert_memory_equal(got, want, 3);
    assert_memory_equal(got + 3, ((uint8_t[]){255, 0, 255}), 3);
    assert_memory_equal(got + 6, ((uint8_t[]){0, 0, 0}), 3);
}

/* Every stop of the bar has its colour at its tick, and the numbers stand beside. */
static void legend(void **state)
{
    (void)state;
    enum { W = FALSECOLOUR_LEGEND_W, H = FALSECOLOUR_LEGEND_H };
    static uint8_t px[3 * W * H];
    const struct image8 out = {W, H, 3, px};
    falsecolour_legend(&out);
    for (int s = -9; s < 9; s++) { // a stop is 16 px high: 7.5 px above it
        uint8_t want[3];
        falsecolour_of((float)s + 7.5f / 16, want);
        const uint8_t *at = px + 3 * (H * (9 - s) / 18 - 8) * W;
        for (int c = 0; c < 3; c++)
            assert_true(abs(at[c] - want[c]) <= 1);
    }
    int ink[19] = {0}; // by stop, right of the ticks
    for (int y = 0; y < H; y++)
        for (int x = W * 2 / 5 + 4; x < W; x++)
            ink[(y + 8) / 16] += px[3 * (y * W + x)] > 128;
    for (int s = -9; s <= 9; s++)
        assert_int_equal(ink[9 - s] > 10, s % 4 == 0);
    assert_true(ink[9 - 8] > ink[9 + 8]); // + has more than -
}

/* Guards around the pixels stay, however small the picture. */
static void legend_of_any_size(void **state)
{
    (void)state;
    const int sides[] = {1, 2, 7, 39, 90};
    for (int i = 0; i < 25; i++) {
        int w = sides[i % 5], h = sides[i / 5];
        size_t n = (size_t)(3 * w * h);
        uint8_t *px = malloc(n); // its ends are ASan's
        assert_non_null(px);
        memset(px, 1, n);
        const struct image8 out = {w, h, 3, px};
        falsecolour_legend(&out);
        for (size_t k = 0; k < n; k += 3)
            assert_true(px[k] != 1 || px[k + 1] != 1 || px[k + 2] != 1);
        free(px);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(follows_the_table),
        cmocka_unit_test(ends_and_beyond),
        cmocka_unit_test(neighbours_differ),
        cmocka_unit_test(luminance_in_stops),
        cmocka_unit_test(picture),
        cmocka_unit_test(legend),
        cmocka_unit_test(legend_of_any_size),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
