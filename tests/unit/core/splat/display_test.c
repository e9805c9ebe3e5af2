#include "core/splat/display.h"

#include "core/kernels/kernels.h"
#include "core/photo/tonemap.h"

#include "tests/unit/core/splat/raster_ref.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define C0 0.28209479177387814

static const double middle = 0.2140411; // linear light that sRGB shows as 0.5

static unsigned seed = 1;

static double uniform(double lo, double hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (seed >> 8) / 0x1p24;
}

static double about_normal(void)
{
    double sum = 0;
    for (int i = 0; i < 12; i++)
        sum += uniform(-0.5, 0.5);
    return sum;
}

/* The definition of IEC 61966-2-1, continued. */
static double srgb(double linear)
{
    return linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
}

static double value_at(const float *sh, int degree, int c, const double b[25])
{
    double v = 0;
    for (int k = 0; k < (degree + 1) * (degree + 1); k++)
        v += b[k] * sh[3 * k + c];
    return v;
}

static void random_direction(int degree, double b[25])
{
    double d[3] = {about_normal(), about_normal(), about_normal()};
    double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int k = 0; k < 3; k++)
        d[k] /= length;
    ref_sh(degree, d, b);
}

static void the_transfer_is_srgb_without_end(void **state)
{
    (void)state;
    for (double x = -0.01; x < 1e6; x = x < 0.01 ? x + 1e-5 : x * 1.01) {
        float shown = display_encode((float)x);
        assert_true(fabs(shown - srgb(x)) <= 1e-6 * fmax(1, fabs(shown)));
        assert_true(fabs(display_decode(shown) - x) <= fmax(1e-6 * fabs(x), 2e-8));
    }
    assert_true(display_encode(1) == 1 && display_decode(1) == 1);
    assert_true(isnan(display_encode(NAN)) && isnan(display_decode(NAN)));
}

static void degree_0_goes_there_and_back(void **state)
{
    (void)state;
    for (float ev = -10; ev <= 10; ev += 2.5f)
        for (double stop = -13; stop <= 17; stop += 0.25) { // 1e-4 to 1e5
            double radiance = exp2(stop), linear = radiance * exp2(ev);
            float log_sh[3] = {(float)(log(radiance) / C0), 0, 1}, f[3], back[3];
            display_from_radiance(log_sh, 0, ev, f);
            assert_true(fabs(0.5 + C0 * f[0] - srgb(linear)) < 1e-6 * fmax(1, srgb(linear)));
            display_to_radiance(f, 0, ev, back);
            double found = exp(C0 * back[0]), step = 5e-9 + 3e-6 * linear; // a float near f
            if (linear > (double)DISPLAY_FLOOR)
                assert_true(fabs(found / radiance - 1) < step / linear);
            else
                assert_true(fabs(found * exp2(ev) / (double)DISPLAY_FLOOR - 1) < 0.01);
        }
}

/* Against sums over 200 x 64 directions. */
static void higher_degrees_are_the_best_fit(void **state)
{
    (void)state;
    enum { RINGS = 200, STEPS = 64 };
    for (int degree = 1; degree <= 4; degree++) {
        float log_sh[75], f[48];
        double want[48] = {0};
        int shown = degree < 3 ? degree : 3;
        for (int j = 0; j < 75; j++)
            log_sh[j] = (float)(0.3 * about_normal() - (j < 3 ? 4 + 2 * j : 0));
        display_from_radiance(log_sh, degree, 1.5f, f);
        for (int i = 0; i < RINGS * STEPS; i++) {
            double z = (i / STEPS + 0.5) / RINGS * 2 - 1, a = 2 * M_PI * (i % STEPS) / STEPS;
            double d[3] = {sqrt(1 - z * z) * cos(a), sqrt(1 - z * z) * sin(a), z}, b[25];
            ref_sh(degree, d, b);
            for (int j = 0; j < 3 * (shown + 1) * (shown + 1); j++) {
                double v = srgb(exp2(1.5) * exp(value_at(log_sh, degree, j % 3, b)));
                want[j] += (v - 0.5) * b[j / 3] * 4 * M_PI / (RINGS * STEPS);
            }
        }
        for (int j = 0; j < 3 * (shown + 1) * (shown + 1); j++)
            assert_true(fabs(f[j] - want[j]) < 2e-4);
    }
}

static void a_splat_without_view_dependence_has_none(void **state)
{
    (void)state;
    for (int degree = 1; degree <= 4; degree++) {
        float log_sh[75] = {-8, 0, 8}, f[48], back[75], plain[3];
        int shown = degree < 3 ? degree : 3;
        display_from_radiance(log_sh, 0, -1, plain);
        display_from_radiance(log_sh, degree, -1, f);
        for (int j = 0; j < 3 * (shown + 1) * (shown + 1); j++)
            assert_true(fabs(f[j] - (j < 3 ? (double)plain[j] : 0)) < 2e-6 * fabs(plain[2]));
        display_to_radiance(f, shown, -1, back);
        for (int j = 0; j < 3 * (shown + 1) * (shown + 1); j++)
            assert_true(fabs(back[j] - (j < 3 ? (double)log_sh[j] : 0)) < 1e-3);
    }
}

/* Displayed colours of 2000 splats of another program, whose colours are often below 0 or above 1.
 * */
