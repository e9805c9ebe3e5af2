/* The sensor's simulation photographs scenes of several stops at known exposures; the ratio that
 * the pixels tell must be that of the exposures, the bounds must hold, and what cannot be told must
 * be said to be unknown. */
#include "core/photo/exposure_probe.h"

#include "sim/sensor/sensor.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 256, H = 192, N = W * H };

static const struct run plain;
static float radiance[3 * N];
static uint16_t numbers[3 * N], shown[3 * N];
static uint8_t display[3 * N];

/* Waves in log2 radiance of `stops` rms, a colour cast that changes over the picture. */
static void make_scene(float stops, uint64_t seed)
{
    static float f[N];
    double power = 0.0;
    memset(f, 0, sizeof f);
    for (uint64_t k = 0; k < 12; k++) {
        double angle = 6.2831853 * sensor_uniform(seed, 2 * k),
               phase = sensor_uniform(seed, 2 * k + 1);
        double waves = 0.7 * exp2(0.5 * (double)k), a = pow(waves, -0.7);
        power += 0.5 * a * a;
        for (int i = 0; i < N; i++)
            f[i] +=
                (float)(a * cos(6.2831853 *
                                (waves * (i % W * cos(angle) + i / W * sin(angle)) / W + phase)));
    }
    for (int i = 0; i < N; i++) {
        float l = f[i] / (float)sqrt(power) * stops;
        radiance[i] = exp2f(l + 0.8f * sinf(0.04f * (float)(i % W)));
        radiance[N + i] = exp2f(l);
        radiance[2 * N + i] = exp2f(l + 0.8f * cosf(0.05f * (float)(i / W)));
    }
}

static void expose(struct sensor *s, double t, uint64_t frame)
{
    struct sensor_shot shot = {.exposure_s = t, .gain = 1.0f, .seed = 7, .frame = frame};
    struct image im = {W, H, 3, radiance};
    struct sensor_raw raw = {W, H, numbers};
    s->electrons = s->full_well; // radiance 1 saturates in 1 s
    assert_int_equal(sensor_expose(&plain, s, &shot, &im, &raw), OK);
}

/* 12 bits; the other two orders by leaving a column out. */
static void take_raw(double t, uint64_t frame, enum raw_cfa cfa, struct exposure_probe *out)
{
    struct sensor s = sensor_default;
    bool shift = cfa == RAW_GRBG || cfa == RAW_GBRG;
    s.cfa = cfa == RAW_RGGB || cfa == RAW_GRBG ? SENSOR_RGGB : SENSOR_BGGR;
    expose(&s, t, frame);
    struct raw raw = {W, H, cfa, s.bits, s.black, true, numbers};
    if (shift) {
        raw.w = W - 2;
        raw.px = shown;
        for (int y = 0; y < H; y++)
            memcpy(shown + y * raw.w, numbers + y * W + 1, sizeof *shown * (size_t)raw.w);
    }
    exposure_probe_measure(&raw, NULL, out);
}

static void take_display(double t, uint64_t frame, const struct curve *c, const struct crf *crf,
                         struct exposure_probe *out)
{
    struct sensor s = sensor_default;
    struct sensor_shot shot = {.exposure_s = t, .gain = 1.0f};
    struct sensor_raw raw = {W, H, numbers};
    expose(&s, t, frame);
    assert_int_equal(sensor_develop(&plain, &s, &shot, c, &raw, display), OK);
    for (int i = 0; i < 3 * N; i++)
        shown[i] = display[i];
    exposure_probe_measure(&(struct raw){W, H, RAW_RGB, 8, 0, false, shown}, crf, out);
}

/* Error of a ratio whose true value is `stops`. */
static void check_ratio(const struct exposure_probe *a, const struct exposure_probe *b,
                        double stops, double tolerance)
{
    struct exposure_probe_ratio r, back;
    exposure_probe_compare(a, b, 0, &r);
    exposure_probe_compare(b, a, 0, &back);
    if (r.patches >= 10 && !(fabs(r.log2 - stops) <= tolerance))
        fail_msg("%.3f instead of %.1f stops by %d patches", (double)r.log2, stops, r.patches);
    if (!(r.lo <= stops && r.hi >= stops && back.lo <= -stops && back.hi >= -stops))
        fail_msg("%.1f stops outside %.3f..%.3f or %.3f..%.3f", stops, (double)r.lo, (double)r.hi,
                 (double)-back.hi, (double)-back.lo);
    assert_true(r.patches == back.patches && fabsf(r.log2 + back.log2) < 0.03f);
    assert_true(r.spread >= 0.0f && r.spread < 0.08f);
    assert_int_equal(a->good + a->dark + a->clipped, EXPOSURE_PROBE_PATCHES);
}

