/* Response curves of all simulated families, recovered from noisy brackets; few, dark, clipped,
 * posterised and changed pictures. Codes that stand for fewer than 16 electrons are not compared:
 * there the noise, not the curve, makes the code. */
#include "core/photo/crf.h"

#include "sim/sensor/curve.h"
#include "sim/sensor/sensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 192, H = 128, PIXELS = W * H, BYTES = 3 * PIXELS, MOST = 9 };
#define ELECTRONS 10000.0
#define READ_NOISE 3.0

static uint8_t pictures[MOST][BYTES];
static const uint8_t *shown[MOST];
static double times[MOST];
static void *tmp;

static struct crf_stack stack(int n)
{
    return (struct crf_stack){n, W, H, shown, times};
}

/* A ramp of 11 stops with waves, its colours apart. */
static double radiance(int x, int y, int colour)
{
    return exp2(-10.0 + 11.0 * x / W + 0.7 * sin(y * 0.21 + x / 23.0) +
                0.3 * colour * sin(y * 0.05));
}

static void take_picture(const struct curve *curve, double exposure, uint64_t seed, uint8_t *px)
{
    for (int i = 0; i < BYTES; i++) {
        double e = radiance(i / 3 % W, i / 3 / W, i % 3) * exposure * ELECTRONS;
        e += sqrt(e + READ_NOISE * READ_NOISE) * sensor_normal(seed, (uint64_t)i);
        float x = (float)fmin(fmax(e / ELECTRONS, 0.0), 1.0);
        px[i] = (uint8_t)lrintf(255.0f * curve_display(curve, x));
    }
}

static void bracket(const struct curve *curve, const double *stops, int n, uint64_t seed)
{
    for (int i = 0; i < n; i++) {
        times[i] = 0.01 * exp2(stops[i]);
        shown[i] = pictures[i];
        take_picture(curve, exp2(stops[i]), seed * 16 + (uint64_t)i, pictures[i]);
    }
}

static void recover_curve(enum crf_method m, int n, struct crf *out)
{
    struct crf_stack s = stack(n);
    err_t e = crf_recover(m, &s, tmp, out);
    if (e != OK)
        print_error("%s\n", err_text());
    assert_int_equal(e, OK);
    assert_true(out->known);
}

static void check_shape(const struct crf *c)
{
    assert_true(isfinite(c->error) && c->error >= 0.0f);
    for (int i = 0; i < 3; i++) {
        assert_true(c->log2x[i][255] == 0.0f && isfinite(c->log2x[i][0]));
        for (int z = 1; z < 256; z++)
            assert_true(c->log2x[i][z] > c->log2x[i][z - 1]);
    }
}

/* Rms of display values that the true curve gives for the recovered exposures, of full scale, with
 * the scale that fits best; *shift: that scale, stops. */
static double deviation(const struct curve *curve, const struct crf *c, int colour, double *shift)
{
    double best = INFINITY;
    *shift = 0.0;
    for (int k = -100; k <= 100; k++) {
        double sum = 0.0;
        int n = 0;
        for (int z = 1; z < 255; z++) {
            float truth = (float)z / 255.0f, x = exp2f(c->log2x[colour][z] + 0.005f * (float)k);
            if (curve_exposure(curve, truth) * ELECTRONS < 16.0)
                continue;
            double e = (double)(curve_display(curve, x) - truth);
            sum += e * e;
            n++;
        }
        if (sqrt(sum / n) < best) {
            best = sqrt(sum / n);
            *shift = 0.005 * k;
        }
    }
    return best;
}

