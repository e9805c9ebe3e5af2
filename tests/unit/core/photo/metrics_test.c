/* Against numpy and scipy on hashed noise; the same noise in Python:
 *     def noise(n, seed):
 *         h = (numpy.arange(n, dtype=uint64) * 2654435761 + seed) % 2**32
 *         h ^= h >> 15; h = h * 2246822519 % 2**32; h ^= h >> 13
 *         return ((h >> 8) / 2**24).astype(float32)
 * a = noise(3*h*w, 1), b = a + float32(mix) * (noise(3*h*w, 2) - a). PSNR is -10 log10(mean((a -
 * b)^2)). SSIM: g = exp(-(arange(-5, 6) / 1.5)^2 / 2) / sum, f = scipy.ndimage.correlate1d with g
 * along both axes cropped by 5 px, then the formula in the head of metrics.c on f(a), f(b), f(a a),
 * f(b b), f(a b), mean. Quantiles: numpy.quantile of 4 noise(1000, 3) - 2 rounded to float32. */
#include "core/photo/metrics.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

enum { PX_MAX = 3 * 64 * 64 };

static float noise(uint32_t i, uint32_t seed)
{
    uint32_t h = i * 2654435761u + seed;
    h ^= h >> 15;
    h *= 2246822519u;
    h ^= h >> 13;
    return (float)(h >> 8) / 16777216.0f;
}

static float px_a[PX_MAX], px_b[PX_MAX];

static void make_pair(int w, int h, float mix, struct image *a, struct image *b)
{
    for (int i = 0; i < 3 * w * h; i++) {
        px_a[i] = noise((uint32_t)i, 1);
        float d = noise((uint32_t)i, 2) - px_a[i];
        d *= mix;
        px_b[i] = px_a[i] + d;
    }
    *a = (struct image){w, h, 3, px_a};
    *b = (struct image){w, h, 3, px_b};
}

static void close_to(double got, double want, double bound)
{
    if (!(fabs(got - want) <= bound))
        fail_msg("%.12f is not within %g of %.12f", got, bound, want);
}

static void equal_to_scipy(void **state)
{
    (void)state;
    static const struct {
        int w, h;
        float mix;
        double psnr, ssim;
    } cases[] = {
        {33, 40, 0.25f, 18.255550074859, 0.873002947056},
        {33, 40, 1.0f, 6.214350238364, -0.411785460438},
        {11, 11, 0.25f, 18.456158871650, 0.871901348790},
        {11, 11, 1.0f, 6.414959095706, -0.546755400071},
        {60, 11, 0.25f, 18.272885872110, 0.872030178642},
        {60, 11, 1.0f, 6.231686007452, -0.411311393163},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct image a, b;
        struct arena tmp;
        double v;
        make_pair(cases[i].w, cases[i].h, cases[i].mix, &a, &b);
        assert_int_equal(metrics_psnr(&a, &b, NULL, &v), OK);
        close_to(v, cases[i].psnr, 1e-9);
        assert_int_equal(arena_init(&tmp, "tmp", metrics_ssim_plan(a.w)), OK);
        assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), OK);
        close_to(v, cases[i].ssim, 1e-9);
        assert_int_equal(tmp.used, 0);
        arena_free(&tmp);
    }
}

static void identical_images(void **state)
{
    (void)state;
    struct image a, b;
    struct arena tmp;
    double v;
    make_pair(20, 20, 0.0f, &a, &b);
    assert_int_equal(metrics_psnr(&a, &b, NULL, &v), OK);
    assert_true(v == METRICS_PSNR_MAX);
    assert_int_equal(arena_init(&tmp, "tmp", metrics_ssim_plan(20)), OK);
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), OK);
    close_to(v, 1.0, 1e-12);
    memset(px_a, 0, sizeof px_a); // flat black: 0 / 0 without the constants
    memset(px_b, 0, sizeof px_b);
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), OK);
    close_to(v, 1.0, 1e-12);
    arena_free(&tmp);
}

