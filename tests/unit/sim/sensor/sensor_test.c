/* The sensor passes the measurements of EMVA 1288; its random numbers have the right moments and
 * tails; raw pictures are the same bytes for any number of threads and on every machine. */
#include "sim/sensor/sensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 256, H = 128, N = W * H };

static float radiance_px[3 * N];
static uint16_t raw_px[2][3 * N];
static uint8_t display_px[3 * N];
static const struct run plain;

/* No fixed patterns and no rows: what EMVA calls temporal noise. */
static struct sensor quiet(void)
{
    struct sensor s = sensor_default;
    s.prnu = s.dsnu = s.row_noise = 0.0f;
    s.balance[0] = s.balance[1] = s.balance[2] = 1.0f;
    return s;
}

static void fill(float value)
{
    for (int i = 0; i < 3 * N; i++)
        radiance_px[i] = value;
}

static void shoot(const struct sensor *s, const struct sensor_shot *shot, uint16_t *px)
{
    struct image radiance = {W, H, 3, radiance_px};
    struct sensor_raw raw = {W, H, px};
    assert_int_equal(sensor_expose(&plain, s, shot, &radiance, &raw), OK);
}

struct moments {
    double mean, var; // DN; temporal variance, from the difference of two pictures
};

static struct moments measure(const struct sensor *s, double exposure, float gain)
{
    struct sensor_shot shot = {.exposure_s = exposure, .gain = gain, .seed = 3, .frame = 1};
    double sum = 0.0, diff = 0.0;
    shoot(s, &shot, raw_px[0]);
    shot.frame = 2;
    shoot(s, &shot, raw_px[1]);
    for (int i = 0; i < 3 * N; i++) {
        double a = raw_px[0][i], b = raw_px[1][i];
        sum += a + b;
        diff += (a - b) * (a - b);
    }
    return (struct moments){sum / (6.0 * N) - s->black, diff / (6.0 * N)};
}

static void test_photon_transfer(void **state)
{
    struct sensor s = quiet();
    (void)state;
    for (float gain = 1.0f; gain < 5.0f; gain *= 2.0f) {
        double x[8], y[8], sx = 0.0, sy = 0.0, sxx = 0.0, sxy = 0.0;
        for (int i = 0; i < 8; i++) {
            fill(0.07f / gain);
            struct moments m = measure(&s, 0.01 * (i + 1), gain);
            x[i] = m.mean;
            y[i] = m.var;
            sx += x[i];
            sy += y[i];
            sxx += x[i] * x[i];
            sxy += x[i] * y[i];
        }
        double slope = (8.0 * sxy - sx * sy) / (8.0 * sxx - sx * sx);
        assert_true(fabs(slope / (s.gain * gain) - 1.0) < 0.02);
    }
}

static void test_dark_noise(void **state)
{
    static const float read[] = {1.5f, 2.5f, 8.0f};
    (void)state;
    for (int i = 0; i < 3; i++) {
        struct sensor s = quiet();
        s.read_noise = read[i];
        s.dark_per_s = 0.0f;
        double want = s.gain * s.gain * read[i] * read[i] + 1.0 / 12.0;
        fill(0.0f);
        struct moments m = measure(&s, 0.01, 1.0f);
        assert_true(fabs(m.var / want - 1.0) < 0.03);
        assert_true(fabs(m.mean) < 0.02);
    }
}

static void test_dark_current(void **state)
{
    struct sensor s = quiet();
    (void)state;
    s.dark_per_s = 40.0f;
    fill(0.0f);
    assert_true(fabs(measure(&s, 10.0, 1.0f).mean / (400.0 * s.gain) - 1.0) < 0.01);
}

static void test_linear(void **state)
{
    struct sensor s = quiet();
    (void)state;
    fill(0.1f);
    for (double t = 0.0005; t < 0.09; t *= 1.7) { // 50 .. 9000 e-
        double want = s.gain * t * (0.1f * (double)s.electrons + s.dark_per_s);
        assert_true(fabs(measure(&s, t, 1.0f).mean / want - 1.0) < 0.005);
    }
}

