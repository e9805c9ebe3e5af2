/* Demosaicing against the picture that the mosaic was taken from and against bilinear means; codes
 * of sRGB against its formula. */
#include "core/photo/develop.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 300, H = 90, N = W * H };

struct picture {
    enum raw_cfa cfa;
    int w, h;
    float truth[3][N], got[3][N], bilinear[3][N];
};

static struct picture pic;

static float site(const struct picture *p, int y, int x)
{
    return p->truth[raw_colour(p->cfa, y, x)][y * p->w + x];
}

static void read_sites(const void *ctx, int y, int x, int n, float *v)
{
    const struct picture *p = ctx;
    assert_true(y >= 0 && y < p->h && x >= 0 && x + n <= p->w);
    for (int i = 0; i < n; i++)
        v[i] = site(p, y, x + i);
}

static void write_pixels(const void *ctx, int y, int x, int n, float *const rgb[3])
{
    struct picture *p = &pic;
    assert_ptr_equal(ctx, p);
    for (int c = 0; c < 3; c++)
        memcpy(p->got[c] + y * p->w + x, rgb[c], sizeof(float) * (size_t)n);
}

static void demosaic(int begin, int end)
{
    struct develop_mosaic m = {pic.cfa, pic.w, pic.h, &pic, read_sites, write_pixels};
    develop_rows(&m, begin, end);
}

/* Mean of the sites of colour c that are nearest among 3 x 3. */
static float nearest(int c, int y0, int x0)
{
    float sum[3] = {0.0f}, n[3] = {0.0f}; // by squared distance
    for (int k = 0; k < 9; k++) {
        int dy = k / 3 - 1, dx = k % 3 - 1, y = y0 + dy, x = x0 + dx, d = dy * dy + dx * dx;
        bool counts = y >= 0 && y < pic.h && x >= 0 && x < pic.w;
        if (counts && raw_colour(pic.cfa, y, x) == c) {
            sum[d] += site(&pic, y, x);
            n[d] += 1.0f;
        }
    }
    int d = n[0] > 0.0f ? 0 : n[1] > 0.0f ? 1 : 2;
    return sum[d] / n[d];
}

static void demosaic_bilinear(void)
{
    for (int i = 0; i < pic.w * pic.h; i++)
        for (int c = 0; c < 3; c++)
            pic.bilinear[c][i] = nearest(c, i / pic.w, i % pic.w);
}

static double psnr(float (*got)[N])
{
    double sum = 0.0;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < pic.w * pic.h; i++)
            sum += pow(got[c][i] - pic.truth[c][i], 2.0);
    return -10.0 * log10(sum / (3.0 * pic.w * pic.h));
}

static void make(enum raw_cfa cfa, int w, int h, float (*f)(int c, float x, float y))
{
    pic.cfa = cfa;
    pic.w = w;
    pic.h = h;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < w * h; i++)
            pic.truth[c][i] = f(c, (float)(i % w), (float)(i / w));
    memset(pic.got, 0xFF, sizeof pic.got); // NaN
}

static const float tint[3] = {0.8f, 1.0f, 0.6f};

static float smooth(int c, float x, float y)
{
    return tint[c] * (0.5f + 0.25f * sinf(0.7f * x + 0.2f * y) + 0.2f * cosf(0.5f * y - 0.1f * x));
}

/* A slanted edge, soft over about a pixel, of light: the hue is the same on both sides. */
static float edge(int c, float x, float y)
{
    float d = 0.9f * (x - 150.0f) + 0.43f * (y - 45.0f);
    return tint[c] * (0.1f + 0.8f / (1.0f + expf(-2.5f * d)));
}

static float flat(int c, float x, float y)
{
    (void)x;
    (void)y;
    return 0.3f + 0.2f * (float)c;
}

static float plane(int c, float x, float y)
{
    (void)c;
    return 0.1f + 0.001f * x + 0.002f * y;
}

static void test_better_than_bilinear(void **state)
{
    (void)state;
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++)
        for (int k = 0; k < 2; k++) {
            make(cfa, W, H, k ? edge : smooth);
            demosaic(0, H);
            demosaic_bilinear();
            double ours = psnr(pic.got), plain = psnr(pic.bilinear);
            if (cfa == RAW_RGGB)
                print_message("%s: %.1f dB, bilinear %.1f\n", k ? "edge" : "smooth", ours, plain);
            assert_true(ours > plain + 3.0 && ours > 30.0);
        }
}

/* Flat colours are exact everywhere, planes of grey but at the border, in any size. */
static void test_exact(void **state)
{
    static const int sizes[][2] = {{2, 2}, {2, 6}, {6, 2}, {4, 4}, {256, 4}, {258, 6}, {262, 2}};
    (void)state;
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++)
        for (size_t k = 0; k < sizeof sizes / sizeof sizes[0]; k++) {
            make(cfa, sizes[k][0], sizes[k][1], flat);
            demosaic(0, pic.h);
            assert_true(psnr(pic.got) > 120.0);
        }
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++) {
        make(cfa, W, H, plane);
        demosaic(0, H);
        for (int i = 0; i < 3 * N; i++) {
            int x = i % N % W, y = i % N / W;
            float wrong = fabsf(pic.got[i / N][i % N] - pic.truth[i / N][i % N]);
            bool inside = x >= 2 && x < W - 2 && y >= 2 && y < H - 2;
            assert_true(wrong < (inside ? 1e-6f : 0.006f));
        }
    }
}

