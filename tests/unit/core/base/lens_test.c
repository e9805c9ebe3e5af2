/* Lenses: there and back, derivatives against differences, edges of the image circle, figures that
 * OpenCV's functions give. */
#include "core/base/lens.h"
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "tests/unit/expect.h"

#include <math.h>

static uint64_t rng = 1;

static double uniform(double lo, double hi)
{
    return lo + (hi - lo) * (double)(splitmix_next(&rng) >> 11) * 0x1p-53;
}

static struct lens random_lens(enum lens_model m)
{
    struct lens l = {m, 900, 900, 800, 600, {0}, 0};
    if (m != LENS_SIMPLE_RADIAL && m != LENS_RADIAL)
        l.fy = uniform(850, 950);
    if (m != LENS_PINHOLE)
        l.term[0] = uniform(-0.35, 0.1);
    if (m >= LENS_RADIAL)
        l.term[1] = uniform(-0.05, 0.1);
    if (m >= LENS_OPENCV)
        for (int i = 2; i < 4; i++)
            l.term[i] = uniform(-3e-3, 3e-3);
    expect_ok(lens_init(&l));
    return l;
}

static void there_and_back(void **state)
{
    (void)state;
    for (int m = 0; m < LENS_MODELS; m++) {
        int seen = 0;
        double worst = 0;
        for (int i = 0; i < 4000; i++) {
            const struct lens l = random_lens((enum lens_model)m);
            const double pixel[2] = {uniform(0, 1600), uniform(0, 1200)};
            double ray[3], again[2];
            if (!lens_unproject(&l, pixel, ray))
                continue; // outside the image circle
            seen++;
            assert_true(fabs(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2] - 1) < 1e-12);
            for (int k = 0; k < 3; k++)
                ray[k] *= 7;
            assert_true(lens_project(&l, ray, again));
            worst = fmax(worst, hypot(again[0] - pixel[0], again[1] - pixel[1]));
        }
        print_message("  %s: %d of 4000 pixels, worst %.1e px\n", lens_name((enum lens_model)m),
                      seen, worst);
        assert_true(worst < 1e-6);
        assert_true(seen > 3000);
    }
}

/* What has a pixel is found again from it. */
static void check_return(const struct lens *l, const double ray[3])
{
    double pixel[2], again[3];
    if (!lens_project(l, ray, pixel)) {
        assert_int_equal(l->model, LENS_OPENCV); // tangential terms fold before the limit
        return;
    }
    assert_true(lens_unproject(l, pixel, again));
    for (int k = 0; k < 3; k++)
        assert_true(fabs(again[k] - ray[k]) < 1e-6);
}

/* Beyond the limit there is no pixel. */
static void rays_up_to_the_limit(void **state)
{
    (void)state;
    for (int i = 0; i < 2000 * LENS_MODELS; i++) {
        const struct lens l = random_lens((enum lens_model)(i % LENS_MODELS));
        const bool fisheye = l.model == LENS_OPENCV_FISHEYE;
        const double turn = uniform(0, 2 * NUM_PI), to = uniform(0, 0.98) * fmin(l.limit, 2);
        const double angle = fisheye ? to : atan(to);
        const double ray[3] = {sin(angle) * cos(turn), sin(angle) * sin(turn), cos(angle)};
        const double out = fisheye ? fmin(l.limit * 1.01, NUM_PI) : atan(l.limit * 1.01);
        const double beyond[3] = {sin(out) * cos(turn), sin(out) * sin(turn), cos(out)};
        double pixel[2];
        check_return(&l, ray);
        if (l.limit < 2)
            assert_false(lens_project(&l, beyond, pixel));
    }
}

/* Difference of the pixels of two lenses or rays against a derivative. */
static void check_slope(const double a[2], const double b[2], const double *by, int stride)
{
    for (int q = 0; q < 2; q++)
        assert_true(fabs((b[q] - a[q]) / 2e-6 - by[stride * q]) < 1e-3);
}

static void check_by_ray(const struct lens *l, const double ray[3], const double by_ray[6])
{
    for (int k = 0; k < 3; k++) {
        double lo[3] = {ray[0], ray[1], ray[2]}, hi[3] = {ray[0], ray[1], ray[2]}, a[2], b[2];
        lo[k] -= 1e-6;
        hi[k] += 1e-6;
        if (lens_project(l, lo, a) && lens_project(l, hi, b))
            check_slope(a, b, by_ray + k, 3);
    }
}

static double *parameter(struct lens *l, int k)
{
    double *const focal[4] = {&l->fx, &l->fy, &l->cx, &l->cy};
    return k < 4 ? focal[k] : &l->term[k - 4];
}

