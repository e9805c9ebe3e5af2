/* The sphere of what is infinitely far: around the cameras, and hit by every pixel. */
#include "core/base/shell.h"

#include "tests/unit/expect.h"

#include <math.h>

static void every_pixel_hits_it(void **state)
{
    (void)state;
    struct camera cams[3];
    for (int i = 0; i < 3; i++)
        cams[i] = (struct camera){.w = 100,
                                  .h = 80,
                                  .fx = 60,
                                  .fy = 60,
                                  .cx = 50,
                                  .cy = 40,
                                  .q = {1},
                                  .t = {-2.0f * (float)i, 0.5f, 7}};
    const struct shell s = shell_of(cams, 3);
    assert_true(fabsf(s.middle[0] - 2) < 1e-5f && fabsf(s.middle[2] + 7) < 1e-5f);
    assert_true(fabsf(s.radius - 2 * SHELL_FAR) < 1e-3f);
    for (int k = 0; k < 3 * 4; k++) {
        const struct camera *c = &cams[k / 4];
        const float u = k % 2 ? 0 : 100, v = k % 4 / 2 ? 0 : 80, z = shell_depth(&s, c, u, v);
        const float x[3] = {(u - c->cx) / c->fx * z - c->t[0], (v - c->cy) / c->fy * z - c->t[1],
                            z - c->t[2]};
        float d2 = 0;
        for (int i = 0; i < 3; i++)
            d2 += (x[i] - s.middle[i]) * (x[i] - s.middle[i]);
        assert_true(fabsf(sqrtf(d2) / s.radius - 1) < 1e-4f);
        assert_true(shell_has(&s, x));
    }
    assert_false(shell_has(&s, s.middle));
}

static void cameras_in_one_place_have_none(void **state)
{
    (void)state;
    const struct camera cams[2] = {{.q = {1}}, {.q = {0, 1}}};
    const struct shell s = shell_of(cams, 2);
    assert_true(s.radius == 0 && !shell_has(&s, (float[3]){1e6f, 0, 0}));
    assert_true(shell_of(NULL, 0).radius == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_pixel_hits_it),
        cmocka_unit_test(cameras_in_one_place_have_none),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