static const double unequal[] = {0.0, 1.4, 3.2, 5.4, 8.0}, equal[] = {0.0, 2.0, 4.0, 6.0, 8.0};
/* Worst deviation over a family's parameters, %. */
static void family_errors(enum curve_family f, const double *stops, double worst[3],
                          double *most_shift)
{
    static const float lo[] = {0, 0, 1.6f, 0, 8, 3, 0.3f}, hi[] = {0, 0, 3, 1, 16, 12, 1.5f};
    int n = f <= CURVE_SRGB ? 1 : f == CURVE_RANDOM ? 5 : 2;
    memset(worst, 0, 3 * sizeof *worst);
    for (int k = 0; k < n; k++) {
        struct curve c;
        curve_make(f, n > 1 ? lo[f] + (hi[f] - lo[f]) * (float)k / (float)(n - 1) : 0.0f,
                   100 + (uint64_t)k, &c);
        bracket(&c, stops, 5, 10 + (uint64_t)k);
        for (int m = 0; m < 3; m++) {
            struct crf got;
            double shift;
            recover_curve((enum crf_method)m, 5, &got);
            check_shape(&got);
            for (int i = 0; i < 3; i++) {
                worst[m] = fmax(worst[m], 100.0 * deviation(&c, &got, i, &shift));
                *most_shift = fmax(*most_shift, fabs(shift));
            }
        }
    }
}

static void test_families(void **state)
{
    static const char *const name[] = {"linear", "sRGB", "gamma", "filmic", "AgX", "log", "random"};
    (void)state;
    printf("rms error, %% of full scale            family Debevec Robertson, scale off, stops\n");
    for (int way = 0; way < 2; way++)
        for (int f = 0; f < CURVE_FAMILIES; f++) {
            double worst[3], shift = 0.0;
            family_errors((enum curve_family)f, way == 0 ? unequal : equal, worst, &shift);
            printf("  %-6s %-28s %7.2f %7.2f %7.2f %10.2f\n", name[f],
                   way == 0 ? "0 1.4 3.2 5.4 8 stops" : "0 2 4 6 8 stops", worst[0], worst[1],
                   worst[2], shift);
            for (int m = 0; m < 3; m++)
                assert_true(worst[m] <= (way == 1 && m != CRF_FAMILY ? 2.5 : 1.0));
            assert_true(shift < 0.25);
        }
}

/* --- what is given ------------------------------------------------------------------------ */

static void srgb_bracket(int n)
{
    static const double stops[] = {0.0, 1.4, 3.2, 5.4, 8.0, 8.7, 2.0, 2.0, 6.1};
    struct curve c;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    bracket(&c, stops, n, 5);
}

static void test_order_and_inputs(void **state)
{
    static const int order[] = {7, 3, 0, 8, 2, 6, 1, 4, 5}; // 6 and 7 have one exposure
    static uint8_t before[MOST][BYTES];
    const uint8_t *px[MOST];
    double t[MOST], t_before[MOST];
    (void)state;
    srgb_bracket(MOST);
    memcpy(before, pictures, sizeof before);
    for (int i = 0; i < MOST; i++) {
        px[i] = shown[order[i]];
        t_before[i] = t[i] = times[order[i]];
    }
    for (int m = 0; m < 3; m++) {
        struct crf a, b;
        struct crf_stack mixed = {MOST, W, H, px, t};
        recover_curve((enum crf_method)m, MOST, &a);
        assert_int_equal(crf_recover((enum crf_method)m, &mixed, tmp, &b), OK);
        assert_memory_equal(&a, &b, sizeof a);
    }
    assert_memory_equal(before, pictures, sizeof before);
    assert_memory_equal(t_before, t, sizeof t);
}

static void posterise(uint8_t *px)
{
    for (int i = 0; i < BYTES; i++)
        if (px[i] > 0 && px[i] < 250)
            px[i] = (uint8_t)(px[i] / 5 * 5 + 2);
}

/* Codes that never occur leave no holes; two pictures are enough. */
static void test_empty_codes(void **state)
{
    struct curve c;
    struct crf got;
    double shift;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    for (int m = 0; m < 3; m++) {
        srgb_bracket(5);
        for (int i = 0; i < 5; i++)
            posterise(pictures[i]);
        recover_curve((enum crf_method)m, 5, &got);
        check_shape(&got);
        assert_true(deviation(&c, &got, 1, &shift) < 0.015);
        bracket(&c, (const double[]){5.0, 6.3}, 2, 3);
        recover_curve((enum crf_method)m, 2, &got);
        check_shape(&got);
        assert_true(deviation(&c, &got, 1, &shift) < 0.04);
    }
}