static void test_saturation(void **state)
{
    struct sensor s = quiet();
    (void)state;
    s.read_noise = 0.0f;
    s.gain = 0.25f; // full well at 2500 of 3839
    fill(100.0f);
    struct moments m = measure(&s, 1.0, 1.0f);
    assert_true(fabs(m.mean - 2500.0) < 0.5 && m.var < 1e-9);
    m = measure(&s, 1.0, 4.0f);
    assert_true(fabs(m.mean - (4095.0 - s.black)) < 1e-9 && m.var < 1e-9);
    s.prnu = 0.1f;
    fill(INFINITY);
    assert_true(fabs(measure(&s, 1.0, 1.0f).mean - 2500.0) < 0.5);
    fill(NAN);
    assert_true(fabs(measure(&s, 1.0, 1.0f).mean) < 5.0);
}

static void test_snr(void **state)
{
    struct sensor s = quiet();
    static const double electrons[] = {20.0, 400.0, 8000.0};
    (void)state;
    s.dark_per_s = 0.0f;
    fill(0.1f);
    for (int i = 0; i < 3; i++) {
        double e = electrons[i];
        struct moments m = measure(&s, e / (0.1f * (double)s.electrons), 1.0f);
        double adc = 1.0 / 12.0 / (s.gain * s.gain);
        double want = e / sqrt(e + s.read_noise * s.read_noise + adc);
        assert_true(fabs(m.mean / sqrt(m.var) / want - 1.0) < 0.01);
    }
}

/* Means over many pictures show the unit's own patterns, and nothing else. */
static void test_fixed_patterns(void **state)
{
    struct sensor s = quiet();
    static double sum[2][3 * N];
    (void)state;
    s.prnu = 0.01f;
    s.dsnu = 20.0f;
    memset(sum, 0, sizeof sum);
    for (int k = 0; k < 16; k++) {
        struct sensor_shot shot = {
            .exposure_s = 0.005, .gain = 1.0f, .seed = 9, .frame = (uint64_t)k};
        fill(1.0f);
        shoot(&s, &shot, raw_px[0]);
        shot.frame += 100;
        fill(0.0f);
        shoot(&s, &shot, raw_px[1]);
        for (int i = 0; i < 3 * N; i++) {
            sum[0][i] += raw_px[0][i] / 16.0;
            sum[1][i] += raw_px[1][i] / 16.0;
        }
    }
    double var[2], mean[2];
    for (int k = 0; k < 2; k++) {
        double a = 0.0, b = 0.0;
        for (int i = 0; i < 3 * N; i++) {
            a += sum[k][i];
            b += sum[k][i] * sum[k][i];
        }
        mean[k] = a / (3 * N);
        var[k] = b / (3 * N) - mean[k] * mean[k];
    }
    double k2 = s.gain * s.gain, temporal = (k2 * 6.25 + 1.0 / 12.0) / 16.0;
    assert_true(fabs(sqrt((var[1] - temporal) / k2) / 20.0 - 1.0) < 0.02);
    double light = 5000.0, shot_var = (k2 * (light + 6.25) + 1.0 / 12.0) / 16.0;
    double prnu = sqrt((var[0] - shot_var) / k2 - 400.0) / light;
    assert_true(fabs(prnu / 0.01 - 1.0) < 0.05);
}

static void test_row_noise(void **state)
{
    struct sensor s = quiet();
    struct sensor_shot shot = {.exposure_s = 0.0, .gain = 1.0f, .seed = 4};
    double var = 0.0;
    (void)state;
    s.row_noise = 10.0f;
    s.read_noise = 1.0f;
    shoot(&s, &shot, raw_px[0]);
    for (int y = 0; y < 3 * H; y++) {
        double sum = 0.0;
        for (int x = 0; x < W; x++)
            sum += raw_px[0][y * W + x] - s.black;
        var += sum * sum / W / W / (3 * H);
    }
    assert_true(fabs(sqrt(var) / (10.0 * s.gain) - 1.0) < 0.15);
}