static void test_mosaics(void **state)
{
    struct exposure_probe a, b;
    int told = 0;
    (void)state;
    for (int stops = 0; stops <= 10; stops++) {
        make_scene(2.0f, (uint64_t)stops);
        enum raw_cfa cfa = RAW_RGGB + stops % 4;
        take_raw(0.1 * exp2(-0.5 * stops), 1, cfa, &a);
        take_raw(0.1 * exp2(0.5 * stops), 2, cfa, &b);
        check_ratio(&a, &b, stops, 0.02 + 0.004 * stops);
        struct exposure_probe_ratio r;
        exposure_probe_compare(&a, &b, 0, &r);
        told += r.patches >= 10;
        if (stops == 0)
            assert_true(r.patches > EXPOSURE_PROBE_PATCHES * 9 / 10);
        if (stops >= 8) // the bound alone says much
            assert_true(r.lo > (float)stops - 1.5f);
    }
    assert_true(told >= 8);
}

static void crf_of(const struct curve *c, struct crf *out)
{
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 256; i++)
            out->log2x[k][i] = log2f(fmaxf(curve_exposure(c, (float)i / 255.0f), 1e-6f));
}

static void test_curves_that_are_known(void **state)
{
    static const enum curve_family family[] = {CURVE_SRGB, CURVE_AGX, CURVE_FILMIC};
    static const float param[] = {0.0f, 11.0f, 0.5f};
    struct exposure_probe a, b;
    struct curve c;
    struct crf crf;
    (void)state;
    for (int stops = 0; stops <= 9; stops++) {
        int k = stops % 3;
        make_scene(2.0f, (uint64_t)stops + 20);
        curve_make(family[k], param[k], 0, &c);
        crf_of(&c, &crf);
        const struct crf *use = k ? &crf : NULL;
        take_display(0.1 * exp2(-0.5 * stops), 1, &c, use, &a);
        take_display(0.1 * exp2(0.5 * stops), 2, &c, use, &b);
        check_ratio(&a, &b, stops, 0.02 + 0.004 * stops);
    }
}

/* By five pictures of the scene, as a calibration does it. */
static void recover(const struct curve *c, struct crf *out)
{
    static uint8_t px[5][3 * N];
    static const double stops[5] = {0.0, 1.4, 3.2, 5.4, 8.0};
    double exposure[5];
    struct crf_stack s = {5, W, H, (const uint8_t *[]){px[0], px[1], px[2], px[3], px[4]},
                          exposure};
    struct exposure_probe unused;
    for (int i = 0; i < 5; i++) {
        exposure[i] = 0.05 * exp2(-stops[i]);
        take_display(exposure[i], 10 + (uint64_t)i, c, NULL, &unused);
        memcpy(px[i], display, sizeof display);
    }
    void *tmp = aligned_alloc(64, (crf_plan(&s) + 63) / 64 * 64);
    assert_non_null(tmp);
    assert_int_equal(crf_recover(CRF_DEBEVEC, &s, tmp, out), OK);
    free(tmp);
}

/* Log curves show single electrons: noise that cannot go below black looks like light, and spoils
 * the dark end of the curve that was recovered from it. */
static void test_log_curves_in_the_dark(void **state)
{
    struct exposure_probe a, b;
    struct curve c;
    struct crf crf;
    struct exposure_probe_ratio r;
    int told = 0;
    (void)state;
    make_scene(2.0f, 40);
    for (int param = 6; param <= 8; param++) {
        curve_make(CURVE_LOG, (float)param, 0, &c);
        recover(&c, &crf);
        for (int stops = 0; stops <= 8; stops++) {
            take_display(0.03 * exp2(-stops), 1, &c, &crf, &a);
            take_display(0.03, 2, &c, &crf, &b);
            exposure_probe_compare(&a, &b, 0, &r);
            bool right = r.lo <= (float)stops + 0.1f && r.hi >= (float)stops - 0.1f;
            if (r.patches >= 10 && !(fabsf(r.log2 - (float)stops) <= 0.1f && right))
                fail_msg("param %d: %.2f in %.2f..%.2f instead of %d stops by %d patches", param,
                         (double)r.log2, (double)r.lo, (double)r.hi, stops, r.patches);
            told += r.patches >= 10;
        }
    }
    assert_true(told >= 21);
}

