/* Vignetting and gain of cameras: where a pixel of a view is in its photograph, and what becomes of
 * light there. */
#include "core/photo/shade.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { W = 64, H = 48 };

static const struct camera view = {.w = W, .h = H, .fx = 50, .fy = 50, .cx = 32, .cy = 24};

static void a_photograph_reaches_one_in_its_corners(void **state)
{
    (void)state;
    struct shade s;
    shade_map(NULL, 0, 0, &view, &s);
    assert_float_equal(shade_r2(&s, 0.5f, 0.5f), 0, 1e-6);
    assert_float_equal(shade_r2(&s, 0, 0), 1, 1e-6);
    assert_float_equal(shade_r2(&s, 1, 1), 1, 1e-6);
    assert_float_equal(shade_r2(&s, 1, 0.5f), 0.64, 1e-6);
    assert_float_equal(shade_r2(&s, 7, -7), 1, 1e-6); // ends at the frame
    assert_float_equal(shade_r2(&s, 0.73f, 0.31f),
                       4 * (pow(0.23 * W, 2) + pow(0.19 * H, 2)) / (W * W + H * H), 1e-3);
}

/* A view of 64 x 48 px in a photograph of 640 x 480, which is 20 px aside and barrel-shaped. */
static void a_view_is_measured_in_its_photograph(void **state)
{
    (void)state;
    struct shade s;
    struct lens lens = {
        .model = LENS_SIMPLE_RADIAL, .fx = 500, .fy = 500, .cx = 340, .cy = 240, .term = {-0.2}};
    assert_int_equal(lens_init(&lens), OK);
    shade_map(&lens, 640, 480, &view, &s);
    const double ray[3] = {(0.75 * W - 32) / 50, (0.25 * H - 24) / 50, 1};
    double px[2];
    assert_true(lens_project(&lens, ray, px));
    const double want = 4 * (pow(px[0] - 340, 2) + pow(px[1] - 240, 2)) / (640 * 640 + 480 * 480);
    assert_float_equal(shade_r2(&s, 0.75f, 0.25f), want, 1e-4);
    lens.term[0] = -3; // the corners have no pixel
    assert_int_equal(lens_init(&lens), OK);
    shade_map(&lens, 640, 480, &view, &s);
    assert_float_equal(shade_r2(&s, 0, 0), 1, 1e-6);
}

static void light_is_multiplied(void **state)
{
    (void)state;
    static float light[3 * W * H];
    struct shade s;
    float stops[3];
    shade_map(NULL, 0, 0, &view, &s);
    s.model = (struct shade_model){{-0.5, 0.25, -0.125}, {1, 0, -1}};
    for (int i = 0; i < 3 * W * H; i++)
        light[i] = 2;
    shade_apply(NULL, &s, W, H, light);
    for (int i = 0; i < 3 * W * H; i += 7) {
        const int at = i % (W * H);
        const float r2 = shade_r2(&s, ((float)(at % W) + 0.5f) / W, ((float)(at / W) + 0.5f) / H);
        shade_stops(&s.model, r2, stops);
        assert_float_equal(light[i], 2 * exp2f(stops[i / (W * H)]), 1e-5);
        assert_float_equal(stops[1], -0.5f * r2 + 0.25f * r2 * r2 - 0.125f * r2 * r2 * r2, 1e-6);
    }
    assert_float_equal(shade_most(&s.model), 1.375, 1e-6);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_photograph_reaches_one_in_its_corners),
        cmocka_unit_test(a_view_is_measured_in_its_photograph),
        cmocka_unit_test(light_is_multiplied),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