static void foreign_colours_stay_what_they_were(void **state)
{
    (void)state;
    static const double bound[5] = {0, 46, 41, 37, 35};
    for (int degree = 1; degree <= 4; degree++) {
        double sum = 0;
        int n = 0;
        for (int i = 0; i < 2000; i++) {
            float f[75], log_sh[75];
            double b[25];
            for (int j = 0; j < 75; j++)
                f[j] = (float)(j < 3 ? uniform(-0.5, 0.5) / C0 : 0.1 * about_normal());
            display_to_radiance(f, degree, 3, log_sh);
            random_direction(degree, b);
            for (int c = 0; c < 3; c++) {
                double was = ref_clamp(0.5 + value_at(f, degree, c, b), 0, 1);
                double is = srgb(exp2(3) * exp(value_at(log_sh, degree, c, b)));
                sum += pow(was - fmin(is, 1), 2);
                n++;
            }
        }
        double db = -10 * log10(sum / n);
        print_message("degree %d: %.1f dB\n", degree, db);
        assert_true(db >= bound[degree]);
    }
}

static void numbers_stay_finite_and_nan_stays(void **state)
{
    (void)state;
    static const float wild[] = {3e38f, -3e38f, 1e9f, -100, 0, 1e-38f};
    for (int degree = 0; degree <= 4; degree++)
        for (int i = 0; i < 1000; i++) {
            float in[75], f[48], back[75], ev = (float)uniform(-200, 200);
            int n = 3 * (degree + 1) * (degree + 1), shown = degree < 3 ? n : 48;
            for (int j = 0; j < 75; j++)
                in[j] = wild[(int)uniform(0, 6)];
            display_from_radiance(in, degree, ev, f);
            display_to_radiance(in, degree, ev, back);
            for (int j = 0; j < n; j++)
                assert_true(isfinite(back[j]) && (j >= shown || isfinite(f[j])));
            in[i % n] = i % 2 ? NAN : INFINITY;
            display_from_radiance(in, degree, ev, f);
            display_to_radiance(in, degree, ev, back);
            for (int j = 0; j < n; j++) {
                assert_true(isnan(back[j]) == (j % 3 == i % n % 3));
                assert_true(j >= shown || isnan(f[j]) == (j % 3 == i % n % 3));
            }
        }
}

static void the_middle_of_the_curve_is_shown_as_the_middle(void **state)
{
    (void)state;
    struct tonemap t;
    tonemap_linear(&t, 0.5f, -20, 10, 3); // 0.5 at radiance 1
    assert_true(fabs(display_ev(&t) - log2(middle)) < 1e-4);
    t.p[3 * TONE_HIDDEN] += 0.5f * 3; // red: 3 stops more sensitive, 0.5 at 1/8
    assert_true(fabs(display_ev(&t) - log2(middle) - 1) < 1e-4);
    t.p[TONE_PER_COLOUR + 3 * TONE_HIDDEN] = 100; // green: always white, does not count
    assert_true(fabs(display_ev(&t) - log2(middle) - 1.5) < 1e-4);
    for (int c = 0; c < 3; c++)
        t.p[c * TONE_PER_COLOUR + 3 * TONE_HIDDEN] = 300 * (c - 1.5f);
    assert_true(display_ev(&t) == 0);
    tonemap_linear(&t, -0.5f, -20, 10, 3); // falls
    assert_true(display_ev(&t) == 0);
    for (int i = 0; i < TONE_PARAMS; i++)
        t.p[i] = i % 2 ? 3e38f : -3e38f;
    assert_true(isfinite(display_ev(&t)));
}

/* Units at -20 and at `knot`, in all colours. */
static struct tonemap two_units(float knot, float w2, float v2, float b2)
{
    struct tonemap t = {0};
    for (int c = 0; c < 3; c++) {
        float *p = t.p + c * TONE_PER_COLOUR;
        p[0] = p[1] = 1;
        p[TONE_HIDDEN] = 20;
        p[TONE_HIDDEN + 1] = -knot;
        p[2 * TONE_HIDDEN] = w2;
        p[2 * TONE_HIDDEN + 1] = v2;
        p[3 * TONE_HIDDEN] = b2;
    }
    return t;
}

static void curves_that_hardly_have_a_middle(void **state)
{
    (void)state;
    struct tonemap t = two_units(100, 0, -10, -50); // its last line is above 0.5 where it is not
    assert_true(display_ev(&t) == 0);
    for (int i = 0; i < 10000; i++) { // level from 0.5 on, but for rounding
        float knot = (float)uniform(-10, 10);
        t = two_units(knot, 0.1f, -0.1f, -(0.1f * (knot + 20)));
        float ev = display_ev(&t);
        assert_true(ev == 0 || fabs(ev - log2(middle) + log2(exp2(knot) - 1e-6)) < 1e-3);
    }
}

static void the_made_curve_is_srgb(void **state)
{
    (void)state;
    for (float ev = -20; ev <= 15; ev += 2.5f) {
        struct tonemap t;
        struct tonemap_table table;
        display_tonemap(ev, &t);
        tonemap_table_init(&table, &t);
        assert_true(t.mid_log2t == 0 && fabsf(display_ev(&t) - ev) < 1e-5f);
        for (double stop = -15; ev <= 0 && stop < 30; stop += 0.01) {
            float radiance = (float)exp2(stop - ev), shown;
            tonemap_run(&table.c[stop > 0 ? 1 : 2], &radiance, 0, 1, &shown);
            if (radiance > 0.01f) // else what the curve adds to radiance counts
                assert_true(fabs(shown - fmin(srgb(exp2(stop)), 1)) < 4e-4);
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_transfer_is_srgb_without_end),
        cmocka_unit_test(degree_0_goes_there_and_back),
        cmocka_unit_test(higher_degrees_are_the_best_fit),
        cmocka_unit_test(a_splat_without_view_dependence_has_none),
        cmocka_unit_test(foreign_colours_stay_what_they_were),
        cmocka_unit_test(numbers_stay_finite_and_nan_stays),
        cmocka_unit_test(the_middle_of_the_curve_is_shown_as_the_middle),
        cmocka_unit_test(curves_that_hardly_have_a_middle),
        cmocka_unit_test(the_made_curve_is_srgb),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