/* A code that only a few wrong pixels have does not spoil the others. */
static void test_odd_code(void **state)
{
    struct curve c;
    struct crf got;
    double shift;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    for (int m = 0; m < 3; m++) {
        srgb_bracket(5);
        for (int i = 0; i < 5; i++)
            for (int k = 0; k < BYTES; k++)
                pictures[i][k] = (uint8_t)(pictures[i][k] - (pictures[i][k] == 180));
        for (int p = 0; p < 64; p++)
            for (int i = 0; i < 5; i++)
                memset(&pictures[i][3 * ((60 + p / 8) * W + 90 + p % 8)], i < 4 ? 30 : 180, 3);
        recover_curve((enum crf_method)m, 5, &got);
        check_shape(&got);
        assert_true(deviation(&c, &got, 1, &shift) < 0.01);
    }
}

/* Checks that change places from picture to picture, or all but a fifth in every other picture, get
 * their codes divided or lowered. */
static void spoil_pictures(bool checks, int divide, int lower)
{
    for (int i = 1; i < 5; i += checks ? 1 : 2)
        for (int k = 0; k < BYTES; k++) {
            int x = k / 3 % W, y = k / 3 / W;
            bool here = checks ? x % 12 < 6 && (x + y + i) % 2 : x >= W / 5;
            if (here && pictures[i][k] > lower)
                pictures[i][k] = (uint8_t)(pictures[i][k] / divide - lower);
        }
}

/* Checks on half of the scene while the camera moves by a pixel: flat surroundings come first. A
 * wall under a lamp that ripples, four fifths of the scene, has one grey: it counts as one. */
static void test_bad_parts(void **state)
{
    struct curve c;
    struct crf got;
    double shift;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    for (int m = 0; m < 3; m++) {
        srgb_bracket(5);
        spoil_pictures(true, 4, 0);
        recover_curve((enum crf_method)m, 5, &got);
        assert_true(deviation(&c, &got, 1, &shift) < 0.01);
        srgb_bracket(5);
        for (int i = 0; i < 5; i++)
            for (int k = W / 5; k < PIXELS; k += k % W == W - 1 ? 1 + W / 5 : 1)
                memcpy(&pictures[i][3 * k], &pictures[i][3 * (W / 2)], 3);
        spoil_pictures(false, 1, 12);
        recover_curve((enum crf_method)m, 5, &got);
        assert_true(deviation(&c, &got, 1, &shift) < 0.015);
    }
}

/* The error on held-out pixels: noise, or a scene that changed. */
static void test_held_out(void **state)
{
    struct crf still, moved;
    (void)state;
    for (int m = 0; m < 3; m++) {
        srgb_bracket(5);
        recover_curve((enum crf_method)m, 5, &still);
        for (int i = 0; i < 5; i += 2)
            for (int k = 0; k < BYTES / 2; k++) { // mirrored
                uint8_t v = pictures[i][k];
                pictures[i][k] = pictures[i][BYTES - 1 - k];
                pictures[i][BYTES - 1 - k] = v;
            }
        recover_curve((enum crf_method)m, 5, &moved);
        check_shape(&moved);
        assert_true(still.error > 0.005f && still.error < 0.12f && moved.error > 0.5f);
    }
}

static void assert_refused(err_t code, const struct crf_stack *s, const char *const words[2])
{
    struct crf got, srgb;
    crf_srgb(&srgb);
    for (int m = 0; m < 3; m++) {
        memset(&got, 0x55, sizeof got);
        assert_int_equal(crf_recover((enum crf_method)m, s, tmp, &got), code);
        for (int i = 0; i < 2; i++)
            if (strstr(err_text(), words[i]) == NULL)
                fail_msg("no \"%s\" in \"%s\"", words[i], err_text());
        assert_memory_equal(got.log2x, srgb.log2x, sizeof srgb.log2x);
        assert_true(!got.known && got.error == 0.0f);
    }
}