/* Ripple of 100 Hz is gone from an exposure of 10 ms and in full in one of 0.1 ms. */
static void test_flicker(void **state)
{
    struct sensor s = quiet();
    (void)state;
    s.flicker = 0.5f;
    s.flicker_hz = 100.0f;
    s.line_s = 0.01f / H; // one period over the picture
    for (int k = 0; k < 2; k++) {
        struct sensor_shot shot = {.exposure_s = k ? 1e-4 : 0.01, .gain = 1.0f, .seed = 5};
        double lo = 1e9, hi = 0.0;
        fill(k ? 50.0f : 0.5f);
        shoot(&s, &shot, raw_px[0]);
        for (int y = 0; y < H; y++) {
            double sum = 0.0;
            for (int x = 0; x < W; x++)
                sum += (raw_px[0][y * W + x] - s.black) / (s.gain * 5000.0 * W);
            lo = fmin(lo, sum);
            hi = fmax(hi, sum);
        }
        if (k == 0)
            assert_true(lo > 0.98 && hi < 1.02);
        else
            assert_true(fabs(lo - 0.5) < 0.03 && fabs(hi - 1.5) < 0.03);
    }
}

static void test_develop(void **state)
{
    static const float colour[3] = {0.5f, 0.02f, 0.2f};
    struct sensor s = sensor_default;
    struct sensor_shot shot = {.exposure_s = 0.008, .gain = 1.0f, .seed = 6};
    struct curve c;
    (void)state;
    curve_make(CURVE_SRGB, 0.0f, 0, &c);
    for (int cfa = SENSOR_RGB; cfa <= SENSOR_BGGR; cfa++) {
        s.cfa = (enum sensor_cfa)cfa;
        for (int i = 0; i < 3 * N; i++)
            radiance_px[i] = colour[i / N];
        shoot(&s, &shot, raw_px[0]);
        struct sensor_raw raw = {W, H, raw_px[0]};
        assert_int_equal(sensor_develop(&plain, &s, &shot, &c, &raw, display_px), OK);
        double white = (4095 - s.black) / (double)s.gain;
        for (int k = 0; k < 3; k++) {
            double sum = 0.0;
            for (int i = 0; i < N; i++)
                sum += display_px[3 * i + k];
            double want = 255.0 * curve_display(&c, (float)(colour[k] * 8000.0 / white));
            assert_true(fabs(sum / N - want) < 0.7);
        }
        fill(1000.0f);
        shoot(&s, &shot, raw_px[0]);
        assert_int_equal(sensor_develop(&plain, &s, &shot, &c, &raw, display_px), OK);
        for (int i = 0; i < 3 * N; i++)
            assert_int_equal(display_px[i], 255);
    }
}

/* A colour that rises linearly over the picture comes out of the mosaic unchanged inside. */
static void test_demosaic_is_linear(void **state)
{
    struct sensor s = quiet();
    struct sensor_shot shot = {.exposure_s = 0.01, .gain = 1.0f};
    struct curve c;
    static uint8_t full[3 * N];
    (void)state;
    s.read_noise = 0.0f;
    s.bits = 8; // white is the full well
    s.black = 0;
    s.gain = 255.0f / s.full_well;
    curve_make(CURVE_LINEAR, 0.0f, 0, &c);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            int site = (y & 1) + (x & 1);
            raw_px[1][y * W + x] = (uint16_t)(site * 20 + x / 2 + y / 2);
            for (int k = 0; k < 3; k++)
                full[3 * (y * W + x) + k] = (uint8_t)(k * 20 + x / 2 + y / 2);
        }
    for (int cfa = SENSOR_RGGB; cfa <= SENSOR_BGGR; cfa++) {
        s.cfa = (enum sensor_cfa)cfa;
        struct sensor_raw raw = {W, H, raw_px[1]};
        assert_int_equal(sensor_develop(&plain, &s, &shot, &c, &raw, display_px), OK);
        for (int i = 0; i < N; i++)
            for (int k = 0; k < 3; k++) {
                int from = cfa == SENSOR_RGGB ? k : 2 - k;
                assert_true(abs(display_px[3 * i + k] - full[3 * i + from]) <= 1);
            }
    }
}

