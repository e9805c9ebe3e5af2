/* White stays white, colours keep their ratios, a longer exposure is no multiple of a shorter one,
 * and each operation does what its paper is for. */
#include "sim/sensor/local_tone.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

enum { W = 96, H = 64, AREA = W * H };

static float picture[3 * AREA];

static void tone(enum local_tone kind, int w, int h, float *px)
{
    struct arena tmp = {0};
    assert_int_equal(arena_init(&tmp, "test", local_tone_plan(kind, w, h)), OK);
    assert_int_equal(local_tone_run(&tmp, kind, w, h, px), OK);
    arena_free(&tmp);
}

/* Dark on the left, 4 stops brighter on the right, stripes of half a stop on both, and coloured. */
static void draw(float scale)
{
    static const float colour[3] = {0.8f, 1.0f, 0.6f};
    for (int i = 0; i < AREA; i++) {
        const float side = i % W < W / 2 ? 0.02f : 0.32f, stripe = i / W % 2 ? 1.1892f : 0.8409f;
        for (int c = 0; c < 3; c++)
            picture[c * AREA + i] = fminf(scale * side * stripe * colour[c], 1);
    }
}

/* Mean stops of green over rows of one parity, around column x. */
static float stops_at(int x, int parity)
{
    float sum = 0;
    for (int y = 16 + parity; y < 48; y += 2)
        sum += log2f(picture[AREA + y * W + x]) / 16;
    return sum;
}

static float step_between(int a, int b)
{
    return (stops_at(b, 0) + stops_at(b, 1) - stops_at(a, 0) - stops_at(a, 1)) / 2;
}

static void test_white_and_colours(void **state)
{
    (void)state;
    for (int kind = LOCAL_TONE_NONE; kind < LOCAL_TONES; kind++) {
        for (int i = 0; i < 3 * AREA; i++)
            picture[i] = 1;
        tone((enum local_tone)kind, W, H, picture);
        for (int i = 0; i < 3 * AREA; i++)
            assert_float_equal(picture[i], 1, 0.02);
        draw(1);
        tone((enum local_tone)kind, W, H, picture);
        for (int i = 0; i < AREA; i++)
            assert_float_equal(picture[i] / picture[AREA + i], 0.8f, 1e-4);
    }
}

static void test_base_keeps_detail(void **state)
{
    (void)state;
    draw(1);
    tone(LOCAL_TONE_BASE, W, H, picture);
    assert_true(step_between(12, 84) < 0.75f * 4); // compressed
    assert_float_equal(stops_at(12, 1) - stops_at(12, 0), 0.5, 0.06);
    assert_float_equal(stops_at(84, 1) - stops_at(84, 0), 0.5, 0.06);
}

static void test_clahe_adds_contrast(void **state)
{
    (void)state;
    draw(1);
    tone(LOCAL_TONE_CLAHE, W, H, picture);
    assert_true(stops_at(84, 1) - stops_at(84, 0) > 0.6f);
}

static void test_fusion_lifts_shadows(void **state)
{
    (void)state;
    draw(1);
    const float dark = stops_at(12, 0), bright = stops_at(84, 0);
    tone(LOCAL_TONE_FUSION, W, H, picture);
    assert_in_range((int)(100 * (stops_at(12, 0) - dark)), 100, 300);
    assert_true(stops_at(84, 0) - bright < stops_at(12, 0) - dark - 0.5f);
}

static void test_depends_on_exposure(void **state)
{
    (void)state;
    for (int kind = LOCAL_TONE_BASE; kind < LOCAL_TONES; kind++) {
        draw(0.25f);
        tone((enum local_tone)kind, W, H, picture);
        const float dark = stops_at(12, 0), bright = stops_at(84, 0);
        draw(1);
        tone((enum local_tone)kind, W, H, picture);
        assert_true(fabsf(stops_at(12, 0) - dark - 2) > 0.1f ||
                    fabsf(stops_at(84, 0) - bright - 2) > 0.1f);
    }
}

static void test_extremes(void **state)
{
    static const float odd[] = {0, -1, NAN, INFINITY, -INFINITY, 3e38f, 1e-44f, 1};
    static const int shape[][2] = {{1, 1}, {1, 64}, {64, 1}, {2, 2}, {33, 7}};
    (void)state;
    for (int kind = LOCAL_TONE_NONE; kind < LOCAL_TONES; kind++)
        for (size_t k = 0; k < sizeof shape / sizeof shape[0]; k++) {
            const int n = 3 * shape[k][0] * shape[k][1];
            for (int i = 0; i < n; i++)
                picture[i] = odd[(size_t)i % (sizeof odd / sizeof odd[0])];
            tone((enum local_tone)kind, shape[k][0], shape[k][1], picture);
            for (int i = 0; i < n && kind; i++)
                assert_true(picture[i] >= 0 && picture[i] < 20);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_white_and_colours),   cmocka_unit_test(test_base_keeps_detail),
        cmocka_unit_test(test_clahe_adds_contrast), cmocka_unit_test(test_fusion_lifts_shadows),
        cmocka_unit_test(test_depends_on_exposure), cmocka_unit_test(test_extremes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
