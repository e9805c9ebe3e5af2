/* Brackets of a known radiance of 14 stops, photographed by the simulated sensor, come back within
 * the noise that photons and read-out leave; what is clipped or dark in all frames stays finite and
 * in order. */
#include "core/photo/merge.h"

#include "sim/sensor/sensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 280, H = 64, N = W * H, STOPS = 14 };

static const struct run plain;
static const struct develop as_is = {1.0f, 1.0f};
static float radiance[3 * N], merged[3 * N];
static uint16_t numbers[3 * N], frame_px[3][3 * N];
static uint8_t display[3 * N];
static struct raw frames[3];

static const double exposure[3] = {0.001, 0.016, 0.25}; // 4 stops apart

/* Grey, 2^-13 .. 2 of what saturates the longest, in W steps. */
static void make_scene(void)
{
    for (int i = 0; i < 3 * N; i++)
        radiance[i] = exp2f((float)STOPS * ((float)(i % W) / (W - 1) - 1.0f)) * 850.0f;
}

static struct sensor sensor_for(enum sensor_cfa cfa)
{
    struct sensor s = sensor_default;
    s.cfa = cfa;
    s.prnu = s.dsnu = s.row_noise = s.dark_per_s = 0.0f;
    s.electrons = (float)((4095 - s.black) / s.gain); // radiance 1 saturates in 1 s
    return s;
}

static void take_frame(const struct sensor *s, int i, const struct curve *c)
{
    struct sensor_shot shot = {exposure[i], 1.0f, 0.0, 5, (uint64_t)i};
    struct image im = {W, H, 3, radiance};
    struct sensor_raw raw = {W, H, numbers};
    assert_int_equal(sensor_expose(&plain, s, &shot, &im, &raw), OK);
    frames[i] = (struct raw){W, H, RAW_RGGB, s->bits, s->black, true, frame_px[i]};
    if (c) {
        assert_int_equal(sensor_develop(&plain, s, &shot, c, &raw, display), OK);
        for (int k = 0; k < 3 * N; k++)
            frame_px[i][k] = display[k];
        frames[i] = (struct raw){W, H, RAW_RGB, 8, 0, false, frame_px[i]};
    } else if (s->cfa == SENSOR_RGB) {
        for (int k = 0; k < 3 * N; k++)
            frame_px[i][k] = numbers[k % 3 * N + k / 3];
        frames[i].cfa = RAW_RGB;
    } else {
        memcpy(frame_px[i], numbers, sizeof *numbers * N);
    }
}

static void merge_frames(int n, const double *exposure_s, const struct crf *crf)
{
    struct image out = {frames[0].w, frames[0].h, 3, merged};
    struct merge_set set = {frames, n, exposure_s, crf, &as_is, NULL};
    memset(merged, 0xFF, sizeof merged);
    merge_rows(&set, 0, frames[0].h, &out);
}

/* Relative bias and rms of the columns of one stop, and the rms by photon noise. */
struct error {
    double bias, rms, bound;
};

static struct error error_of(const struct sensor *s, int stop)
{
    int begin = stop * W / STOPS, end = (stop + 1) * W / STOPS, n = 0;
    double sum = 0.0, sum2 = 0.0, bound2 = 0.0;
    for (int i = 0; i < 3 * N; i++) {
        if (i % W < begin || i % W >= end)
            continue;
        double truth = radiance[i], e = 0.0, noise2 = 0.0, wrong = merged[i] / truth - 1.0;
        for (int k = 0; k < 3; k++) {
            double here = truth * exposure[k] * s->electrons;
            bool seen = truth * exposure[k] < 0.9;
            e += seen ? here : 0.0;
            noise2 += seen ? here + s->read_noise * s->read_noise + 0.08 / (s->gain * s->gain) : 0;
        }
        sum += wrong;
        sum2 += wrong * wrong;
        bound2 += noise2 / (e * e);
        n++;
    }
    return (struct error){sum / n, sqrt(sum2 / n), sqrt(bound2 / n)};
}

static void test_within_noise(void **state)
{
    struct sensor s = sensor_for(SENSOR_RGB);
    (void)state;
    s.balance[0] = s.balance[1] = s.balance[2] = 1.0f;
    make_scene();
    for (int i = 0; i < 3; i++)
        take_frame(&s, i, NULL);
    merge_frames(3, exposure, NULL);
    for (int k = 0; k < STOPS; k++) {
        struct error e = error_of(&s, k);
        print_message("stop %2d: rms %.4f, photons and read-out %.4f, bias %+.5f\n", k, e.rms,
                      e.bound, e.bias);
        assert_true(e.rms < 1.08 * e.bound && e.rms > 0.9 * e.bound);
        assert_true(fabs(e.bias) < 0.003 + 0.05 * e.bound);
    }
}