static void test_pieces_of_rows(void **state)
{
    static float whole[3][N];
    (void)state;
    make(RAW_GRBG, W, H, smooth);
    demosaic(0, H);
    memcpy(whole, pic.got, sizeof whole);
    memset(pic.got, 0xFF, sizeof pic.got);
    for (int y = 0; y < H; y += 7)
        demosaic(y, y + 7 < H ? y + 7 : H);
    assert_memory_equal(whole, pic.got, sizeof whole);
    demosaic(5, 5);
}

/* ---- pictures ---- */

static uint16_t px[3 * 4096];
static uint8_t shown[3 * 4096];

static double srgb(double v)
{
    v = fmin(fmax(v, 0.0), 1.0);
    return 255.0 * (v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055);
}

static void test_codes(void **state)
{
    const struct develop none = {1.0f, 1.0f};
    struct raw in = {64, 64, RAW_MONO, 12, 256, true, px};
    (void)state;
    for (int i = 0; i < 4096; i++)
        px[i] = (uint16_t)i;
    develop_run(&in, &none, shown);
    for (int i = 0; i < 4096; i++) {
        double want = srgb((i - 256) / 3839.0);
        for (int c = 0; c < 3; c++)
            assert_true(fabs(shown[3 * i + c] - want) < 0.55);
    }
    assert_true(shown[3 * 4095] == 255 && shown[3 * 256] == 0);
    in = (struct raw){64, 64, RAW_MONO, 8, 0, false, px};
    for (int i = 0; i < 4096; i++)
        px[i] = (uint16_t)(i % 256);
    develop_run(&in, &none, shown);
    for (int i = 0; i < 3 * 4096; i++)
        assert_int_equal(shown[i], i / 3 % 256);
    in = (struct raw){64, 21, RAW_RGB, 8, 0, false, px};
    develop_run(&in, &(struct develop){2.0f, 3.0f}, shown); // passes as it is
    for (int i = 0; i < 64 * 21 * 3; i++)
        assert_int_equal(shown[i], i % 256);
    in = (struct raw){64, 21, RAW_RGB, 8, 0, true, px};
    develop_run(&in, &(struct develop){2.0f, 1.0f}, shown);
    assert_true(fabs(shown[3] - srgb(2.0 * 3 / 255.0)) < 0.55); // red
    assert_true(fabs(shown[4] - srgb(4 / 255.0)) < 0.55);
}

static struct raw mosaic(enum raw_cfa cfa, const int code[3])
{
    for (int i = 0; i < 4096; i++)
        px[i] = (uint16_t)code[raw_colour(cfa, i / 64, i % 64)];
    return (struct raw){64, 64, cfa, 10, 64, true, px};
}

static void test_colours(void **state)
{
    static const struct develop how[] = {{1.0f, 1.0f}, {2.0f, 1.5f}, {0.5f, 3.0f}};
    (void)state;
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++)
        for (int k = 0; k < 3; k++) {
            struct raw in = mosaic(cfa, (const int[3]){164, 264, 114});
            float least = fminf(1.0f, fminf(how[k].red, how[k].blue));
            const double want[3] = {srgb(100.0 / 959.0 * how[k].red / least),
                                    srgb(200.0 / 959.0 / least),
                                    srgb(50.0 / 959.0 * how[k].blue / least)};
            develop_run(&in, &how[k], shown);
            for (int i = 0; i < 3 * 4096; i++)
                assert_true(fabs(shown[i] - want[i % 3]) < 0.55);
            in = mosaic(cfa, (const int[3]){1023, 1023, 1023});
            develop_run(&in, &how[k], shown);
            for (int i = 0; i < 3 * 4096; i++)
                assert_int_equal(shown[i], 255);
            in = mosaic(cfa, (const int[3]){0, 60, 10}); // below black
            develop_run(&in, &how[k], shown);
            for (int i = 0; i < 3 * 4096; i++)
                assert_int_equal(shown[i], 0);
        }
}

static void test_balance(void **state)
{
    struct develop d;
    (void)state;
    for (enum raw_cfa cfa = RAW_RGGB; cfa <= RAW_GBRG; cfa++) {
        struct raw in = mosaic(cfa, (const int[3]){64 + 120, 64 + 200, 64 + 140});
        for (int i = 0; i < 320; i++) // cells with one clipped site, any of four
            in.px[(i / 32 * 2 + (i & 1)) * 64 + i % 32 * 2 + (i >> 1 & 1)] = 1023;
        develop_balance(&in, 1, &d);
        assert_true(fabsf(d.red - 200.0f / 120.0f) < 1e-5f);
        assert_true(fabsf(d.blue - 200.0f / 140.0f) < 1e-5f);
    }
    struct raw two[2] = {mosaic(RAW_RGGB, (const int[3]){65, 64 + 500, 64 + 700}), {0}};
    two[1] = two[0];
    develop_balance(two, 2, &d);
    assert_true(d.red == 4.0f && fabsf(d.blue - 5.0f / 7.0f) < 1e-5f);
    two[0] = mosaic(RAW_RGGB, (const int[3]){64, 64, 64});
    develop_balance(two, 1, &d);
    assert_true(d.red == 1.0f && d.blue == 1.0f);
    two[0].cfa = RAW_MONO;
    develop_balance(two, 1, &d);
    assert_true(d.red == 1.0f && d.blue == 1.0f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_better_than_bilinear),
        cmocka_unit_test(test_exact),
        cmocka_unit_test(test_pieces_of_rows),
        cmocka_unit_test(test_codes),
        cmocka_unit_test(test_colours),
        cmocka_unit_test(test_balance),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