/* A curve that was recovered from noise makes light of black. */
static void test_black_that_is_light(void **state)
{
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    struct curve c;
    struct crf crf;
    (void)state;
    make_scene(2.0f, 41);
    curve_make(CURVE_LOG, 8.0f, 0, &c);
    crf_of(&c, &crf);
    for (int i = 0; i < 3 * 24; i++) // as a calibration had it
        crf.log2x[i / 24][i % 24] = fmaxf(crf.log2x[i / 24][i % 24], -10.5f + 0.085f * (i % 24));
    take_display(0.06, 1, &c, &crf, &b);
    for (int stops = 4; stops <= 6; stops++) {
        take_display(0.06 * exp2(-stops), 2, &c, &crf, &a);
        exposure_probe_compare(&a, &b, 0, &r);
        if (!(r.patches >= 10 && fabsf(r.log2 - (float)stops) <= 0.1f))
            fail_msg("%.2f instead of %d stops by %d patches", (double)r.log2, stops, r.patches);
    }
}

/* sRGB is assumed: so far off may a ratio be, per stop. */
static void test_curves_that_are_not(void **state)
{
    static const struct {
        enum curve_family family;
        float param, wrong;
    } is[] = {{CURVE_GAMMA, 2.2f, 0.12f}, {CURVE_FILMIC, 0.5f, 0.5f}, {CURVE_AGX, 11.0f, 0.6f}};
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    struct curve c;
    (void)state;
    make_scene(1.5f, 3);
    for (int k = 0; k < 3; k++) {
        curve_make(is[k].family, is[k].param, 0, &c);
        take_display(0.1, 1, &c, NULL, &a);
        for (int stops = 0; stops <= 3; stops++) {
            take_display(0.1 * exp2(stops), 2, &c, NULL, &b);
            exposure_probe_compare(&a, &b, 0, &r);
            assert_true(fabsf(r.log2 - (float)stops) <= 0.02f + is[k].wrong * (float)stops);
        }
    }
}

/* ---- single patches ---- */

enum { FLAT = 128, FLATS = 3 * FLAT * FLAT };

static uint16_t flat_px[FLATS];

static struct raw flat(enum raw_cfa cfa, bool linear, int code)
{
    for (int i = 0; i < FLATS; i++)
        flat_px[i] = (uint16_t)code;
    return (struct raw){FLAT, FLAT, cfa, linear ? 10 : 8, linear ? 64 : 0, linear, flat_px};
}

static void test_states(void **state)
{
    static const struct {
        enum raw_cfa cfa;
        bool linear;
        int code, want;
    } cases[] = {
        {RAW_RGGB, true, 64, EXPOSURE_PROBE_DARK},
        {RAW_RGGB, true, 0, EXPOSURE_PROBE_DARK},
        {RAW_RGGB, true, 71, EXPOSURE_PROBE_DARK},
        {RAW_RGGB, true, 73, EXPOSURE_PROBE_GOOD},
        {RAW_GBRG, true, 900, EXPOSURE_PROBE_GOOD},
        {RAW_GBRG, true, 930, EXPOSURE_PROBE_CLIPPED},
        {RAW_MONO, true, 1023, EXPOSURE_PROBE_CLIPPED},
        {RAW_RGB, false, 7, EXPOSURE_PROBE_DARK},
        {RAW_RGB, false, 9, EXPOSURE_PROBE_GOOD},
        {RAW_RGB, false, 245, EXPOSURE_PROBE_GOOD},
        {RAW_RGB, false, 246, EXPOSURE_PROBE_CLIPPED},
        {RAW_MONO, false, 0, EXPOSURE_PROBE_DARK},
        {RAW_MONO, false, 255, EXPOSURE_PROBE_CLIPPED},
    };
    struct exposure_probe w;
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct raw r = flat(cases[i].cfa, cases[i].linear, cases[i].code);
        exposure_probe_measure(&r, NULL, &w);
        const int count[3] = {w.good, w.dark, w.clipped};
        assert_int_equal(count[cases[i].want], EXPOSURE_PROBE_PATCHES);
        for (int k = 0; k < EXPOSURE_PROBE_PATCHES; k++) {
            assert_int_equal(w.state[k], cases[i].want);
            assert_true(w.x[k] <= 1.0f && w.sd[k] >= 0.0f && w.sd[k] < 1.0f && w.floor[k] > 0.0f);
        }
    }
    struct raw r = flat(RAW_RGGB, true, 64 + 96);
    exposure_probe_measure(&r, NULL, &w);
    assert_true(fabsf(w.x[5] - 96.0f / 959.0f) < 1e-6f);
    r = flat(RAW_RGB, false, 188); // half of the light in sRGB
    exposure_probe_measure(&r, NULL, &w);
    assert_true(fabsf(w.x[5] - 0.5029f) < 1e-3f);
}

