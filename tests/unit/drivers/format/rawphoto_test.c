/* A raw photograph that the test writes. */
#include "drivers/format/rawphoto.h"

#include "core/photo/develop.h"
#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"
#include "drivers/format/pixels.h"
#include "tests/unit/dng.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 64, H = 48, BYTES = DNG_HEAD + 2 * W * H };

/* Grey of that light, 1 is where green is full. */
static struct dng *dng(double light, int orientation)
{
    static uint8_t bytes[BYTES];
    static struct dng t;
    const double grey[3] = {light, light, light};
    memset(bytes, 0, sizeof bytes);
    t.p = bytes;
    dng_head(&t, W, H, orientation, 20);
    for (int i = 0; i < W * H; i++)
        dng_site(&t, W, i % W, i / W, grey);
    return &t;
}

static void levels_and_balance(void **state)
{
    (void)state;
    static const double light[] = {0, 0.001, 0.25, 0.9, 1.2}; // of the last the sensor is full
    for (int k = 0; k < 5; k++) {
        struct image16 im;
        expect_ok(rawphoto_read(dng(light[k], 1)->p, BYTES, "a", &im));
        assert_true(im.w == W && im.h == H && im.channels == 3);
        const uint16_t *p = im.px + 3 * (H / 2 * W + W / 2);
        const double low = develop_srgb16((float)(light[k] - 6e-4)),
                     high = develop_srgb16((float)(light[k] + 6e-4));
        for (int c = 0; c < 3; c++)
            assert_true(p[c] >= low - 2 && p[c] <= high + 2);
        free(im.px);
    }
}

/* As of a JPEG: size and quarter turn, exposure, camera. */
static void what_the_file_says(void **state)
{
    (void)state;
    struct img_exif x;
    struct img_camera camera;
    struct image16 im;
    struct shot s = {0};
    const char *path = tmpdir_path("a.dng");
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(dng(0.25, 6)->p, 1, BYTES, f), BYTES);
    fclose(f);
    expect_ok(pixels_exif(path, &x));
    assert_true(fabs(x.seconds - 0.02) < 1e-6 && x.iso == 200 && fabs(x.f_number - 2.8) < 1e-6);
    expect_ok(pixels_camera(path, &camera));
    assert_string_equal(camera.name, "Acme Acme");
    assert_int_equal(camera.orientation, 1);
    expect_ok(imgsize_read(path, &s.taken_w, &s.taken_h));
    assert_true(s.taken_w == H && s.taken_h == W);
    expect_ok(pixels_look(path, &s));
    assert_true(s.deep && s.linear);
    expect_ok(pixels_decode16(path, &s, &im));
    assert_true(im.w == H && im.h == W);
    pixels_free16(&im);
}

/* A bright corner, stored at the upper left, is where EXIF says. */
static void orientations(void **state)
{
    (void)state;
    static const bool right[] = {0, 0, 1, 1, 0, 0, 1, 1, 0}, below[] = {0, 0, 0, 1, 1, 0, 0, 1, 1};
    for (int o = 1; o <= 8; o++) {
        struct image16 im;
        struct dng *t = dng(0.1, o);
        for (int i = 0; i < 8 * W; i++)
            if (i % W < 8)
                dng_put(t->p + DNG_HEAD + 2 * i, DNG_WHITE, 2);
        expect_ok(rawphoto_read(t->p, BYTES, "a", &im));
        assert_true(im.w == (o < 5 ? W : H) && im.h == (o < 5 ? H : W));
        const int x = right[o] ? im.w - 3 : 2, y = below[o] ? im.h - 3 : 2;
        for (int i = 0; i < im.w * im.h; i++)
            assert_true(i != y * im.w + x || im.px[3 * i] == 65535);
        free(im.px);
    }
}

/* As found first in the list of the file. */
static uint8_t *value_of(struct dng *t, unsigned name)
{
    for (int i = 0; i < t->p[8]; i++)
        if ((t->p[10 + 12 * i] | t->p[11 + 12 * i] << 8) == (int)name)
            return t->p + 10 + 12 * i + 8;
    fail();
    return NULL;
}

static void wrong_levels(void **state)
{
    (void)state;
    struct image16 im;
    struct dng *t = dng(0.1, 1);
    dng_put(value_of(t, 50714), 3000, 2);
    expect_err(rawphoto_read(t->p, BYTES, "a", &im), ERR_FORMAT,
               "a: 100 % of its numbers are below the black level");
    dng_put(value_of(t, 50714), 4095, 2);
    expect_err(rawphoto_read(t->p, BYTES, "a", &im), ERR_FORMAT,
               "a: black level 4095, but its white level is 4095");
}

static void hostile_files(void **state)
{
    (void)state;
    struct image16 im;
    struct img_info info;
    int w, h;
    struct dng *t = dng(0.5, 1);
    dng_put(value_of(t, 256), 10000, 4);
    dng_put(value_of(t, 257), 10000, 4);
    dng_put(value_of(t, 279), 200000000, 4);
    expect_err(rawphoto_read(t->p, DNG_HEAD + 10, "big", &im), ERR_FORMAT,
               "big: 1034 bytes cannot hold 10000 x 10000 px");
    dng_put(value_of(t, 256), 60000, 4);
    dng_put(value_of(t, 257), 60000, 4);
    expect_err(rawphoto_read(t->p, BYTES, "huge", &im), ERR_FORMAT, "huge: ");
    expect_err(imgsize_parse("huge", t->p, BYTES, &w, &h), ERR_FORMAT, "huge: ");
    expect_err(rawphoto_look("II*\0\x08\0\0\0\0\0\0\0\0\0\0\0", 16, "empty", &info), ERR_FORMAT,
               "empty: TIFF, but no raw photograph");
    expect_err(rawphoto_look("\x89PNG", 4, "short", &info), ERR_FORMAT, "short: ");
    for (size_t n = 0; n < BYTES; n += n < DNG_HEAD ? 7 : 511) {
        expect_err(rawphoto_read(dng(0.5, 1)->p, n, "cut", &im), ERR_FORMAT, "cut: ");
        assert_null(im.px);
    }
}

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(levels_and_balance), cmocka_unit_test(what_the_file_says),
        cmocka_unit_test(orientations), cmocka_unit_test(wrong_levels),
        cmocka_unit_test(hostile_files)};
    return cmocka_run_group_tests(tests, setup, NULL);
}