/* Pixels that do not count change nothing; the others are the mean. */
static void only_seen_pixels_count(void **state)
{
    (void)state;
    struct image a, b;
    struct arena tmp;
    static uint8_t seen[20 * 20];
    double all, v, ssim;
    make_pair(20, 20, 0.5f, &a, &b);
    assert_int_equal(arena_init(&tmp, "tmp", metrics_ssim_plan(20)), OK);
    memset(seen, 1, sizeof seen);
    assert_int_equal(metrics_psnr(&a, &b, NULL, &all), OK);
    assert_int_equal(metrics_psnr(&a, &b, seen, &v), OK);
    assert_true(v == all);
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &all), OK);
    assert_int_equal(metrics_ssim(&a, &b, seen, &tmp, &v), OK);
    assert_true(v == all);
    memset(seen, 0, sizeof seen);
    seen[7 * 20 + 9] = 1;
    for (int c = 0; c < 3; c++)
        px_b[c * 400 + 7 * 20 + 9] = px_a[c * 400 + 7 * 20 + 9] + 0.1f;
    assert_int_equal(metrics_psnr(&a, &b, seen, &v), OK);
    close_to(v, 20, 1e-4);
    assert_int_equal(metrics_ssim(&a, &b, seen, &tmp, &ssim), OK);
    px_b[19] += 1; // no window around the pixel reaches so far
    assert_int_equal(metrics_psnr(&a, &b, seen, &v), OK);
    close_to(v, 20, 1e-4);
    assert_int_equal(metrics_ssim(&a, &b, seen, &tmp, &v), OK);
    assert_true(v == ssim);
    seen[7 * 20 + 9] = 0;
    assert_int_equal(metrics_psnr(&a, &b, seen, &v), ERR_ARG);
    assert_int_equal(metrics_ssim(&a, &b, seen, &tmp, &v), ERR_ARG);
    assert_int_equal(tmp.used, 0);
    arena_free(&tmp);
}

static void pairs_are_refused(void **state)
{
    (void)state;
    struct image a, b;
    struct arena tmp;
    double v;
    make_pair(20, 20, 0.5f, &a, &b);
    assert_int_equal(arena_init(&tmp, "tmp", metrics_ssim_plan(20)), OK);
    px_b[2 * 400 + 3 * 20 + 5] = NAN;
    assert_int_equal(metrics_psnr(&a, &b, NULL, &v), ERR_ARG);
    assert_non_null(strstr(err_text(), "channel 2, row 3, column 5"));
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), ERR_ARG);
    px_b[2 * 400 + 3 * 20 + 5] = 0.0f;
    px_a[0] = -INFINITY;
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), ERR_ARG);
    px_a[0] = 0.0f;
    b.w = 19;
    assert_int_equal(metrics_psnr(&a, &b, NULL, &v), ERR_ARG);
    a.w = b.w = 10;
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), ERR_ARG);
    assert_non_null(strstr(err_text(), "11 x 11"));
    a.w = b.w = 20;
    a.h = b.h = 10;
    assert_int_equal(metrics_ssim(&a, &b, NULL, &tmp, &v), ERR_ARG);
    arena_free(&tmp);
}

static void quantiles_equal_numpy(void **state)
{
    (void)state;
    static const struct {
        double q, want;
    } cases[] = {
        {0, -1.990471601486},   {0.001, -1.989304518700}, {0.37, -0.582724010944},
        {0.5, -0.023780226707}, {0.99, 1.948715500832},   {0.9999, 1.997502495098},
        {1, 1.998432636261},
    };
    static float values[1000];
    double v;
    for (uint32_t i = 0; i < 1000; i++)
        values[i] = noise(i, 3) * 4.0f - 2.0f;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        assert_int_equal(metrics_quantile(values, 1000, cases[i].q, &v), OK);
        close_to(v, cases[i].want, 1e-9);
    }
}

/* Ranks and neighbours by hand: equal values, both signs, one value. */
static void quantiles_of_small_sets(void **state)
{
    (void)state;
    const float v[5] = {3.0f, -1.0f, 3.0f, -0.0f, -1e-30f};
    static const double want[5] = {-1.0, -1e-30f, 0.0, 3.0, 3.0};
    double q;
    for (int i = 0; i < 5; i++) {
        assert_int_equal(metrics_quantile(v, 5, i / 4.0, &q), OK);
        assert_true(q == want[i]);
    }
    assert_int_equal(metrics_quantile(v, 5, 0.625, &q), OK);
    close_to(q, 1.5, 1e-12);
    assert_int_equal(metrics_quantile(v, 1, 0.7, &q), OK);
    assert_true(q == 3.0);
}

