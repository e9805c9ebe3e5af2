#include "drivers/format/thumbnail.h"

#include "drivers/format/img.h"
#include "tests/unit/expect.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* Red rises along x, green along y, blue alternates and is grey from afar. own: img_free */
static struct image8 picture(int w, int h)
{
    struct image8 im = {w, h, 3, malloc(3 * (size_t)w * (size_t)h)};
    assert_non_null(im.px);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            uint8_t *p = im.px + 3 * ((size_t)y * (size_t)w + (size_t)x);
            p[0] = (uint8_t)(255 * (x + 0.5) / w);
            p[1] = (uint8_t)(255 * (y + 0.5) / h);
            p[2] = (x + y) % 2 ? 200 : 0;
        }
    return im;
}

/* The thumbnail of such a picture, which is of w x h px: far from its rim within a few codes. */
static void expect_picture(const void *jpeg, size_t n, int w, int h)
{
    struct image8 im;
    expect_ok(img_read_mem(jpeg, n, "small", &im));
    assert_int_equal(im.w, w);
    assert_int_equal(im.h, h);
    for (int y = h / 8; y < h - h / 8; y++)
        for (int x = w / 8; x < w - w / 8; x++) {
            const uint8_t *p = im.px + 3 * ((size_t)y * (size_t)w + (size_t)x);
            assert_in_range(p[0] + 8 - (int)(255 * (x + 0.5) / w), 0, 16);
            assert_in_range(p[1] + 8 - (int)(255 * (y + 0.5) / h), 0, 16);
            assert_in_range(p[2], 90, 110);
        }
    img_free(&im);
}

static void shrinks(int w, int h, int small_w, int small_h)
{
    struct image8 im = picture(w, h);
    void *jpeg;
    size_t n;
    expect_ok(thumbnail_make(&im, "small", &jpeg, &n));
    expect_picture(jpeg, n, small_w, small_h);
    assert_true(n <= thumbnail_need(w, h));
    free(jpeg);
    img_free(&im);
}

static void means_of_what_is_covered(void **state)
{
    (void)state;
    shrinks(4056, 3040, 256, 192);
    shrinks(600, 1000, 154, 256);
    shrinks(1000, 999, 256, 256);
}

static void small_and_narrow(void **state)
{
    (void)state;
    static const int sizes[][4] = {{256, 200, 256, 200}, {1, 1, 1, 1},      {257, 1, 256, 1},
                                   {1, 3000, 1, 256},    {3000, 5, 256, 1}, {56, 42, 56, 42}};
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        struct image8 im = picture(sizes[i][0], sizes[i][1]), out;
        void *jpeg;
        size_t n;
        expect_ok(thumbnail_make(&im, "small", &jpeg, &n));
        expect_ok(img_read_mem(jpeg, n, "small", &out));
        assert_int_equal(out.w, sizes[i][2]);
        assert_int_equal(out.h, sizes[i][3]);
        img_free(&out);
        free(jpeg);
        img_free(&im);
    }
}

/* The decoder makes it smaller first; noise, which compresses worst, has room. */
static void of_a_jpeg(void **state)
{
    (void)state;
    void *large, *jpeg;
    size_t size, n;
    struct image8 im = picture(2000, 1504), out;
    expect_ok(img_encode_jpeg(&im, 95, "large", &large, &size));
    expect_ok(thumbnail_of_jpeg(large, size, "small", &jpeg, &n));
    expect_picture(jpeg, n, 256, 193);
    free(jpeg);
    expect_ok(img_read_jpeg_small(large, size, "small", 256, &out));
    assert_true(out.w >= 256 && out.w < 512);
    img_free(&out);
    expect_err(thumbnail_of_jpeg(large, size / 2, "cut", &jpeg, &n), ERR_FORMAT, "cut: JPEG");
    assert_null(jpeg);
    expect_err(thumbnail_of_jpeg("PNG", 3, "other", &jpeg, &n), ERR_FORMAT, "other");
    free(large);
    srand(1);
    for (size_t i = 0; i < 3 * 256 * 256; i++)
        im.px[i] = (uint8_t)(rand() >> 8);
    im.w = im.h = 256;
    expect_ok(thumbnail_make(&im, "noise", &jpeg, &n));
    assert_true(n <= thumbnail_need(256, 256));
    free(jpeg);
    img_free(&im);
}

/* An orientation of 6 in front of the picture: its right side is up. */
static void upright(void **state)
{
    (void)state;
    static const uint8_t exif[] = {0xff, 0xd8, 0xff, 0xe1, 0, 34, 'E', 'x', 'i', 'f',  0, 0, 'I',
                                   'I',  42,   0,    8,    0, 0,  0,   1,   0,   0x12, 1, 3, 0,
                                   1,    0,    0,    0,    6, 0,  0,   0,   0,   0,    0, 0};
    struct image8 im = picture(600, 300), out;
    void *jpeg, *small;
    size_t size, n;
    expect_ok(img_encode_jpeg(&im, 95, "large", &jpeg, &size));
    uint8_t *turned = malloc(size + sizeof exif);
    assert_non_null(turned);
    memcpy(turned, exif, sizeof exif);
    memcpy(turned + sizeof exif, (uint8_t *)jpeg + 2, size - 2);
    expect_ok(thumbnail_of_jpeg(turned, size - 2 + sizeof exif, "small", &small, &n));
    expect_ok(img_read_mem(small, n, "small", &out));
    assert_int_equal(out.w, 128);
    assert_int_equal(out.h, 256);
    assert_in_range(out.px[3 * (128 * 20 + 64)], 10, 30); // red rises downwards
    img_free(&out);
    img_free(&im);
    free(turned);
    free(small);
    free(jpeg);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(means_of_what_is_covered),
                                       cmocka_unit_test(small_and_narrow),
                                       cmocka_unit_test(of_a_jpeg), cmocka_unit_test(upright)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
