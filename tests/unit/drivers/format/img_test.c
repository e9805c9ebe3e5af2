/* tests/data/img: PNG files of 13 x 9 px with R = 19 x, G = 28 y, B = (7 x + 11 y) mod 256 (grey: R
 * alone; 16 bits: the same times 256 plus 200), written chunk by chunk in Python, and JPEG files
 * written by Pillow; the hashes below are FNV-1a of what Pillow decodes from them. The EXIF blocks
 * hold 1/50 s, ISO 400, f/2.8 unless the name says other. */
#include "drivers/format/img.h"
#include "drivers/format/imgsize.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmocka.h>

enum { W = 13, H = 9 };

static const char *data(const char *name)
{
    static char path[128];
    snprintf(path, sizeof path, "tests/data/img/%s", name);
    return path;
}

/* kind: 'c' colour, 'g' grey, 'b' one bit, 'p' palette */
static int expected(char kind, int x, int y, int c)
{
    const int rgb[3] = {19 * x, 28 * y, (7 * x + 11 * y) % 256},
              palette[3] = {19 * x, 255 - 19 * x, x};
    switch (kind) {
    case 'g':
        return rgb[0];
    case 'b':
        return x % 2 ? 255 : 0;
    case 'p':
        return palette[c];
    default:
        return rgb[c];
    }
}

static void reads_every_kind_of_png(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        char kind;
    } files[] = {
        {"rgb8.png", 'c'},  {"rgba8.png", 'c'},    {"rgb16.png", 'c'},  {"rgba16.png", 'c'},
        {"trns8.png", 'c'}, {"grey8.png", 'g'},    {"grey16.png", 'g'}, {"greya8.png", 'g'},
        {"grey1.png", 'b'}, {"palette4.png", 'p'},
    };
    for (size_t f = 0; f < sizeof files / sizeof files[0]; f++) {
        struct image8 im;
        assert_int_equal(img_read(data(files[f].name), &im), OK);
        assert_true(im.w == W && im.h == H && im.channels == 3);
        for (int i = 0; i < 3 * W * H; i++)
            if (im.px[i] != expected(files[f].kind, i / 3 % W, i / 3 / W, i % 3))
                fail_msg("%s: sample %d is %d", files[f].name, i, im.px[i]);
        img_free(&im);
    }
}

static void reads_jpeg_as_pillow(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        uint64_t hash;
    } files[] = {{"rgb.jpg", 0x49a6e1fa8645895fu},
                 {"progressive.jpg", 0x49a6e1fa8645895fu},
                 {"grey.jpg", 0x72f1d1bc1e5d842au}};
    for (size_t f = 0; f < sizeof files / sizeof files[0]; f++) {
        struct image8 im;
        uint64_t h = 0xcbf29ce484222325u;
        assert_int_equal(img_read(data(files[f].name), &im), OK);
        assert_true(im.w == 24 && im.h == 16 && im.channels == 3);
        for (int i = 0; i < 24 * 16 * 3; i++)
            h = (h ^ im.px[i]) * 0x100000001b3u;
        assert_int_equal(h, files[f].hash);
        img_free(&im);
    }
}

static uint8_t *slurp(const char *path, size_t *n)
{
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    fseek(f, 0, SEEK_END);
    *n = (size_t)ftell(f);
    rewind(f);
    uint8_t *p = malloc(*n + 1);
    assert_int_equal(fread(p, 1, *n, f), *n);
    fclose(f);
    return p;
}

/* Every truncation is refused; every single wrong byte gives an error or an image, never a
 * crash. */
static void survives_damage(void **state)
{
    (void)state;
    static const char *const names[] = {"exif.png", "palette4.png", "rgb.jpg", "progressive.jpg"};
    for (size_t k = 0; k < sizeof names / sizeof names[0]; k++) {
        size_t n;
        struct image8 im;
        struct img_exif exif;
        uint8_t *p = slurp(data(names[k]), &n);
        size_t needed = k < 2 ? n - 16 : n; // a PNG may lose its last checksum and IEND
        for (size_t cut = 0; cut < needed; cut++) {
            assert_int_not_equal(img_read_mem(p, cut, "cut", &im), OK);
            assert_null(im.px);
            if (img_exif_mem(p, cut, "cut", &exif) == OK)
                assert_true(img_exif_exposure(&exif) > 0.0);
        }
        for (size_t i = 0; i < n; i++) {
            p[i] ^= 0xff;
            if (img_read_mem(p, n, "wrong", &im) == OK)
                img_free(&im);
            if (img_exif_mem(p, n, "wrong", &exif) == OK)
                assert_true(img_exif_exposure(&exif) > 0.0);
            p[i] ^= 0xff;
        }
        free(p);
    }
}