/* One wrong pixel of any colour, wherever in a block, clips its patch and no other. */
static void test_one_clipped_pixel(void **state)
{
    struct exposure_probe w;
    (void)state;
    for (int k = 0; k < FLATS; k += 577) {
        struct raw r = flat(RAW_RGB, false, 40);
        r.px[k] = 255;
        exposure_probe_measure(&r, NULL, &w);
        assert_int_equal(w.clipped, 1);
    }
    struct raw r = flat(RAW_BGGR, true, 200);
    r.px[65 * FLAT + 64] = 1023;
    exposure_probe_measure(&r, NULL, &w);
    assert_int_equal(w.clipped, 1);
}

/* Every colour counts the same, by its own sites. */
static void test_colours(void **state)
{
    struct exposure_probe w;
    (void)state;
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++)
        for (int strong = 0; strong < 3; strong++) {
            struct raw r = flat(cfa, true, 64 + 90);
            r.w = FLAT - 2; // blocks would begin at odd sites
            for (int i = 0; i < r.w * FLAT; i++)
                r.px[i] = raw_colour(cfa, i / r.w, i % r.w) == strong ? 64 + 480 : 64 + 90;
            exposure_probe_measure(&r, NULL, &w);
            for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
                assert_true(fabsf(w.x[i] - 660.0f / 3.0f / 959.0f) < 1e-6f);
        }
    const enum raw_cfa first[4] = {RAW_RGGB, RAW_GRBG, RAW_GBRG, RAW_BGGR};
    for (int k = 0; k < 4; k++) // red is where the order says
        assert_int_equal(raw_colour(first[k], k / 2, k % 2), 0);
}

static void test_small_pictures(void **state)
{
    static const int sizes[][2] = {{1, 1}, {2, 2}, {2, 300}, {14, 14}, {31, 33}, {300, 2}};
    struct exposure_probe a;
    struct exposure_probe_ratio r;
    (void)state;
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++)
        for (enum raw_cfa cfa = RAW_MONO; cfa <= RAW_GBRG; cfa++) {
            int w = sizes[i][0], h = sizes[i][1];
            if (cfa >= RAW_RGGB && (w % 2 || h % 2))
                continue;
            size_t n = (size_t)w * (size_t)h * (cfa == RAW_RGB ? 3 : 1);
            uint16_t *px = malloc(n * sizeof *px); // alone: reads beyond its end are found
            assert_non_null(px);
            for (size_t k = 0; k < n; k++)
                px[k] = 100;
            exposure_probe_measure(&(struct raw){w, h, cfa, 8, 0, false, px}, NULL, &a);
            free(px);
            assert_int_equal(a.good, EXPOSURE_PROBE_PATCHES);
            exposure_probe_compare(&a, &a, 0, &r);
            bool enough = w * h >= 6 * 16; // blocks that share no pixel
            assert_true(r.patches == (enough ? EXPOSURE_PROBE_PATCHES : 0) && r.log2 == 0.0f);
            assert_true(r.spread == 0.0f && r.band == 0.0f);
        }
}

/* ---- scenes that say little or change ---- */