static void test_refusals(void **state)
{
    struct sensor s = sensor_default;
    struct sensor_shot shot = {.exposure_s = 0.01, .gain = 1.0f};
    struct image radiance = {W, H, 3, radiance_px};
    struct sensor_raw raw = {W, H, raw_px[0]};
    (void)state;
    s.bits = 17;
    assert_int_equal(sensor_check(&s), ERR_ARG);
    assert_string_equal(err_text(), "sensor: bits is 17, must be 8..16");
    s = sensor_default;
    s.balance[2] = NAN;
    assert_int_equal(sensor_expose(&plain, &s, &shot, &radiance, &raw), ERR_ARG);
    s = sensor_default;
    shot.gain = 0.5f;
    assert_int_equal(sensor_expose(&plain, &s, &shot, &radiance, &raw), ERR_ARG);
    shot.gain = 1.0f;
    raw.w = W - 1;
    assert_int_equal(sensor_expose(&plain, &s, &shot, &radiance, &raw), ERR_ARG);
    s.cfa = SENSOR_RGGB;
    radiance.w = W - 1;
    assert_int_equal(sensor_expose(&plain, &s, &shot, &radiance, &raw), ERR_ARG);
    atomic_bool stop = true;
    struct run stopped = {.cancel = &stop};
    radiance.w = raw.w = W;
    assert_int_equal(sensor_expose(&stopped, &s, &shot, &radiance, &raw), ERR_CANCELLED);
}

/* ---- random numbers ---- */

static void test_normal(void **state)
{
    enum { M = 1 << 21 };
    static const double p[5] = {0.5, 0.158655254, 0.022750132, 0.001349898, 3.16712e-5};
    double m1 = 0.0, m2 = 0.0, m4 = 0.0, lag = 0.0, last = 0.0;
    int above[5] = {0};
    (void)state;
    for (int i = 0; i < M; i++) {
        double z = sensor_normal(11, (uint64_t)i);
        m1 += z;
        m2 += z * z;
        m4 += z * z * z * z;
        lag += z * last;
        last = z;
        for (int k = 0; k < 5; k++)
            above[k] += fabs(z) > k;
    }
    assert_true(fabs(m1 / M) < 0.003 && fabs(m2 / M - 1.0) < 0.005);
    assert_true(fabs(m4 / M - 3.0) < 0.04 && fabs(lag / M) < 0.003);
    for (int k = 1; k < 5; k++) {
        double want = 2.0 * p[k] * M;
        assert_true(fabs(above[k] - want) < 5.0 * sqrt(want));
    }
}

static void test_poisson(void **state)
{
    static const double mean[] = {1e-3, 0.3, 1.0, 5.0, 29.9, 30.1, 200.0, 1e5};
    enum { M = 200000 };
    (void)state;
    for (size_t k = 0; k < sizeof mean / sizeof mean[0]; k++) {
        double m = mean[k], sum = 0.0, sq = 0.0;
        int zero = 0;
        for (int i = 0; i < M; i++) {
            double v = sensor_poisson(k, (uint64_t)i, m);
            assert_true(v >= 0.0 && v == floor(v));
            sum += v;
            sq += (v - m) * (v - m);
            zero += v == 0.0;
        }
        assert_true(fabs(sum / M - m) < 5.0 * sqrt(m / M));
        double spread = sqrt((m + 2.0 * m * m) / M); // deviation of the variance
        assert_true(fabs(sq / M - m) < 5.0 * spread + (m >= 30.0 ? 1.0 / 12.0 : 0.0));
        assert_true(fabs(zero - M * exp(-m)) < 5.0 * sqrt(M * exp(-m)) + 1.0);
    }
    assert_true(sensor_poisson(1, 1, 0.0) == 0.0 && sensor_poisson(1, 1, -5.0) == 0.0);
    assert_true(sensor_poisson(1, 1, NAN) == 0.0 && isfinite(sensor_poisson(1, 1, INFINITY)));
}