static uint32_t crc32_of(const uint8_t *p, size_t n)
{
    uint32_t c = 0xffffffffu;
    for (size_t i = 0; i < n; i++) {
        c ^= p[i];
        for (int k = 0; k < 8; k++)
            c = c >> 1 ^ (c & 1 ? 0xedb88320u : 0);
    }
    return ~c;
}

/* Give a PNG header another size, with a right checksum. */
static void resize_header(uint8_t *png, uint32_t w, uint32_t h)
{
    for (int i = 0; i < 4; i++) {
        png[16 + i] = (uint8_t)(w >> (24 - 8 * i));
        png[20 + i] = (uint8_t)(h >> (24 - 8 * i));
    }
    uint32_t crc = crc32_of(png + 12, 17);
    for (int i = 0; i < 4; i++)
        png[29 + i] = (uint8_t)(crc >> (24 - 8 * i));
}

static void refuses_too_large(void **state)
{
    (void)state;
    size_t n;
    struct image8 im;
    uint8_t *p = slurp(data("rgb8.png"), &n);
    resize_header(p, W, H);
    assert_int_equal(img_read_mem(p, n, "same", &im), OK);
    img_free(&im);
    resize_header(p, 16385, 1);
    expect_err(img_read_mem(p, n, "wide", &im), ERR_FORMAT, "16385 x 1");
    resize_header(p, 16384, 16384);
    expect_err(img_read_mem(p, n, "bomb", &im), ERR_FORMAT, "cannot hold 16384 x 16384");
    free(p);
    p = slurp(data("grey.jpg"), &n);
    uint8_t *sof = memmem(p, n, "\xff\xc0", 2);
    assert_non_null(sof);
    sof[5] = sof[7] = 0x3f; // 16143 x 16152
    expect_err(img_read_mem(p, n, "bomb", &im), ERR_FORMAT, "cannot hold");
    sof[5] = 0x40; // 16400 rows
    expect_err(img_read_mem(p, n, "tall", &im), ERR_FORMAT, "x 16400");
    free(p);
}

static void refuses_other_files(void **state)
{
    (void)state;
    struct image8 im;
    expect_err(img_read(data("cmyk.jpg"), &im), ERR_UNSUPPORTED, "CMYK");
    expect_err(img_read("tests/unit/drivers/format/img_test.c", &im), ERR_FORMAT,
               "neither PNG nor JPEG");
    expect_err(img_read(data("none.png"), &im), ERR_IO, "none.png");
    assert_int_not_equal(img_read("tests/data/img", &im), OK);
    assert_null(im.px);
    expect_err(img_read_mem("", 0, "empty", &im), ERR_FORMAT, "empty");
}

static void exposures(void **state)
{
    (void)state;
    const double full = 0.02 * 4.0 / (2.8 * 2.8);
    struct img_exif x;
    assert_int_equal(img_exif(data("rgb.jpg"), &x), OK);
    assert_true(fabs(img_exif_exposure(&x) - full) < 1e-9 && x.iso == 400);
    assert_int_equal(img_exif(data("exif.png"), &x), OK);
    assert_true(fabs(img_exif_exposure(&x) - full) < 1e-9);
    assert_int_equal(img_exif(data("progressive.jpg"), &x), OK); // 1/8 s, nothing else
    assert_true(img_exif_exposure(&x) == 0.125 && x.iso == 0 && x.f_number == 0);
    expect_err(img_exif(data("no_time.jpg"), &x), ERR_FORMAT, "no ExposureTime");
    expect_err(img_exif(data("zero_time.jpg"), &x), ERR_FORMAT, "no ExposureTime");
    expect_err(img_exif(data("grey.jpg"), &x), ERR_FORMAT, "no ExposureTime");
    expect_err(img_exif(data("rgb8.png"), &x), ERR_FORMAT, "no EXIF data");
    expect_err(img_exif("tests/unit/drivers/format/img_test.c", &x), ERR_FORMAT,
               "neither PNG nor JPEG");
    assert_true(x.seconds == 0.0);
}