/* Neighbours are averaged, so noise is below that of a site. White balance undoes the filters. */
static void test_mosaic(void **state)
{
    struct sensor s = sensor_for(SENSOR_RGGB);
    struct develop how;
    struct image out = {W, H, 3, merged};
    struct merge_set set = {frames, 3, exposure, NULL, &how, NULL};
    (void)state;
    make_scene();
    for (int i = 0; i < 3; i++)
        take_frame(&s, i, NULL);
    develop_balance(frames, 3, &how);
    // sites of a cell are 3.5 % apart in this steep scene
    assert_true(fabsf(how.red * 0.6f - 1.0f) < 0.03f && fabsf(how.blue * 0.7f - 1.0f) < 0.03f);
    how = (struct develop){1.0f / 0.6f, 1.0f / 0.7f};
    merge_rows(&set, 0, H, &out);
    for (int k = 0; k < STOPS; k++) {
        struct error e = error_of(&s, k);
        assert_true(fabs(e.bias) < 0.004 && e.rms < 1.3 * e.bound + 0.005);
    }
}

static void test_display(void **state)
{
    struct sensor s = sensor_for(SENSOR_RGB);
    struct curve c;
    struct crf crf;
    (void)state;
    make_scene();
    for (int k = 0; k < 2; k++) {
        curve_make(k ? CURVE_AGX : CURVE_SRGB, 11.0f, 0, &c);
        for (int i = 0; i < 3 * 256; i++)
            crf.log2x[i / 256][i % 256] =
                log2f(fmaxf(curve_exposure(&c, (float)(i % 256) / 255.0f), 1e-6f));
        for (int i = 0; i < 3; i++)
            take_frame(&s, i, &c);
        merge_frames(3, exposure, k ? &crf : NULL);
        for (int stop = 0; stop < STOPS; stop++) {
            struct error e = error_of(&s, stop);
            assert_true(fabs(e.bias) < 0.01 && e.rms < 1.35 * e.bound + 0.01);
        }
    }
}

/* ---- codes without noise ---- */

/* A row of radiance rising over 30 stops: nothing breaks at either end. */
static void ramp(bool linear, enum raw_cfa cfa)
{
    struct crf srgb;
    crf_srgb(&srgb);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < W * 2 * (cfa == RAW_RGB ? 3 : 1); k++) {
            int x = cfa == RAW_RGB ? k / 3 % W : k % W, code = 0;
            double v = fmin(exp2(30.0 * x / W - 15.0) * exposure[i], 1.0);
            while (!linear && code < 255 && exp2(srgb.log2x[1][code + 1]) <= v)
                code++;
            frame_px[i][k] = (uint16_t)(linear ? 64 + lround(v * 959.0) : code);
        }
    for (int i = 0; i < 3; i++)
        frames[i] = (struct raw){W, 2, cfa, linear ? 10 : 8, linear ? 64 : 0, linear, frame_px[i]};
}

static void test_ends(void **state)
{
    static const enum raw_cfa kinds[] = {RAW_MONO, RAW_RGB};
    (void)state;
    for (int k = 0; k < 4; k++) {
        ramp(k & 1, kinds[k / 2]);
        merge_frames(3, exposure, NULL);
        for (int i = 0; i < 3 * 2 * W; i++) {
            assert_true(isfinite(merged[i]) && merged[i] >= 0.0f);
            // a code of rounding is all that may be missing where frames are handed over
            assert_true(i % W == 0 || merged[i] >= merged[i - 1] * 0.97f);
        }
        assert_true(merged[0] < 0.002f);
        assert_true(fabsf(merged[W - 1] / 1000.0f - 1.0f) < 1e-5f); // saturates the shortest
    }
}

