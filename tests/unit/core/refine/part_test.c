/* Parts of photographs: inside them, on the squares, everywhere in turn, and the camera fits. */
#include "core/refine/part.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { UNIT = 64 };

static int drawn[64 * 64]; // how often each square was seen

static void assert_fits(const struct camera *cam, const struct part *p)
{
    const int w = cam->w, most = ((w + UNIT - 1) / UNIT + PART_SIDES - 1) / PART_SIDES * UNIT;
    assert_true(p->x >= 0 && p->y >= 0 && p->x % UNIT == 0 && p->y % UNIT == 0);
    assert_true(p->cam.w >= 1 && p->x + p->cam.w <= w && p->cam.w <= most);
    assert_true(p->cam.h >= 1 && p->y + p->cam.h <= cam->h);
    assert_true(p->x + p->cam.w == w || p->cam.w % UNIT == 0);
    assert_float_equal(p->cam.cx, 500 - p->x, 0);
    assert_float_equal(p->cam.cy, 300 - p->y, 0);
    assert_true(p->cam.fx == 900 && p->cam.fy == 800);
    for (int y = p->y / UNIT; y * UNIT < p->y + p->cam.h; y++)
        for (int x = p->x / UNIT; x * UNIT < p->x + p->cam.w; x++)
            drawn[y * 64 + x]++;
}

static void sizes_and_corners(void **state)
{
    (void)state;
    static const int sides[][2] = {{1600, 1200}, {1024, 11}, {4000, 3000}, {1023, 1}, {63, 65}};
    uint64_t rng = 3;
    for (size_t k = 0; k < sizeof sides / sizeof *sides; k++) {
        const struct camera cam = {sides[k][0], sides[k][1], 900, 800, 500, 300, {1}, {0}};
        const int across = (cam.w + UNIT - 1) / UNIT, down = (cam.h + UNIT - 1) / UNIT;
        memset(drawn, 0, sizeof drawn);
        for (int i = 0; i < 3000; i++) {
            const struct part p = part_random(&cam, UNIT, &rng);
            assert_fits(&cam, &p);
        }
        for (int i = 0; i < across * down; i++)
            assert_true(drawn[i / across * 64 + i % across] > 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(sizes_and_corners)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