static void png_round_trip(void **state)
{
    (void)state;
    struct image8 im, back;
    assert_int_equal(img_read(data("rgb8.png"), &im), OK);
    const char *path = tmpdir_path("round.png");
    assert_int_equal(img_write_png(path, &im), OK);
    assert_int_equal(img_read(path, &back), OK);
    assert_true(back.w == W && back.h == H);
    assert_memory_equal(back.px, im.px, 3 * W * H);
    img_free(&back);
    void *bytes;
    size_t n;
    const struct img_maker by = {"hdrig", "camera 2"};
    struct img_exif exif;
    assert_int_equal(img_write_png_by(path, &im, &by), OK);
    expect_err(img_exif(path, &exif), ERR_FORMAT, "no ExposureTime"); // but EXIF data
    assert_int_equal(img_read(path, &back), OK);
    assert_memory_equal(back.px, im.px, 3 * W * H);
    img_free(&back);
    assert_int_equal(img_encode_png_fast(&im, "fast", &bytes, &n), OK);
    assert_int_equal(img_read_mem(bytes, n, "fast", &back), OK);
    assert_memory_equal(back.px, im.px, 3 * W * H);
    img_free(&back);
    free(bytes);
    im.channels = 4;
    expect_err(img_write_png(path, &im), ERR_ARG, "4 channels");
    expect_err(img_encode_png_fast(&im, "fast", &bytes, &n), ERR_ARG, "fast: no RGB picture");
    img_free(&im);
}

/* A smooth picture comes back within the steps of a fine quantisation, colours where they were. */
static void jpeg_round_trip(void **state)
{
    (void)state;
    enum { SIDE = 37 }; // no multiple of a block
    uint8_t px[3 * SIDE * SIDE];
    struct image8 im = {SIDE, SIDE, 3, px}, back;
    void *bytes;
    size_t n;
    for (int i = 0; i < SIDE * SIDE; i++) {
        px[3 * i] = (uint8_t)(i % SIDE * 6);
        px[3 * i + 1] = (uint8_t)(i / SIDE * 6);
        px[3 * i + 2] = 40;
    }
    assert_int_equal(img_encode_jpeg(&im, 95, "small", &bytes, &n), OK);
    assert_true(n < 2000);
    assert_int_equal(img_read_mem(bytes, n, "small", &back), OK);
    assert_true(back.w == SIDE && back.h == SIDE);
    for (int i = 0; i < 3 * SIDE * SIDE; i++)
        assert_true(abs(back.px[i] - px[i]) <= 6);
    img_free(&back);
    free(bytes);
    im.w = 0;
    expect_err(img_encode_jpeg(&im, 95, "small", &bytes, &n), ERR_ARG, "small: no RGB picture");
    assert_null(bytes);
}

static void ldr_values(void **state)
{
    (void)state;
    float px[12] = {0.0f,      1.0f, -1.0f,   2.0f,    NAN,     INFINITY,
                    -INFINITY, 0.5f, 0.4980f, 0.9981f, 0.0019f, 0.0020f};
    static const uint8_t want[12] = {0, 0, 127, 255, 255, 255, 0, 0, 0, 255, 128, 1}; // interleaved
    struct image im = {4, 1, 3, px};
    struct image8 back;
    const char *path = tmpdir_path("ldr.png");
    assert_int_equal(img_write_ldr(path, &im), OK);
    assert_int_equal(img_read(path, &back), OK);
    assert_memory_equal(back.px, want, 12);
    img_free(&back);
    im.channels = 1;
    expect_err(img_write_ldr(path, &im), ERR_ARG, "1 channels");
}

