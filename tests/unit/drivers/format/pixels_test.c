#include "drivers/format/pixels.h"

#include "drivers/format/exrfile.h"
#include "drivers/format/file.h"
#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <spng.h>

enum { W = 20, H = 12 };

static double srgb(double v)
{
    return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
}

/* gamma 0: no gAMA chunk. */
static void put_png16(const char *path, double gamma)
{
    static uint16_t px[3 * W * H];
    struct spng_ihdr head = {W, H, 16, SPNG_COLOR_TYPE_TRUECOLOR, 0, 0, 0};
    spng_ctx *ctx = spng_ctx_new(SPNG_CTX_ENCODER);
    FILE *f = fopen(path, "wb");
    for (int i = 0; i < 3 * W * H; i++)
        px[i] = (uint16_t)(i * 89);
    assert_int_equal(spng_set_png_file(ctx, f), 0);
    assert_int_equal(spng_set_ihdr(ctx, &head), 0);
    if (gamma > 0)
        assert_int_equal(spng_set_gama(ctx, gamma), 0);
    assert_int_equal(spng_encode_image(ctx, px, sizeof px, SPNG_FMT_PNG, SPNG_ENCODE_FINALIZE), 0);
    spng_ctx_free(ctx);
    fclose(f);
}

static struct shot look(const char *path)
{
    struct shot s = {.linear = true};
    expect_ok(imgsize_read(path, &s.taken_w, &s.taken_h));
    expect_ok(pixels_look(path, &s));
    return s;
}

static void put_exr(const char *path, float scale)
{
    static float px[3 * W * H];
    const struct image im = {W, H, 3, px};
    const struct exrfile_extra none = {0};
    for (int i = 0; i < 3 * W * H; i++)
        px[i] = scale * (float)i / (3 * W * H);
    px[0] = -1;
    px[1] = NAN;
    expect_ok(exrfile_write(path, &im, &none, NULL));
}

static void linear_values_become_srgb(void **state)
{
    (void)state;
    struct image16 im;
    struct image8 small;
    const char *path = tmpdir_path("a.exr");
    put_exr(path, 1.5f);
    struct shot s = look(path);
    assert_true(s.deep && s.linear && s.taken_w == W && s.taken_h == H);
    expect_ok(pixels_decode16(path, &s, &im));
    expect_ok(pixels_decode(path, &s, &small));
    for (int i = 2; i < 3 * W * H; i++) {
        const int at = 3 * (i % (W * H)) + i / (W * H);
        const double want = 65535 * srgb(fmin(1.5 * i / (3 * W * H), 1));
        assert_true(fabs(im.px[at] - want) < 1);
        assert_int_equal(small.px[at], (im.px[at] + 128) / 257);
    }
    assert_true(im.px[0] == 0 && im.px[3] == 0);
    pixels_free16(&im);
    img_free(&small);
    put_exr(path, 4);
    expect_err(pixels_decode16(path, &s, &im), ERR_FORMAT, "75 % of its values are above 1");
    assert_null(im.px);
}

static void png_of_16_bits(void **state)
{
    (void)state;
    struct image16 display, linear;
    put_png16(tmpdir_path("d.png"), 0);
    struct shot s = look(tmpdir_path("d.png"));
    assert_true(s.deep && !s.linear);
    expect_ok(pixels_decode16(tmpdir_path("d.png"), &s, &display));
    put_png16(tmpdir_path("l.png"), 1);
    s = look(tmpdir_path("l.png"));
    assert_true(s.deep && s.linear);
    expect_ok(pixels_decode16(tmpdir_path("l.png"), &s, &linear));
    for (int i = 0; i < 3 * W * H; i++) {
        assert_int_equal(display.px[i], (uint16_t)(i * 89));
        assert_true(fabs(linear.px[i] - 65535 * srgb(display.px[i] / 65535.0)) < 1);
    }
    pixels_free16(&display);
    pixels_free16(&linear);
    put_png16(tmpdir_path("g.png"), 0.45455);
    s = look(tmpdir_path("g.png"));
    assert_true(s.deep && !s.linear);
    s = look("tests/data/img/rgb8.png");
    assert_true(!s.deep && !s.linear);
}

static void hostile_files(void **state)
{
    (void)state;
    static const char head[] = "\x76\x2f\x31\x01\x02\0\0\0dataWindow\0box2i\0\x10\0\0\0"
                               "\0\0\0\0\0\0\0\0\x0f\x27\0\0\x0f\x27\0\0";
    struct image16 im;
    struct shot s = {.taken_w = 10000, .taken_h = 10000};
    int w, h;
    expect_ok(imgsize_parse("x", head, sizeof head - 1, &w, &h));
    assert_true(w == 10000 && h == 10000);
    for (size_t n = 8; n < sizeof head - 1; n++)
        expect_err(imgsize_parse("x", head, n, &w, &h), ERR_FORMAT,
                   "no PNG, JPEG, TIFF, HEIC, raw or EXR header");
    FILE *f = fopen(tmpdir_path("big.exr"), "wb");
    fwrite(head, 1, sizeof head - 1, f);
    fwrite("0123456789", 1, 10, f);
    fclose(f);
    expect_ok(pixels_look(tmpdir_path("big.exr"), &s));
    assert_true(s.deep && s.linear);
    assert_int_equal(pixels_decode16(tmpdir_path("big.exr"), &s, &im), ERR_FORMAT);
    put_exr(tmpdir_path("a.exr"), 1);
    expect_err(pixels_decode16(tmpdir_path("a.exr"), &s, &im), ERR_FORMAT, "said 10000 x 10000");
    assert_null(im.px);
    /* 100 megapixels of 16 bits in a PNG of a few bytes */
    put_png16(tmpdir_path("p.png"), 1);
    struct file_map m;
    expect_ok(file_map(tmpdir_path("p.png"), IMG_FILE_MAX, &m));
    uint8_t *copy = malloc(m.n);
    memcpy(copy, m.p, m.n);
    copy[18] = copy[22] = 0x27; // then the checksum is wrong, too
    assert_int_equal(img_read16_mem(copy, m.n, "p", &im), ERR_FORMAT);
    for (size_t n = 0; n + 16 < m.n; n += 7) // the rest holds no pixels
        assert_int_not_equal(img_read16_mem(m.p, n, "p", &im), OK);
    free(copy);
    file_unmap(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(linear_values_become_srgb),
        cmocka_unit_test(png_of_16_bits),
        cmocka_unit_test(hostile_files),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
