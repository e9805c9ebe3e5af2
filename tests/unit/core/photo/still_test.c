/* Pictures of one place at two exposures, and those that are not. */
#include "core/photo/still.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { W = 320, H = 224 };

static uint8_t first[W * H], second[W * H];

/* What a camera sees: radiance over 3 stops each way, with texture in all directions. */
static double radiance(double x, double y)
{
    const double s = sin(0.31 * x + 0.2 * y) + sin(0.17 * x - 0.37 * y + 1) +
                     0.7 * sin(0.05 * x * sin(0.01 * y) + 0.11 * y);
    return 0.1 * exp2(1.2 * s);
}

static uint8_t code(double light)
{
    return (uint8_t)(255 * pow(fmin(light, 1), 1 / 2.2) + 0.5);
}

/* Of the place seen `dx`, `dy` px further, what is near by `near` times as far. */
static struct image8 take(uint8_t *px, double exposure, double dx, double dy, double near)
{
    for (int i = 0; i < W * H; i++) {
        const double k = i % W < W / 2 ? near : 1;
        px[i] = code(exposure * radiance(i % W + k * dx, i / W + k * dy));
    }
    return (struct image8){W, H, 1, px};
}

static bool compare(double stops, double dx, double dy, double near)
{
    const struct image8 a = take(first, 1, 0, 0, 1), b = take(second, exp2(stops), dx, dy, near);
    return still_same(&a, &b) && still_same(&b, &a);
}

static void brackets_are_one_place(void **state)
{
    (void)state;
    for (double stops = -4; stops <= 3; stops++)
        if (!compare(stops, 0, 0, 1))
            fail_msg("%.0f stops apart: two places", stops);
    assert_true(compare(2, 0.05, 0.05, 1));
    assert_true(compare(0, 0, 0, 1));
}

static void a_camera_that_moved_is_another_place(void **state)
{
    (void)state;
    static const double shift[][3] = {{0.4, 0, 1}, {0, -0.4, 1}, {1, 1, 1},
                                      {7, 3, 1},   {100, 0, 1},  {0.15, 0, 6}};
    for (int k = 0; k < 6; k++)
        for (double stops = -2; stops <= 2; stops += 2)
            if (compare(stops, shift[k][0], shift[k][1], shift[k][2]))
                fail_msg("moved by %g, %g px (%g times near), %g stops apart: one place",
                         shift[k][0], shift[k][1], shift[k][2], stops);
}

static void people_may_walk_by(void **state)
{
    (void)state;
    const struct image8 a = take(first, 1, 0, 0, 1), b = take(second, 2, 0, 0, 1);
    for (int y = 0; y < H; y++)
        memset(second + y * W + 100, 70, W / 5);
    assert_true(still_same(&a, &b));
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W * 3 / 5; x++)
            second[y * W + x] = code(2 * radiance(x + 30, y));
    assert_false(still_same(&a, &b)); // most of it is another picture
}

static void without_texture_nothing_is_said(void **state)
{
    (void)state;
    const struct image8 a = {W, H, 1, first}, b = {W, H, 1, second};
    for (int value = 0; value <= 255; value += 51) {
        memset(first, value, sizeof first);
        memset(second, 255 - value, sizeof second);
        assert_false(still_same(&a, &b));
        assert_false(still_same(&a, &a));
    }
    for (int i = 0; i < W * H; i++) // edges in one direction only
        first[i] = second[i] = code(radiance(i % W, 0));
    assert_false(still_same(&a, &b));
    assert_false(compare(12, 0, 0, 1)); // all saturated
    assert_false(compare(-12, 0, 0, 1));
    for (int edge = 1; edge < 40; edge += 6) {
        const struct image8 tiny = {edge, edge, 1, first};
        assert_false(still_same(&tiny, &tiny));
    }
}

static void photographs_become_smaller(void **state)
{
    (void)state;
    enum { LARGE = 1000 };
    static uint8_t rgb[LARGE * 9 * 3], px[333 * 3];
    struct image8 photo = {LARGE, 9, 3, rgb}, out = still_size(LARGE, 9);
    assert_true(out.w == 333 && out.h == 3 && out.channels == 1 && !out.px);
    for (int i = 0; i < LARGE * 9; i++)
        rgb[3 * i + 1] = (uint8_t)(i % LARGE / 3 % 200);
    out.px = px;
    still_shrink(&photo, &out);
    for (int i = 0; i < 333 * 3; i++)
        assert_int_equal(px[i], i % 333 % 200);
    const struct image8 strip = still_size(16384, 3); // nothing is left of it
    assert_int_equal(strip.h, 0);
    assert_false(still_same(&strip, &strip));
    assert_int_equal(still_size(STILL_EDGE, 100).w, STILL_EDGE);
    assert_int_equal(still_size(100, STILL_EDGE + 1).h, (STILL_EDGE + 1) / 2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(brackets_are_one_place),
        cmocka_unit_test(a_camera_that_moved_is_another_place),
        cmocka_unit_test(people_may_walk_by),
        cmocka_unit_test(without_texture_nothing_is_said),
        cmocka_unit_test(photographs_become_smaller),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
