/* HEIC files as a telephone and a camera of 10 bits write them (tests/data/heic, made with the
 * encoder of libheif): pixels, orientation, EXIF data; what is refused; broken ones. */
#include "drivers/format/heic.h"

#include "drivers/format/file.h"
#include "drivers/format/imgsize.h"
#include "drivers/format/pixels.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <libheif/heif.h>
#include <stdlib.h>

#define TELEPHONE "tests/data/heic/telephone.heic"
#define DEEP "tests/data/heic/deep.heic"

static void skip_without_decoder(void)
{
    if (heif_have_decoder_for_format(heif_compression_HEVC))
        return;
    puts("not checked: libheif has no decoder for HEVC here");
    skip();
}

static void close_to(const struct image16 *im, int x, int y, const double want[3], double off)
{
    for (int c = 0; c < 3; c++)
        assert_float_equal(im->px[3 * ((size_t)y * (size_t)im->w + (size_t)x) + (size_t)c] /
                               65535.0,
                           want[c], off);
}

/* Stored as 96 x 64 px, red to the right, green downward, and to be turned to the right. */
static void telephone_is_upright(void **state)
{
    (void)state;
    struct shot s = {.taken_w = 64, .taken_h = 96};
    struct image16 im;
    int w, h, orientation;
    expect_ok(imgsize_read(TELEPHONE, &w, &h));
    assert_true(w == 64 && h == 96);
    expect_ok(imgsize_orientation(TELEPHONE, &orientation));
    assert_int_equal(orientation, 1);
    expect_ok(pixels_look(TELEPHONE, &s));
    assert_true(s.deep && !s.linear);
    skip_without_decoder();
    expect_ok(pixels_decode16(TELEPHONE, &s, &im));
    for (int y = 4; y < 92; y += 8)
        for (int x = 4; x < 60; x += 8)
            close_to(&im, x, y, (const double[]){y / 95.0, (63 - x) / 63.0, 128 / 255.0}, 0.06);
    pixels_free16(&im);
}

static void exif_is_read(void **state)
{
    (void)state;
    struct img_exif exif;
    struct img_camera camera;
    expect_ok(pixels_exif(TELEPHONE, &exif));
    assert_float_equal(exif.seconds, 0.02, 1e-9);
    assert_float_equal(exif.f_number, 1.8, 1e-9);
    assert_float_equal(exif.iso, 64, 1e-9);
    expect_ok(pixels_camera(TELEPHONE, &camera));
    assert_string_equal(camera.name, "hdrig phone 4.2 mm");
    assert_float_equal(camera.focal_35mm, 26, 1e-9);
    assert_int_equal(camera.orientation, 1); // its EXIF data say 6: libheif has turned it
    expect_err(pixels_exif(DEEP, &exif), ERR_FORMAT, "no ExposureTime");
}

/* A grey ramp of 10 bits has more than 256 levels' resolution: neighbours differ by 1/63. */
static void ten_bits(void **state)
{
    (void)state;
    struct file_map m;
    struct image16 im;
    bool fine = false;
    skip_without_decoder();
    expect_ok(file_map(DEEP, IMG_FILE_MAX, &m));
    expect_ok(heic_read(m.p, m.n, DEEP, &im));
    assert_true(im.w == 64 && im.h == 32);
    for (int x = 0; x < 64; x++) {
        close_to(&im, x, 16, (const double[]){x / 63.0, x / 63.0, x / 63.0}, 0.012);
        fine = fine || (im.px[3 * (16 * 64 + (size_t)x)] % 257 != 0);
    }
    assert_true(fine);
    free(im.px);
    file_unmap(&m);
}

static void refused(void **state)
{
    (void)state;
    struct img_info info;
    struct image16 im;
    static const char film[] = "\0\0\0\x18"
                               "ftypqt  \0\0\0\0qt  ";
    assert_false(heic_is(film, sizeof film));
    expect_err(heic_look(film, sizeof film, "film", &info), ERR_FORMAT, "film: no HEIC");
    static const char empty[] = "\0\0\0\x18"
                                "ftypheic\0\0\0\0mif1heic";
    assert_true(heic_is(empty, sizeof empty));
    expect_err(heic_look(empty, sizeof empty, "empty", &info), ERR_FORMAT, "empty: HEIC: ");
    expect_err(heic_read(empty, sizeof empty, "empty", &im), ERR_FORMAT, "empty: HEIC: ");
    assert_null(im.px);
}

/* More pixels than the bytes can hold: the size is in the property ispe. */
static void too_large(void **state)
{
    (void)state;
    static uint8_t bytes[1 << 12];
    struct file_map m;
    struct img_info info;
    expect_ok(file_map(TELEPHONE, IMG_FILE_MAX, &m));
    assert_true(m.n < sizeof bytes);
    memcpy(bytes, m.p, m.n);
    uint8_t *ispe = memmem(bytes, m.n, "ispe", 4);
    assert_non_null(ispe);
    memcpy(ispe + 8, "\0\0\x3a\x98\0\0\x3a\x98", 8); // 15000 x 15000
    expect_err(heic_look(bytes, m.n, "vast", &info), ERR_FORMAT, "cannot hold 15000 x 15000 px");
    memcpy(ispe + 8, "\0\1\0\0\0\1\0\0", 8);
    expect_err(heic_look(bytes, m.n, "vast", &info), ERR_FORMAT, "vast: ");
    file_unmap(&m);
}

/* Cut off anywhere, and with any byte changed: a picture or an error. */
static void broken(void **state)
{
    (void)state;
    static uint8_t bytes[1 << 12];
    struct file_map m;
    expect_ok(file_map(TELEPHONE, IMG_FILE_MAX, &m));
    for (size_t i = 0; i < 2 * m.n; i += i < m.n ? 7 : 3) {
        struct image16 im;
        struct img_info info;
        memcpy(bytes, m.p, m.n);
        if (i >= m.n)
            bytes[i - m.n] ^= (uint8_t)(1 + i % 255);
        const size_t n = i < m.n ? i : m.n;
        if (heic_look(bytes, n, "broken", &info) == OK)
            assert_true(info.w >= 1 && info.h >= 1);
        const err_t e = heic_read(bytes, n, "broken", &im);
        assert_true(e == OK ? im.px != NULL : im.px == NULL);
        free(im.px);
    }
    file_unmap(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(telephone_is_upright),
                                       cmocka_unit_test(exif_is_read),
                                       cmocka_unit_test(ten_bits),
                                       cmocka_unit_test(refused),
                                       cmocka_unit_test(too_large),
                                       cmocka_unit_test(broken)};
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