static void writing_fails_cleanly(void **state)
{
    (void)state;
    struct image8 im;
    const struct rlimit small = {50, RLIM_INFINITY};
    struct rlimit old;
    assert_int_equal(img_read(data("rgb8.png"), &im), OK);
    expect_err(img_write_png(tmpdir_path("no/such/folder.png"), &im), ERR_IO, "folder.png");
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    const char *path = tmpdir_path("full.png");
    err_t e = img_write_png(path, &im);
    setrlimit(RLIMIT_FSIZE, &old);
    expect_err(e, ERR_IO, "File too large");
    assert_int_not_equal(access(path, F_OK), 0);
    img_free(&im);
}

/* An APP1 segment with nothing but the orientation, behind the start of a JPEG. */
static size_t with_orientation(const uint8_t *jpeg, size_t n, int orientation, uint8_t *out)
{
    const uint8_t app1[] = {0xff, 0xe1, 0, 34, 'E', 'x', 'i', 'f', 0, 0,
                            'M',  'M',  0, 42, 0,   0,   0,   8,   0, 1, // one entry
                            0x01, 0x12, 0, 3,  0,   0,   0,   1,   0, (uint8_t)orientation,
                            0,    0,    0, 0,  0,   0};
    memcpy(out, jpeg, 2);
    memcpy(out + 2, app1, sizeof app1);
    memcpy(out + 2 + sizeof app1, jpeg + 2, n - 2);
    return n + sizeof app1;
}

/* Stored: 32 x 16 px, red left above, green right above, blue left below, white right below. */
static void jpegs_stand_upright(void **state)
{
    (void)state;
    enum { ACROSS = 32, DOWN = 16 };
    static const uint8_t corner[4][3] = {{255, 0, 0}, {0, 255, 0}, {0, 0, 255}, {255, 255, 255}};
    static const int upright[9][4] = {{0},          {0, 1, 2, 3}, {1, 0, 3, 2},
                                      {3, 2, 1, 0}, {2, 3, 0, 1}, {0, 2, 1, 3},
                                      {2, 0, 3, 1}, {3, 1, 2, 0}, {1, 3, 0, 2}}; // CIPA DC-008
    static uint8_t px[ACROSS * DOWN * 3], file[1 << 14];
    const struct image8 im = {ACROSS, DOWN, 3, px};
    void *jpeg;
    size_t n;
    for (int i = 0; i < ACROSS * DOWN; i++)
        memcpy(px + 3 * i, corner[i / ACROSS / (DOWN / 2) * 2 + i % ACROSS / (ACROSS / 2)], 3);
    assert_int_equal(img_encode_jpeg(&im, 95, "j", &jpeg, &n), OK);
    for (int o = 0; o <= 9; o++) {
        struct image8 out;
        int w, h;
        const int *want = upright[o < 1 || o > 8 ? 1 : o];
        size_t m = with_orientation(jpeg, n, o, file);
        assert_int_equal(img_orientation(file, m), o < 1 || o > 8 ? 1 : o);
        assert_int_equal(img_read_mem(file, m, "j", &out), OK);
        assert_int_equal(imgsize_parse("j", file, m, &w, &h), OK);
        assert_true(out.w == w && out.h == h && w == (o >= 5 && o <= 8 ? DOWN : ACROSS));
        for (int k = 0; k < 4; k++) {
            const int x = k % 2 ? w - 3 : 2, y = k / 2 ? h - 3 : 2;
            for (int c = 0; c < 3; c++)
                assert_true(abs(out.px[3 * (y * w + x) + c] - corner[want[k]][c]) < 40);
        }
        img_free(&out);
    }
    assert_int_equal(img_orientation(jpeg, n), 1);
    free(jpeg);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reads_every_kind_of_png), cmocka_unit_test(reads_jpeg_as_pillow),
        cmocka_unit_test(survives_damage),         cmocka_unit_test(refuses_too_large),
        cmocka_unit_test(refuses_other_files),     cmocka_unit_test(exposures),
        cmocka_unit_test(jpegs_stand_upright),     cmocka_unit_test(png_round_trip),
        cmocka_unit_test(jpeg_round_trip),         cmocka_unit_test(ldr_values),
        cmocka_unit_test(writing_fails_cleanly),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
