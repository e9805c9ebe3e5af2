/* Words of a camera's optics, and the light that is left at the pixels of a grey wall. */
#include "sim/sensor/optics.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { W = 64, H = 48 };

static struct optics parsed(const char *text)
{
    struct optics o;
    assert_int_equal(optics_parse("--lens", text, 100, 60, &o), OK);
    return o;
}

static void words_set_the_camera(void **state)
{
    (void)state;
    struct optics o = parsed("k1=-0.25,k2=0.05");
    assert_int_equal(o.lens.model, LENS_RADIAL);
    assert_int_equal(o.w, 100);
    assert_true(fabs(o.lens.fx - 50 / tan(M_PI / 6)) < 1e-9);
    assert_false(optics_dims(&o));
    o = parsed("k1=0.1,p2=0.001,size=800x600,fov=90");
    assert_int_equal(o.lens.model, LENS_OPENCV);
    assert_int_equal(o.w, 800);
    assert_int_equal(o.h, 600);
    assert_true(fabs(o.lens.fx - 400) < 1e-9 && o.lens.fy == o.lens.fx);
    assert_true(o.lens.cx == 400 && o.lens.cy == 300);
    assert_true(o.lens.term[0] == 0.1 && o.lens.term[2] == 0 && o.lens.term[3] == 0.001);
    o = parsed("k1=0.1,size=800x600,centre=0.51/0.45");
    assert_true(fabs(o.lens.cx - 408) < 1e-9 && fabs(o.lens.cy - 270) < 1e-9);
    o = parsed("fov=150,fisheye,k4=0.01,k1=-0.02");
    assert_int_equal(o.lens.model, LENS_OPENCV_FISHEYE);
    assert_true(fabs(o.lens.fx - 50 / (75 * M_PI / 180)) < 1e-9);
    assert_true(o.lens.term[0] == -0.02 && o.lens.term[3] == 0.01);
    o = parsed("gain=1.1,wb=1.05/1/0.97");
    assert_int_equal(o.lens.model, LENS_PINHOLE);
    assert_true(optics_dims(&o));
    const float want[3] = {1.1f * 1.05f, 1.1f, 1.1f * 0.97f};
    for (int c = 0; c < 3; c++)
        assert_true(fabsf(o.gain[c] - want[c]) < 1e-6f);
}

static void wrong_words_are_refused(void **state)
{
    (void)state;
    static const char *const bad[][2] = {
        {"", "is not a list"},
        {"k9=1", "is not a list"},
        {"k1=1,k1=2", "is not a list"},
        {"k1=nan", "is not a list"},
        {"k1", "is not a list"},
        {"k1=0.1,", "is not a list"},
        {"k3=0.1", "is not a list"},
        {"fisheye,p1=1", "is not a list"},
        {"fisheye=1", "is not a list"},
        {"size=800", "is not a list"},
        {"wb=1/1", "is not a list"},
        {"size=800x600x3", "is not a list"},
        {"k1=11", "k1 of 11, allowed"},
        {"size=13x99", "size of 13, allowed are 14"},
        {"fov=150", "at most 140"},
        {"fisheye,fov=221", "allowed are 10 to 220"},
        {"gain=0", "gain of 0, allowed"},
        {"v2=-1", "leaves 0 of the light at 1"},
        {"wb=1/11/1", "wb of 11"},
        {"v2=-4,v4=3.5", "of the light"},
    };
    struct optics o;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_int_equal(optics_parse("--lens", bad[i][0], 100, 60, &o), ERR_ARG);
        if (!strstr(err_text(), bad[i][1]))
            fail_msg("%s: %s", bad[i][0], err_text());
    }
}

/* A grey wall of radiance 2: v2, v4, cos^4 and gain against their formulas at every pixel. */
static void a_wall_is_dimmed_as_said(void **state)
{
    (void)state;
    static float wall[3 * W * H];
    static const char *const text[] = {"size=64x48,v2=-0.3,v4=0.05", "size=64x48,fov=90,cos4",
                                       "size=64x48,fov=80,cos4,v2=-0.2,gain=1.1,wb=1.05/1/0.97"};
    for (int k = 0; k < 3; k++) {
        const struct optics o = parsed(text[k]);
        for (int i = 0; i < 3 * W * H; i++)
            wall[i] = 2;
        optics_apply(&o, wall);
        for (int i = 0; i < 3 * W * H; i++) {
            const int x = i % W, y = i / W % H, c = i / (W * H);
            const double dx = x + 0.5 - 32, dy = y + 0.5 - 24, d2 = dx * dx + dy * dy;
            const double r2 = d2 / (32. * 32 + 24. * 24);
            const double f2 = o.lens.fx * o.lens.fx, facing = f2 / (f2 + d2); // cos^2
            double want = k == 0 ? 1 - 0.3 * r2 + 0.05 * r2 * r2 : facing * facing;
            if (k == 2)
                want *= (1 - 0.2 * r2) * 1.1 * (double[]){1.05, 1, 0.97}[c];
            assert_true(fabs((double)wall[i] - 2 * want) < 1e-5);
        }
    }
}

/* A fisheye's rays are at angles in proportion to the distance: cos^4 of that, dark from 90 degrees
 * on. */
static void a_fisheye_darkens_with_the_angle(void **state)
{
    (void)state;
    const struct optics o = parsed("fisheye,fov=180,size=64x64,cos4");
    for (int x = 0; x < 32; x++) {
        float got[3];
        optics_factor(&o, 32.5 + x, 32, got);
        const double want = pow(cos((x + 0.5) / 32 * M_PI / 2), 4);
        assert_true(fabs((double)got[1] - want) < 1e-6);
    }
    float corner[3];
    optics_factor(&o, 0.5, 0.5, corner);
    assert_true(corner[0] == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(words_set_the_camera),
        cmocka_unit_test(wrong_words_are_refused),
        cmocka_unit_test(a_wall_is_dimmed_as_said),
        cmocka_unit_test(a_fisheye_darkens_with_the_angle),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
