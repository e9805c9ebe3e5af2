/* A pinhole's picture as a lens takes it: the way back of undistort.h. */
#include "core/photo/distort.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

enum { W = 64, H = 48 };

static struct lens lens_of(enum lens_model model, double focal, double k1)
{
    struct lens l = {.model = model, .fx = focal, .fy = focal, .cx = 30, .cy = 25, .term = {k1}};
    assert_int_equal(lens_init(&l), OK);
    return l;
}

/* The planes hold the place of each pixel of the pinhole, so that what comes back is known. */
static void assert_places(const struct lens *l, double bound)
{
    struct camera c;
    static float out[3 * W * H];
    assert_int_equal(distort_camera(l, W, H, 400, &c), OK);
    const size_t plane = (size_t)c.w * (size_t)c.h;
    float *in = malloc(3 * plane * sizeof *in);
    assert_non_null(in);
    for (size_t i = 0; i < plane; i++) {
        in[i] = ((float)(i % (size_t)c.w) + 0.5f - c.cx) / c.fx;
        in[plane + i] = ((float)(i / (size_t)c.w) + 0.5f - c.cy) / c.fy;
        in[2 * plane + i] = 1;
    }
    const struct distort_job j = {l, &c, 3, W, H, in, out, NULL};
    assert_int_equal(distort_run(NULL, &j), OK);
    for (int i = 0; i < W * H; i++) {
        const double px[2] = {i % W + 0.5, i / W + 0.5};
        double ray[3];
        const bool seen = lens_unproject(l, px, ray) && ray[2] > cos(70 * 3.14159265 / 180);
        if (!seen)
            continue;
        const double scale = 1 / ray[2] / ray[2]; // of an error of the angle
        assert_float_equal(out[2 * W * H + i], 1, 1e-5);
        assert_float_equal(out[i], ray[0] / ray[2], bound * scale);
        assert_float_equal(out[W * H + i], ray[1] / ray[2], bound * scale);
    }
    free(in);
}

static void pixels_come_back(void **state)
{
    (void)state;
    const struct lens barrel = lens_of(LENS_SIMPLE_RADIAL, 40, -0.1),
                      cushion = lens_of(LENS_SIMPLE_RADIAL, 40, 0.1),
                      fisheye = lens_of(LENS_OPENCV_FISHEYE, 30, -0.02);
    assert_places(&barrel, 2e-3);
    assert_places(&cushion, 2e-3);
    assert_places(&fisheye, 5e-3);
}

static void what_no_pinhole_shows_is_black(void **state)
{
    (void)state;
    const struct lens wide = lens_of(LENS_OPENCV_FISHEYE, 10, 0);
    struct camera c;
    static float out[W * H];
    static uint8_t seen[W * H];
    assert_int_equal(distort_camera(&wide, W, H, 100, &c), OK);
    assert_true(c.w <= 100 && c.h <= 100 && c.fx < 10.5f);
    const size_t plane = (size_t)c.w * (size_t)c.h;
    float *in = malloc(plane * sizeof *in);
    assert_non_null(in);
    for (size_t i = 0; i < plane; i++)
        in[i] = 1;
    const struct distort_job j = {&wide, &c, 1, W, H, in, out, seen};
    assert_int_equal(distort_run(NULL, &j), OK);
    assert_float_equal(out[25 * W + 30], 1, 1e-6);
    assert_true(out[0] == 0 && out[W * H - 1] == 0); // beyond 75 degrees
    assert_true(seen[25 * W + 30] == 1 && seen[0] == 0 && seen[W * H - 1] == 0);
    struct camera narrow = c; // its right third is missing
    narrow.w = c.w * 2 / 3;
    struct distort_job less = j;
    less.pinhole = &narrow;
    assert_int_equal(distort_run(NULL, &less), OK);
    assert_true(seen[25 * W + 30] == 1 && seen[25 * W + 44] == 0);
    free(in);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pixels_come_back),
        cmocka_unit_test(what_no_pinhole_shows_is_black),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