static void test_nothing_to_see(void **state)
{
    struct exposure_probe dark, bright, good;
    struct exposure_probe_ratio r;
    (void)state;
    make_scene(1.0f, 5);
    take_raw(1e-7, 1, RAW_RGGB, &dark);
    take_raw(1e3, 2, RAW_RGGB, &bright);
    take_raw(0.1, 3, RAW_RGGB, &good);
    assert_true(dark.dark == EXPOSURE_PROBE_PATCHES && bright.clipped == EXPOSURE_PROBE_PATCHES);
    exposure_probe_compare(&dark, &bright, 0, &r);
    assert_true(r.patches == 0 && r.log2 == 0.0f && r.spread == 0.0f && r.lo > 6.0f);
    assert_true(isinf(r.hi));
    exposure_probe_compare(&dark, &dark, 0, &r);
    assert_true(r.patches == 0 && isinf(r.lo) && isinf(r.hi));
    exposure_probe_compare(&good, &dark, 0, &r); // truth: -20
    assert_true(r.hi >= -20.0f && r.hi < -5.0f && isinf(r.lo));
    exposure_probe_compare(&bright, &good, 0, &r); // truth: -13
    assert_true(r.hi >= -13.3f && r.hi < 0.0f && isinf(r.lo));
}

/* Somebody dark stands in a share of the picture. */
static void stand_in(double share)
{
    for (int i = 0; i < 3 * N; i++)
        if (i % W < share * W)
            radiance[i] *= 1.0f / 64;
}

/* Somebody leaves between two frames: what moved is counted at one exposure, and makes the bounds
 * of others right. */
static void test_passer(void **state)
{
    static const double share[] = {0.1, 0.2, 0.3};
    struct exposure_probe a, b, longer;
    struct exposure_probe_ratio r;
    (void)state;
    for (int k = 0; k < 3; k++) {
        make_scene(1.0f, 6);
        take_raw(0.02, 1, RAW_RGGB, &b);
        take_raw(2.0, 2, RAW_RGGB, &longer);
        exposure_probe_compare(&b, &b, 0, &r);
        assert_true(r.moved == 0.0f);
        stand_in(share[k]);
        take_raw(0.02, 3, RAW_RGGB, &a);
        exposure_probe_compare(&a, &b, 0, &r);
        assert_true(fabsf(r.moved - (float)share[k]) < 0.05f && fabsf(r.log2) < 0.02f);
        const float moved = r.moved;
        exposure_probe_compare(&a, &longer, 0, &r);
        assert_true(r.lo > log2f(100) + 0.3f && isinf(r.hi));
        exposure_probe_compare(&a, &longer, moved, &r);
        assert_true(r.lo <= log2f(100) && r.lo > 3);
    }
}

/* What is bright in the first frame is dark in the second, and the other way round. */
static void test_bounds_that_contradict(void **state)
{
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    (void)state;
    make_scene(1.0f, 6);
    stand_in(0.1);
    take_raw(0.02, 1, RAW_RGGB, &a);
    make_scene(1.0f, 6);
    for (int i = 0; i < 3 * N; i++)
        radiance[i] *= i % W > 0.9 * W ? 1e-6f : 1.0f;
    take_raw(2.0, 2, RAW_RGGB, &b);
    exposure_probe_compare(&a, &b, 0, &r);
    assert_true(r.lo <= log2f(100) && r.hi >= log2f(100));
}

/* A lamp lights a share of the picture by 3 stops between two frames. */
static void test_lamp(void **state)
{
    static const double share[] = {0.2, 0.4, 0.6};
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    (void)state;
    for (int k = 0; k < 3; k++) {
        make_scene(1.0f, 6);
        take_raw(0.02, 1, RAW_RGGB, &a);
        for (int i = 0; i < 3 * N; i++)
            if (i % W < share[k] * W)
                radiance[i] *= 8.0f;
        take_raw(0.04, 2, RAW_RGGB, &b);
        exposure_probe_compare(&a, &b, 0, &r);
        if (k == 0)
            assert_true(fabsf(r.log2 - 1.0f) < 0.05f); // the median does not mind
        else
            assert_true(r.spread > 1.0f);
    }
}

/* ---- small and noisy pictures ---- */

enum { SMALL = 56 };

/* A corner of the scene by a sensor of so many electrons; rows 0..torn-1 are exposed torn_s. */
static void take_small(double t, double torn_s, int torn, float well, uint64_t frame,
                       struct exposure_probe *out)
{
    static uint16_t px[SMALL * SMALL];
    struct sensor s = sensor_default;
    s.cfa = SENSOR_RGGB;
    s.gain *= s.full_well / well;
    s.full_well = well;
    for (int k = 0; k < 2; k++) {
        expose(&s, k ? torn_s : t, 2 * frame + (uint64_t)k);
        for (int y = 0; y < (k ? torn : SMALL); y++)
            memcpy(px + y * SMALL, numbers + y * W, SMALL * sizeof *px);
    }
    exposure_probe_measure(&(struct raw){SMALL, SMALL, RAW_RGGB, s.bits, s.black, true, px}, NULL,
                           out);
}