static void check_by_param(const struct lens *l, const double ray[3],
                           const double by_param[2 * LENS_PARAMS])
{
    static const int terms[LENS_MODELS] = {0, 1, 2, 4, 4};
    for (int k = 0; k < 4 + terms[l->model]; k++) {
        struct lens lo = *l, hi = *l;
        double a[2], b[2];
        *parameter(&lo, k) -= 1e-6;
        *parameter(&hi, k) += 1e-6;
        if (lens_project(&lo, ray, a) && lens_project(&hi, ray, b))
            check_slope(a, b, by_param + k, LENS_PARAMS);
    }
}

static void derivatives(void **state)
{
    (void)state;
    for (int i = 0; i < 300 * LENS_MODELS; i++) {
        const struct lens l = random_lens((enum lens_model)(i % LENS_MODELS));
        double ray[3] = {uniform(-0.5, 0.5), uniform(-0.5, 0.5), uniform(0.7, 3)};
        double pixel[2], by_ray[6], by_param[2 * LENS_PARAMS];
        if (i < LENS_MODELS)
            ray[0] = ray[1] = 0; // the axis
        if (!lens_project_grad(&l, ray, pixel, by_ray, by_param))
            continue;
        check_by_ray(&l, ray, by_ray);
        check_by_param(&l, ray, by_param);
    }
}

static void limits(void **state)
{
    (void)state;
    struct lens l = {LENS_SIMPLE_RADIAL, 500, 500, 0, 0, {-1.0 / 3}, 0};
    const double at[3] = {0.99, 0, 1}, over[3] = {1.01, 0, 1}, behind[3] = {0.1, 0, -1};
    const double edge[2] = {500 * 0.66, 0}, outside[2] = {500 * 0.67, 0};
    double pixel[2], ray[3];
    expect_ok(lens_init(&l));
    assert_true(fabs(l.limit - 1) < 1e-3); // 1 - r^2 = 0
    assert_true(lens_project(&l, at, pixel));
    assert_false(lens_project(&l, over, pixel));
    assert_false(lens_project(&l, behind, pixel));
    assert_true(lens_unproject(&l, edge, ray));
    assert_false(lens_unproject(&l, outside, ray)); // the circle ends at 500 * 2 / 3
    struct lens fish = {LENS_OPENCV_FISHEYE, 400, 400, 800, 600, {0}, 0};
    const double side[3] = {1, 0, -0.2}, nowhere[3] = {0, 0, -1}, nan_ray[3] = {NAN, 0, 1};
    expect_ok(lens_init(&fish));
    assert_true(lens_project(&fish, side, pixel)); // 101 degrees from the axis
    assert_true(fabs(pixel[0] - 800 - 400 * atan2(1, -0.2)) < 1e-9);
    assert_false(lens_project(&fish, nowhere, pixel));
    assert_false(lens_project(&fish, nan_ray, pixel));
    fish.fx = 0;
    expect_err(lens_init(&fish), ERR_ARG, "not positive");
    fish.fx = INFINITY;
    expect_err(lens_init(&fish), ERR_ARG, "not finite");
}

/* Projection of (0.3, -0.2, 1) by the formulas in OpenCV's manual; the order of parameters. */
static void known_pixels(void **state)
{
    (void)state;
    const double ray[3] = {0.3, -0.2, 1},
                 params[8] = {1000, 1010, 640, 360, -0.2, 0.05, 1e-3, -2e-3};
    struct lens l;
    double p[2], back[LENS_PARAMS];
    expect_ok(lens_from_params(LENS_OPENCV, params, 8, &l));
    assert_true(lens_project(&l, ray, p));
    const double r2 = 0.13, radial = 1 - 0.2 * r2 + 0.05 * r2 * r2;
    assert_true(fabs(p[0] - (640 + 1000 * (0.3 * radial - 0.00012 - 0.00062))) < 1e-9);
    assert_true(fabs(p[1] - (360 + 1010 * (-0.2 * radial + 0.00021 + 0.00024))) < 1e-9);
    assert_int_equal(lens_params(&l, back), 8);
    assert_memory_equal(back, params, sizeof params);
    assert_int_equal(lens_find("OPENCV"), LENS_OPENCV);
    assert_int_equal(lens_find("THIN_PRISM_FISHEYE"), LENS_MODELS);
    expect_err(lens_from_params(LENS_RADIAL, params, 8, &l), ERR_FORMAT, "has 5 parameters, not 8");
    const double radial_params[4] = {700, 320, 240, -0.1};
    expect_ok(lens_from_params(LENS_SIMPLE_RADIAL, radial_params, 4, &l));
    assert_true(l.fx == 700 && l.fy == 700 && l.cx == 320 && l.term[0] == -0.1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(there_and_back), cmocka_unit_test(rays_up_to_the_limit),
        cmocka_unit_test(derivatives),    cmocka_unit_test(limits),
        cmocka_unit_test(known_pixels),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