static void quantiles_are_refused(void **state)
{
    (void)state;
    float v[2] = {0.0f, NAN};
    double q;
    assert_int_equal(metrics_quantile(v, 2, 0.5, &q), ERR_ARG);
    v[1] = INFINITY;
    assert_int_equal(metrics_quantile(v, 2, 0.5, &q), ERR_ARG);
    v[1] = 0.0f;
    assert_int_equal(metrics_quantile(v, 0, 0.5, &q), ERR_ARG);
    assert_int_equal(metrics_quantile(v, 2, 1.01, &q), ERR_ARG);
    assert_int_equal(metrics_quantile(v, 2, NAN, &q), ERR_ARG);
}

static void mu_law_values(void **state)
{
    (void)state;
    float in[7] = {0.0f, 2.0f, 0.002f, 5.0f, -1.0f, NAN, INFINITY}, px[7];
    static const double want[7] = {0.0, 1.0, 0.210364774, 1.0,
                                   0.0, 0.0, 1.0}; // [2] = ln 6 / ln 5001
    struct image hdr = {7, 1, 1, in}, out = {.px = px};
    assert_int_equal(metrics_mu_law(&hdr, 2.0, &out), OK);
    assert_true(out.w == 7 && out.h == 1 && out.channels == 1);
    for (int i = 0; i < 7; i++)
        close_to(px[i], want[i], 1e-6);
    in[2] = 0.5e-6f;
    assert_int_equal(metrics_mu_law(&hdr, 0.0, &hdr), OK); // scale counts as 1e-6; in place
    close_to(in[2], 0.918643, 1e-5);                       // ln 2501 / ln 5001
    assert_int_equal(metrics_mu_law(&hdr, NAN, &out), ERR_ARG);
}

static void radiance_in_stops(void **state)
{
    (void)state;
    static float room[PX_MAX];
    struct image a, b;
    double stops;
    make_pair(20, 20, 0, &a, &b);
    for (int i = 0; i < 1200; i++) { // a third a stop brighter, a third darker, all thrice
        px_b[i] += 0.1f;
        px_a[i] = 3 * px_b[i] * exp2f((float)(i % 3 - 1));
    }
    assert_int_equal(metrics_stops(&a, &b, NULL, 0.01, room, &stops), OK);
    assert_true(fabs(stops - sqrt(2.0 / 3)) < 1e-5);
    px_a[0] = 0; // as if `least`
    px_b[2] = 0; // does not count
    assert_int_equal(metrics_stops(&a, &b, NULL, 0.01, room, &stops), OK);
    const double off = log2(0.01 / (double)px_b[0]) - log2(3);
    assert_true(fabs(stops - sqrt((798 + off * off) / 1199)) < 1e-3);
    assert_int_equal(metrics_stops(&a, &b, NULL, 2, room, &stops), OK);
    assert_true(isnan(stops)); // no value counts
    uint8_t seen[400] = {0};
    seen[7] = 1; // its colours are a stop apart: 7, 407, 807
    assert_int_equal(metrics_stops(&a, &b, seen, 0.01, room, &stops), OK);
    assert_true(fabs(stops - sqrt(2.0 / 3)) < 1e-5);
    px_a[3] = NAN;
    assert_int_equal(metrics_stops(&a, &b, NULL, 0.01, room, &stops), ERR_ARG);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(equal_to_scipy),         cmocka_unit_test(identical_images),
        cmocka_unit_test(only_seen_pixels_count), cmocka_unit_test(pairs_are_refused),
        cmocka_unit_test(quantiles_equal_numpy),  cmocka_unit_test(quantiles_of_small_sets),
        cmocka_unit_test(quantiles_are_refused),  cmocka_unit_test(mu_law_values),
        cmocka_unit_test(radiance_in_stops),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