static void test_uniform(void **state)
{
    enum { M = 1 << 18, BINS = 64 };
    int count[BINS] = {0};
    double chi = 0.0;
    (void)state;
    for (int i = 0; i < M; i++) // neighbouring keys are as good as neighbouring counters
        count[(int)(sensor_uniform((uint64_t)(i % 512), (uint64_t)(i / 512)) * BINS)]++;
    for (int i = 0; i < BINS; i++)
        chi += pow(count[i] - M / BINS, 2.0) / (M / BINS);
    assert_true(chi > 25.0 && chi < 120.0); // 63 +- 11
}

/* ---- the same bytes ---- */

static void ramp(void)
{
    for (int i = 0; i < 3 * N; i++)
        radiance_px[i] = (float)(i % W * (i / W % H)) * (1.0f / 32768.0f);
}

static void test_threads(void **state)
{
    struct pool *pool;
    struct sensor_shot shot = {.exposure_s = 0.02, .gain = 1.5f, .seed = 8, .frame = 4};
    struct image radiance = {W, H, 3, radiance_px};
    struct sensor_raw raw = {W, H, raw_px[1]};
    (void)state;
    ramp();
    shoot(&sensor_default, &shot, raw_px[0]);
    assert_int_equal(pool_open(&pool, 3), OK);
    struct run r = {.pool = pool};
    assert_int_equal(sensor_expose(&r, &sensor_default, &shot, &radiance, &raw), OK);
    pool_close(pool);
    assert_memory_equal(raw_px[0], raw_px[1], sizeof raw_px[0]);
    shot.frame++;
    shoot(&sensor_default, &shot, raw_px[1]);
    int same = 0;
    for (int i = 0; i < 3 * N; i++)
        same += raw_px[0][i] == raw_px[1][i] && raw_px[0][i] < 4095 && radiance_px[i] > 0.05f;
    assert_true(same < N / 10);
}

static void test_golden(void **state)
{
    static const uint64_t want[3] = {0xb10dfc95fc4eb095, 0x43bcbe764d16ca6a, 0x7263b428992358f1};
    struct sensor s = sensor_default;
    (void)state;
    ramp();
    for (int cfa = SENSOR_RGB; cfa <= SENSOR_BGGR; cfa++) {
        struct sensor_shot shot = {.exposure_s = 0.02, .gain = 1.0f, .seed = 1, .frame = 2};
        s.cfa = (enum sensor_cfa)cfa;
        shoot(&s, &shot, raw_px[0]);
        uint64_t h = 1469598103934665603u; // FNV-1a of 16-bit units
        for (int i = 0; i < (cfa ? N : 3 * N); i++)
            h = (h ^ raw_px[0][i]) * 1099511628211u;
        if (h != want[cfa])
            print_message("cfa %d: 0x%016llx\n", cfa, (unsigned long long)h);
        assert_true(h == want[cfa]);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_photon_transfer),
        cmocka_unit_test(test_dark_noise),
        cmocka_unit_test(test_dark_current),
        cmocka_unit_test(test_linear),
        cmocka_unit_test(test_saturation),
        cmocka_unit_test(test_snr),
        cmocka_unit_test(test_fixed_patterns),
        cmocka_unit_test(test_row_noise),
        cmocka_unit_test(test_flicker),
        cmocka_unit_test(test_develop),
        cmocka_unit_test(test_demosaic_is_linear),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_normal),
        cmocka_unit_test(test_poisson),
        cmocka_unit_test(test_uniform),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_golden),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