static void test_bad_arguments(void **state)
{
    static const double bad[] = {0.0, -1.0, NAN, INFINITY};
    (void)state;
    srgb_bracket(5);
    struct crf_stack s = stack(1);
    assert_refused(ERR_ARG, &s, (const char *[]){"1 pictures", "2..9"});
    s.n = 10;
    assert_refused(ERR_ARG, &s, (const char *[]){"10 pictures", "2..9"});
    s = stack(5);
    s.w = 0;
    assert_refused(ERR_ARG, &s, (const char *[]){"0 x 128", "1..65535"});
    s = stack(5);
    for (int i = 0; i < 4; i++) {
        times[3] = bad[i];
        assert_refused(ERR_ARG, &s, (const char *[]){"exposure 3 is", "> 0"});
    }
    for (int i = 0; i < 5; i++)
        times[i] = 0.02 + 0.0001 * i;
    assert_refused(ERR_ARG, &s, (const char *[]){"0.02..0.0204", "1.1"});
}

static void test_too_little(void **state)
{
    struct curve c;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    struct crf_stack s = stack(3);
    bracket(&c, (const double[]){-14.0, -13.0, -12.0}, 3, 1); // all dark
    assert_refused(ERR_LIMIT, &s, (const char *[]){"red", "needed"});
    bracket(&c, (const double[]){-5.5, -4.0, -3.3}, 3, 1); // grey, but nothing bright
    assert_refused(ERR_LIMIT, &s, (const char *[]){"reach from", "to 208"});
    bracket(&c, (const double[]){14.0, 15.0, 16.0}, 3, 1); // clipped
    memset(pictures, 255, sizeof pictures);
    assert_refused(ERR_LIMIT, &s, (const char *[]){"has 0 pairs", "needed"});
    srgb_bracket(5);
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < PIXELS; k++)
            pictures[i][3 * k + 2] = 0; // a lens that lets no blue pass
    s = stack(5);
    assert_refused(ERR_LIMIT, &s, (const char *[]){"blue", "has 0 pairs"});
    srgb_bracket(5);
    s.w = 4;
    s.h = 4;
    assert_refused(ERR_LIMIT, &s, (const char *[]){"response curve", "red"});
}

/* A few pixels are enough for the family, when the others refuse. */
static void test_few_pixels(void **state)
{
    struct curve c;
    struct crf got;
    double shift;
    (void)state;
    curve_make(CURVE_GAMMA, 2.2f, 0, &c);
    bracket(&c, unequal, 5, 9);
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < 100; k++)
            memcpy(&pictures[i][3 * k], &pictures[i][3 * (k * (PIXELS / 100) + k % W)], 3);
    struct crf_stack s = {5, 10, 10, shown, times};
    assert_int_equal(crf_recover(CRF_FAMILY, &s, tmp, &got), OK);
    assert_true(deviation(&c, &got, 1, &shift) < 0.02);
    assert_int_equal(crf_recover(CRF_DEBEVEC, &s, tmp, &got), ERR_LIMIT);
}

static void test_srgb(void **state)
{
    struct crf c;
    (void)state;
    crf_srgb(&c);
    check_shape(&c);
    assert_true(!c.known && c.error == 0.0f);
    assert_true(fabsf(c.log2x[0][188] - log2f(0.5029f)) < 1e-3f);           // IEC 61966-2-1
    assert_true(fabsf(c.log2x[2][5] - log2f(5.0f / 255 / 12.92f)) < 1e-5f); // straight part
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_srgb),        cmocka_unit_test(test_families),
        cmocka_unit_test(test_empty_codes), cmocka_unit_test(test_order_and_inputs),
        cmocka_unit_test(test_held_out),    cmocka_unit_test(test_bad_arguments),
        cmocka_unit_test(test_too_little),  cmocka_unit_test(test_few_pixels),
        cmocka_unit_test(test_odd_code),    cmocka_unit_test(test_bad_parts),
    };
    struct crf_stack s = stack(MOST);
    tmp = aligned_alloc(64, (crf_plan(&s) + 63) / 64 * 64);
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    free(tmp);
    return failed;
}