/* Where half of the patches are dark, noise must not choose which of them count. */
static void test_near_the_dark_limit(void **state)
{
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    double worst = 0.0;
    (void)state;
    for (uint64_t k = 0; k < 40; k++) {
        double stops = (double)(k % 5), sum = 0.0, n = 0.0;
        make_scene(0.5f, k + 50);
        for (uint64_t i = 0; i < 8; i++) {
            take_small(0.04 * exp2(-stops), 1.0, 0, 1000.0f, 4 * i, &a);
            take_small(0.04, 1.0, 0, 1000.0f, 4 * i + 2, &b);
            exposure_probe_compare(&b, &a, 0, &r);
            sum += r.patches > 5 ? (double)r.log2 + stops : 0.0;
            n += r.patches > 5;
            if (r.patches > 5 && fabs((double)r.log2 + stops) > 5.0 * (double)r.error + 0.01)
                fail_msg("%.3f instead of %.0f stops, error %.3f", (double)r.log2, -stops,
                         (double)r.error);
        }
        worst = n > 4.0 ? fmax(worst, fabs(sum / n)) : worst;
    }
    print_message("mean of 8 ratios off by %.3f stops at most\n", worst);
    assert_true(worst < 0.05);
}

static void test_torn_rows(void **state)
{
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    (void)state;
    for (uint64_t k = 0; k < 60; k++) {
        double stops = -(double)(k % 4), other = stops + (k % 2 ? 1.0 : -1.0); // nothing clips
        int rows = 4 + (int)(k % 22);
        make_scene(1.0f, k + 100);
        take_small(0.1, 1.0, 0, 10000.0f, 1, &a);
        take_small(0.1 * exp2(stops), 1.0, 0, 10000.0f, 2, &b);
        exposure_probe_compare(&a, &b, 0, &r);
        assert_true(r.band < 0.05f);
        take_small(0.1 * exp2(stops), 0.1 * exp2(other), rows, 10000.0f, 2, &b);
        exposure_probe_compare(&a, &b, 0, &r);
        if (r.patches > 100 && !(r.band > 0.1f || r.spread > 0.2f))
            fail_msg("%d rows of %.0f stops among %.0f: %.3f", rows, other, stops, (double)r.band);
    }
}

/* Bounds bear 2 % of wrong patches, not 6 %. */
static void test_wrong_patches(void **state)
{
    struct exposure_probe a, b;
    struct exposure_probe_ratio r;
    (void)state;
    make_scene(1.0f, 7);
    take_raw(0.02, 1, RAW_RGGB, &a);
    take_raw(2.0, 2, RAW_RGGB, &b);
    for (int wrong = 0; wrong <= 60; wrong += 20) {
        struct exposure_probe x = a;
        for (int i = 0; i < wrong; i++) {
            x.floor[17 * i] = 1e-6f;
            x.sd[17 * i] = 0.0f;
            x.state[17 * i] = EXPOSURE_PROBE_DARK;
            b.state[17 * i] = EXPOSURE_PROBE_CLIPPED;
        }
        exposure_probe_compare(&x, &b, 0, &r);
        assert_true(wrong <= 20 ? r.lo < 6.7f && r.lo > 4.0f : r.lo > 10.0f);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_mosaics),
        cmocka_unit_test(test_curves_that_are_known),
        cmocka_unit_test(test_log_curves_in_the_dark),
        cmocka_unit_test(test_black_that_is_light),
        cmocka_unit_test(test_curves_that_are_not),
        cmocka_unit_test(test_states),
        cmocka_unit_test(test_one_clipped_pixel),
        cmocka_unit_test(test_colours),
        cmocka_unit_test(test_small_pictures),
        cmocka_unit_test(test_nothing_to_see),
        cmocka_unit_test(test_passer),
        cmocka_unit_test(test_bounds_that_contradict),
        cmocka_unit_test(test_lamp),
        cmocka_unit_test(test_near_the_dark_limit),
        cmocka_unit_test(test_torn_rows),
        cmocka_unit_test(test_wrong_patches),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
