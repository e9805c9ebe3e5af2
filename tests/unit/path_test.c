#include "core/splat/raster.h"
#include "firmware/path.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

/* A camera at (x, y, z), turned by `turn` around the vertical axis (positive looks to +x). */
static struct camera at(double x, double y, double z, double turn)
{
    double c = cos(turn), s = sin(turn);
    return (struct camera){100,
                           100,
                           80,
                           80,
                           50,
                           50,
                           {(float)cos(turn / 2), 0, (float)-sin(turn / 2), 0},
                           {(float)(s * z - c * x), (float)-y, (float)(-s * x - c * z)}};
}

static void near3(const double v[3], double x, double y, double z)
{
    assert_true(fabs(v[0] - x) < 1e-5);
    assert_true(fabs(v[1] - y) < 1e-5);
    assert_true(fabs(v[2] - z) < 1e-5);
}

static void centre_and_axis(void **state)
{
    (void)state;
    double v[3];
    struct camera c = at(1, 2, 3, 0.3);
    path_centre(&c, v);
    near3(v, 1, 2, 3);
    path_axis(&c, v);
    near3(v, sin(0.3), 0, cos(0.3));
}

static void nearest(void **state)
{
    (void)state;
    struct camera cams[] = {at(0, 0, 0, 0), at(1, 0, 0, 0), at(1, 0, 0, 0.5), at(9, 0, 0, 0)};
    struct camera to = at(0.8, 0, 0, 0.45), between = at(0.5, 0, 0, 0), far = at(100, 0, 0, 1);
    assert_int_equal(path_nearest(cams, 4, &to), 2);      // same distance as 1, smaller angle
    assert_int_equal(path_nearest(cams, 4, &between), 0); // the first of equals
    assert_int_equal(path_nearest(cams, 4, &far), 3);
    assert_int_equal(path_nearest(cams, 1, &far), 0);
}

/* Where the optical axis of a frame is nearest to p: distance of p from it. */
static double miss(const struct camera *cam, const double p[3])
{
    double c[3], a[3], along = 0, square = 0;
    path_centre(cam, c);
    path_axis(cam, a);
    for (int k = 0; k < 3; k++)
        along += a[k] * (p[k] - c[k]);
    assert_true(along > 0);
    for (int k = 0; k < 3; k++)
        square += pow(p[k] - c[k] - along * a[k], 2);
    return sqrt(square);
}

/* Cameras on an arc around (0, 0, 5): every frame looks there, none leaves the region of the
 * cameras. */
static void orbit_looks_at_the_convergence(void **state)
{
    (void)state;
    struct camera cams[5], frame;
    const double p[3] = {0, 0, 5};
    for (int i = 0; i < 5; i++) {
        double turn = 0.1 * (i - 2);
        cams[i] = at(-5 * sin(turn), 0, 5 - 5 * cos(turn), turn);
    }
    for (int i = 0; i < 12; i++) {
        double c[3];
        float r[9];
        path_orbit(cams, 5, 77, i, 12, &frame);
        assert_true(miss(&frame, p) < 1e-4);
        path_centre(&frame, c);
        assert_true(fabs(c[0]) <= 1 && fabs(c[1]) < 1e-4);
        raster_rotation(frame.q, r);
        assert_true(r[4] > 0.99f); // upright as the cameras
        assert_true(frame.w == 100 && frame.fx == 80);
    }
}

/* Parallel axes meet nowhere: the point is `far` ahead. */
static void orbit_of_parallel_cameras(void **state)
{
    (void)state;
    struct camera cams[] = {at(-1, 0, 0, 0), at(1, 0, 0, 0), at(0, 1, 0, 0), at(0, -1, 0, 0)};
    struct camera frame, first;
    const double p[3] = {0, 0, 4};
    double c[3];
    path_orbit(cams, 4, 4, 0, 8, &first);
    for (int i = 0; i < 8; i++) {
        path_orbit(cams, 4, 4, i, 8, &frame);
        assert_true(miss(&frame, p) < 1e-4);
        path_centre(&frame, c);
        assert_true(fabs(hypot(c[0], c[1]) - sqrt(0.5)) < 1e-4);
    }
    path_centre(&first, c);
    near3(c, sqrt(0.5), 0, 0);
}

static void orbit_of_one_camera_or_opposite_ones(void **state)
{
    (void)state;
    struct camera one = at(1, 2, 3, 0.7), frame, two[] = {at(0, 0, 0, 0), at(0, 0, 0, 3.14159265)};
    double c[3];
    path_orbit(&one, 1, 2, 3, 10, &frame);
    path_centre(&frame, c);
    near3(c, 1, 2, 3);
    path_orbit(two, 2, 2, 3, 10, &frame);
    for (int k = 0; k < 4; k++)
        assert_true(isfinite(frame.q[k]));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(centre_and_axis),
        cmocka_unit_test(nearest),
        cmocka_unit_test(orbit_looks_at_the_convergence),
        cmocka_unit_test(orbit_of_parallel_cameras),
        cmocka_unit_test(orbit_of_one_camera_or_opposite_ones),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
