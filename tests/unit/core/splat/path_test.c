#include "core/base/rotation.h"
#include "core/splat/path.h"
#include "core/splat/raster.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

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
    rotation_centre(&c, v);
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
    rotation_centre(cam, c);
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
        rotation_centre(&frame, c);
        assert_true(fabs(c[0]) <= 1 && fabs(c[1]) < 1e-4);
        rotation_from_unit(frame.q, r);
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
        rotation_centre(&frame, c);
        assert_true(fabs(hypot(c[0], c[1]) - sqrt(0.5)) < 1e-4);
    }
    rotation_centre(&first, c);
    near3(c, sqrt(0.5), 0, 0);
}

static void orbit_of_one_camera_or_opposite_ones(void **state)
{
    (void)state;
    struct camera one = at(1, 2, 3, 0.7), frame, two[] = {at(0, 0, 0, 0), at(0, 0, 0, 3.14159265)};
    double c[3];
    path_orbit(&one, 1, 2, 3, 10, &frame);
    rotation_centre(&frame, c);
    near3(c, 1, 2, 3);
    path_orbit(two, 2, 2, 3, 10, &frame);
    for (int k = 0; k < 4; k++)
        assert_true(isfinite(frame.q[k]));
}

/* ---- through the cameras ---- */

static double apart(const struct camera *a, const struct camera *b)
{
    double p[3], q[3], square = 0;
    rotation_centre(a, p);
    rotation_centre(b, q);
    for (int k = 0; k < 3; k++)
        square += (p[k] - q[k]) * (p[k] - q[k]);
    return sqrt(square);
}

static double angle(const struct camera *a, const struct camera *b)
{
    double p[3], q[3], cosine = 0;
    path_axis(a, p);
    path_axis(b, q);
    for (int k = 0; k < 3; k++)
        cosine += p[k] * q[k];
    return acos(fmin(cosine, 1));
}

/* The way begins and ends on cameras and comes by all others. */
static void way_meets_the_cameras(void **state)
{
    (void)state;
    struct camera cams[] = {at(0, 0, 0, 0), at(1, 0.2, 0, 0.1), at(1.5, 0, 1, -0.4),
                            at(4, 0, 0, 0)};
    struct camera frame;
    cams[3].fx = 120;
    path_through(cams, 4, 3, 0, &frame);
    assert_true(apart(&frame, &cams[0]) < 1e-5 && angle(&frame, &cams[0]) < 1e-3);
    path_through(cams, 4, 3, 1, &frame);
    assert_true(apart(&frame, &cams[3]) < 1e-5 && angle(&frame, &cams[3]) < 1e-3);
    assert_true(fabsf(frame.fx - 120) < 1e-3f);
    for (int i = 1; i < 3; i++) {
        double best = 1;
        for (int k = 0; k <= 4000; k++) {
            path_through(cams, 4, 3, k / 4000.0, &frame);
            best = fmin(best, apart(&frame, &cams[i]) + angle(&frame, &cams[i]));
            assert_true(frame.fx >= 80 && frame.fx <= 120.001f);
        }
        assert_true(best < 3e-3);
    }
}

/* Along a straight rail with cameras at uneven distances the speed is the same everywhere, also at
 * the ends, and nothing leaves the rail. */
static void way_is_even(void **state)
{
    (void)state;
    struct camera cams[] = {at(0, 0, 0, 0), at(0.4, 0, 0, 0), at(2, 0, 0, 0), at(3, 0, 0, 0)};
    for (int i = 0; i <= 100; i++) {
        struct camera frame;
        double c[3];
        path_through(cams, 4, 5, i / 100.0, &frame);
        rotation_centre(&frame, c);
        near3(c, 3 * i / 100.0, 0, 0);
        assert_true(angle(&frame, &cams[0]) < 1e-3);
    }
}

/* A turn on the spot at an even pace stays one, through half a circle. */
static void way_of_turns(void **state)
{
    (void)state;
    struct camera cams[4], frame;
    for (int i = 0; i < 4; i++)
        cams[i] = at(1, 2, 3, 1.0472 * i);
    cams[2].q[0] = -cams[2].q[0]; // the same rotation by the other quaternion
    cams[2].q[2] = -cams[2].q[2];
    for (int i = 0; i <= 60; i++) {
        double c[3], a[3], turn = 1.0472 * 3 * i / 60;
        path_through(cams, 4, 2, i / 60.0, &frame);
        rotation_centre(&frame, c);
        near3(c, 1, 2, 3);
        path_axis(&frame, a);
        assert_true(fabs(a[0] - sin(turn)) < 1e-3 && fabs(a[2] - cos(turn)) < 1e-3);
    }
}

static double number(uint32_t *x)
{
    *x = *x * 1664525u + 1013904223u;
    return (double)(*x >> 8) * 0x1p-24 - 0.5;
}

/* Cameras anywhere: neither place nor direction jumps, neither does their pace, and several
 * photographs from nearly one place are passed as one. */
static void way_is_smooth(void **state)
{
    (void)state;
    enum { FRAMES = 2000 };
    uint32_t x = 4;
    for (int round = 0; round < 20; round++) {
        struct camera cams[24], frame[3];
        double length = 0, pace[2] = {0}, turn[2] = {0};
        for (int i = 0; i < 24; i += 3) {
            double p[4] = {number(&x), number(&x), number(&x), 2 * number(&x)};
            for (int k = 0; k < 3; k++)
                cams[i + k] = at(p[0] + 1e-4 * number(&x), p[1], p[2], p[3] + 1e-4 * number(&x));
        }
        for (int i = 0; i < 21; i += 3)
            length += apart(&cams[i], &cams[i + 3]) + angle(&cams[i], &cams[i + 3]);
        for (int i = 0; i <= FRAMES; i++) {
            memmove(frame, frame + 1, 2 * sizeof frame[0]);
            path_through(cams, 24, 1, (double)i / FRAMES, &frame[2]);
            memmove(pace, pace + 1, sizeof pace[0]);
            memmove(turn, turn + 1, sizeof turn[0]);
            pace[1] = apart(&frame[1], &frame[2]);
            turn[1] = angle(&frame[1], &frame[2]);
            if (i > 0)
                assert_true(pace[1] + turn[1] < 4 * length / FRAMES);
            if (i > 1)
                assert_true(fabs(pace[1] - pace[0]) + fabs(turn[1] - turn[0]) <
                            0.15 * length / FRAMES);
        }
    }
}

static void way_of_one_place(void **state)
{
    (void)state;
    struct camera cams[] = {at(1, 2, 3, 0.7), at(1, 2, 3, 0.7)}, frame;
    for (int n = 1; n <= 2; n++)
        for (int i = 0; i <= 2; i++) {
            path_through(cams, n, 1, i / 2.0, &frame);
            assert_memory_equal(&frame, cams, sizeof frame);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(centre_and_axis),
        cmocka_unit_test(nearest),
        cmocka_unit_test(orbit_looks_at_the_convergence),
        cmocka_unit_test(orbit_of_parallel_cameras),
        cmocka_unit_test(orbit_of_one_camera_or_opposite_ones),
        cmocka_unit_test(way_meets_the_cameras),
        cmocka_unit_test(way_is_even),
        cmocka_unit_test(way_of_turns),
        cmocka_unit_test(way_is_smooth),
        cmocka_unit_test(way_of_one_place),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
