/* Crumbs of depth: what is dropped, and what stays. */
#include "core/stereo/speck.h"

#include "tests/unit/expect.h"

#include <math.h>
#include <stdbool.h>

enum { W = 24, H = 16, PIXELS = W * H };

static float depth[PIXELS], conf[PIXELS];

/* A wall that leans back by 2 % a pixel, confirmed by one other view. */
static void make_wall(void)
{
    for (int i = 0; i < PIXELS; i++) {
        depth[i] = 2 * powf(1.02f, (float)(i % W));
        conf[i] = 0.5f;
    }
}

/* n pixels of one row, half as far, with this confidence. */
static void put_crumb(int x, int y, int n, float sure)
{
    for (int i = y * W + x; i < y * W + x + n; i++) {
        depth[i] *= 0.5f;
        conf[i] = sure;
    }
}

static int drop_under(int least)
{
    static int list[PIXELS];
    return speck_drop(&(struct speck_map){W, H, depth, conf, 0.3f, 0.6f, least, list});
}

static int drop(void)
{
    return drop_under(6);
}

static void a_leaning_wall_stays(void **state)
{
    (void)state;
    make_wall();
    assert_int_equal(drop(), 0);
    for (int i = 0; i < PIXELS; i++)
        assert_float_equal(conf[i], 0.5, 0);
}

static void crumbs_are_dropped(void **state)
{
    (void)state;
    make_wall();
    put_crumb(0, 0, 1, 0.5f);
    put_crumb(10, 7, 5, 0.55f);
    put_crumb(W - 2, H - 1, 2, 0.4f);
    assert_int_equal(drop(), 8);
    for (int i = 0; i < PIXELS; i++) {
        const int x = i % W, y = i / W;
        const bool crumb = i == 0 || (y == 7 && x >= 10 && x < 15) || (y == H - 1 && x >= W - 2);
        assert_float_equal(conf[i], crumb ? 0 : 0.5, 0);
    }
}

/* Pieces of 6 px, those that several views confirm, if only at one pixel, and what was not sure. */
static void others_stay(void **state)
{
    (void)state;
    make_wall();
    put_crumb(3, 3, 6, 0.5f);
    put_crumb(3, 9, 4, 0.5f);
    conf[9 * W + 4] = 0.7f;
    put_crumb(18, 9, 2, 0.2f);
    assert_int_equal(drop(), 0);
    assert_float_equal(conf[3 * W + 3], 0.5, 0);
    assert_float_equal(conf[9 * W + 3], 0.5, 0);
    assert_float_equal(conf[9 * W + 4], 0.7, 1e-6);
    assert_float_equal(conf[9 * W + 18], 0.2, 1e-6);
    assert_int_equal(drop_under(7), 6);
}

/* A row does not continue at the other border. */
static void borders_part(void **state)
{
    (void)state;
    make_wall();
    for (int i = 0; i < PIXELS; i++)
        conf[i] = 0;
    for (int i = 5 * W + W - 3; i < 6 * W + 3; i++)
        conf[i] = 0.5f, depth[i] = 2;
    assert_int_equal(drop(), 6);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_leaning_wall_stays),
        cmocka_unit_test(crumbs_are_dropped),
        cmocka_unit_test(others_stay),
        cmocka_unit_test(borders_part),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