static void test_frames_and_rows(void **state)
{
    static float first[3 * N];
    struct sensor s = sensor_for(SENSOR_RGGB);
    (void)state;
    make_scene();
    for (int i = 0; i < 3 * N; i++)
        radiance[i] *= 4.0f; // the shortest is clipped, too
    for (int i = 0; i < 3; i++)
        take_frame(&s, i, NULL);
    merge_frames(3, exposure, NULL);
    memcpy(first, merged, sizeof first);
    struct image out = {W, H, 3, merged};
    struct merge_set set = {frames, 3, exposure, NULL, &as_is, NULL};
    memset(merged, 0xFF, sizeof merged);
    for (int y = 0; y < H; y += 9)
        merge_rows(&set, y, y + 9 < H ? y + 9 : H, &out);
    assert_memory_equal(first, merged, sizeof first);
    struct raw swap = frames[0]; // the order of frames does not matter
    frames[0] = frames[2];
    frames[2] = swap;
    merge_frames(3, (const double[3]){exposure[2], exposure[1], exposure[0]}, NULL);
    for (int i = 0; i < 3 * N; i++)
        assert_true(fabsf(merged[i] - first[i]) <= 1e-5f * first[i] + 1e-6f);
}

/* Where a frame shows something else, the picture is that of the others. */
static void test_left_out(void **state)
{
    static float others[3 * N];
    static uint8_t cells[4] = {1}; // the darkest quarter
    struct ghost_mask moved[3] = {{W / 4, 4, 1, NULL, 0, {0, 0}},
                                  {W / 4, 4, 1, NULL, 0, {0, 0}},
                                  {W / 4, 4, 1, cells, 0.25, {0, 0}}};
    const struct curve *kinds[2] = {NULL, NULL};
    struct curve srgb;
    (void)state;
    curve_make(CURVE_SRGB, 0, 0, &srgb);
    kinds[1] = &srgb;
    make_scene();
    for (int k = 0; k < 2; k++) {
        struct sensor s = sensor_for(SENSOR_RGB);
        struct image out = {W, H, 3, merged};
        for (int i = 0; i < 3; i++)
            take_frame(&s, i, kinds[k]);
        merge_frames(2, exposure, NULL);
        memcpy(others, merged, sizeof others);
        const struct merge_set set = {frames, 3, exposure, NULL, &as_is, moved};
        merge_rows(&set, 0, H, &out);
        int differ = 0;
        for (int i = 0; i < 3 * N; i++) {
            assert_true(i % W >= W / 4 || merged[i] == others[i]);
            differ += i % W >= W / 4 && i % W < W / 2 && merged[i] != others[i];
        }
        assert_true(differ > 3 * N / 8); // where the frame counts, it matters
    }
}

static void test_one_frame(void **state)
{
    const double one = 1.0;
    (void)state;
    for (int i = 0; i < 1024; i++)
        frame_px[0][i] = (uint16_t)i;
    frames[0] = (struct raw){32, 32, RAW_MONO, 10, 64, true, frame_px[0]};
    merge_frames(1, &one, NULL);
    for (int i = 0; i < 1024; i++)
        assert_true(fabsf(merged[i] - fmaxf((float)(i - 64) / 959.0f, 0.0f)) < 1e-6f);
    for (int i = 0; i < 2 * 256 * 3; i++)
        frame_px[0][i] = (uint16_t)(i / 3 % 256);
    frames[0] = (struct raw){256, 2, RAW_RGB, 8, 0, false, frame_px[0]};
    merge_frames(1, &one, NULL);
    assert_true(fabsf(merged[188] - 0.5029f) < 1e-3f && fabsf(merged[255] - 1.0f) < 1e-6f);
}

/* With display values, a frame that clips one colour of a pixel does not count for the others. */
static void test_one_colour_clipped(void **state)
{
    const double times[2] = {0.1, 0.2};
    (void)state;
    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < 24; i++)
            frame_px[i / 12][i % 12] = i % 3 != c ? 188 : i < 12 ? 200 : 250;
        for (int i = 0; i < 2; i++)
            frames[i] = (struct raw){2, 2, RAW_RGB, 8, 0, false, frame_px[i]};
        merge_frames(2, times, NULL);
        for (int k = 0; k < 3; k++) // the first alone
            assert_true(fabsf(merged[4 * k] - (k == c ? 5.776f : 5.029f)) < 1e-2f);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_within_noise),    cmocka_unit_test(test_mosaic),
        cmocka_unit_test(test_display),         cmocka_unit_test(test_ends),
        cmocka_unit_test(test_frames_and_rows), cmocka_unit_test(test_left_out),
        cmocka_unit_test(test_one_frame),       cmocka_unit_test(test_one_colour_clipped),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
