/* Every format against numbers packed here by its definition, YUV against the formula in floating
 * point; every bound from both sides, in blocks of exactly the bytes that may be read. */
#include "drivers/device/unpack.h"

#include "drivers/format/img.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 10, H = 6, PAD = 5 };

static uint16_t px[3 * 64 * 64];

/* ---- formats ---- */

struct packing {
    enum camera_format format;
    enum raw_cfa cfa;
    int bits, row; // bytes of W px
};

static const struct packing packings[] = {
    {CAMERA_RGB8, RAW_RGB, 8, 30},      {CAMERA_BGR8, RAW_RGB, 8, 30},
    {CAMERA_GREY, RAW_MONO, 8, 10},     {CAMERA_GREY16, RAW_MONO, 14, 20},
    {CAMERA_RGGB16, RAW_RGGB, 10, 20},  {CAMERA_BGGR16, RAW_BGGR, 12, 20},
    {CAMERA_GRBG16, RAW_GRBG, 16, 20},  {CAMERA_GBRG16, RAW_GBRG, 9, 20},
    {CAMERA_RGGB10P, RAW_RGGB, 10, 15}, {CAMERA_BGGR10P, RAW_BGGR, 10, 15},
    {CAMERA_GRBG10P, RAW_GRBG, 10, 15}, {CAMERA_GBRG10P, RAW_GBRG, 10, 15},
    {CAMERA_RGGB12P, RAW_RGGB, 12, 15}, {CAMERA_BGGR12P, RAW_BGGR, 12, 15},
    {CAMERA_GRBG12P, RAW_GRBG, 12, 15}, {CAMERA_GBRG12P, RAW_GBRG, 12, 15},
};

static int number(const struct packing *p, int i)
{
    return (int)((unsigned)(i + 1) * 2654435761u >> 12) & ((1 << p->bits) - 1);
}

/* Number x of a row, as the format says. */
static void pack(const struct packing *p, uint8_t *row, int x, int v)
{
    if (p->format == CAMERA_BGR8)
        row[x / 3 * 3 + 2 - x % 3] = (uint8_t)v;
    else if (p->bits == 8)
        row[x] = (uint8_t)v;
    else if (p->format >= CAMERA_RGGB12P) {
        row[x / 2 * 3 + x % 2] = (uint8_t)(v >> 4);
        row[x / 2 * 3 + 2] |= (uint8_t)((v & 15) << (x % 2 ? 4 : 0));
    } else if (p->format >= CAMERA_RGGB10P) {
        row[x / 4 * 5 + x % 4] = (uint8_t)(v >> 2);
        row[x / 4 * 5 + 4] |= (uint8_t)((v & 3) << x % 4 * 2);
    } else {
        row[2 * x] = (uint8_t)v;
        row[2 * x + 1] = (uint8_t)(v >> 8);
    }
}

static struct camera_info info_of(enum camera_format format, int bits, int stride)
{
    return (struct camera_info){
        .format = format, .w = W, .h = H, .bits = bits, .stride = stride, .black = bits > 8};
}

static struct frame frame_of(const struct camera_info *info, const void *data, size_t bytes)
{
    return (struct frame){.data = data,
                          .bytes = bytes,
                          .w = info->w,
                          .h = info->h,
                          .stride = info->stride,
                          .format = info->format,
                          .sequence = 77};
}

/* A block of its own, so that reading beyond is seen. own: free */
static uint8_t *packed(const struct packing *p, int stride, size_t bytes)
{
    uint8_t *data = calloc(1, bytes);
    int n = p->cfa == RAW_RGB ? 3 * W : W;
    assert_non_null(data);
    for (int i = 0; i < n * H; i++)
        pack(p, data + i / n * stride, i % n, number(p, i));
    return data;
}

static void test_formats(void **state)
{
    (void)state;
    for (size_t k = 0; k < sizeof packings / sizeof packings[0]; k++)
        for (int pad = 0; pad <= PAD; pad += PAD) {
            const struct packing *p = &packings[k];
            struct camera_info info = info_of(p->format, p->bits, p->row + pad);
            size_t n = W * H * (p->cfa == RAW_RGB ? 3 : 1);
            size_t bytes = (size_t)(info.stride * (H - 1) + p->row);
            uint8_t *data = packed(p, info.stride, bytes);
            struct frame f = frame_of(&info, data, bytes);
            struct raw out = {.px = px};
            memset(px, 0xEE, sizeof px);
            assert_int_equal(unpack_count(&info), n);
            assert_int_equal(unpack_check(&info, &f), OK);
            assert_int_equal(unpack_run(&info, &f, &out), OK);
            bool linear = p->bits > 8;
            assert_true(out.w == W && out.h == H && out.cfa == p->cfa && out.bits == p->bits);
            assert_true(out.black == linear && out.linear == linear && out.px == px);
            for (size_t i = 0; i < n; i++)
                assert_int_equal(px[i], number(p, (int)i));
            assert_int_equal(px[n], 0xEEEE);
            free(data);
        }
}

/* One byte less, a stride too small, another one than agreed. */
static void test_bounds(void **state)
{
    (void)state;
    for (size_t k = 0; k < sizeof packings / sizeof packings[0]; k++) {
        const struct packing *p = &packings[k];
        struct camera_info info = info_of(p->format, p->bits, p->row);
        size_t bytes = (size_t)p->row * H;
        uint8_t *data = packed(p, p->row, bytes);
        struct frame f = frame_of(&info, data, bytes - 1);
        struct raw out = {.px = px};
        expect_err(unpack_run(&info, &f, &out), ERR_FORMAT, "frame 77: ");
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "its format needs");
        f = frame_of(&info, NULL, bytes);
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "0 bytes, its format needs");
        f = frame_of(&info, data, bytes);
        f.stride += 2;
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "bytes from row to row");
        const int strides[] = {p->row - 1, 0, -p->row, -1, INT32_MIN};
        for (int i = 0; i < 5; i++) {
            f.stride = info.stride = strides[i];
            expect_err(unpack_check(&info, &f), ERR_FORMAT, "bytes from row to row");
        }
        f.stride = info.stride = INT32_MAX;
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "its format needs");
        assert_true(out.w == 0 && out.px == px);
        free(data);
    }
}

static void test_promises(void **state)
{
    static const struct {
        enum camera_format format;
        int w, h, bits, black, good;
    } cases[] = {
        {CAMERA_GREY, 1, 1, 8, 0, 1},
        {CAMERA_GREY, 0, 6, 8, 0, 0},
        {CAMERA_GREY, 6, -1, 8, 0, 0},
        {CAMERA_GREY, 16385, 1, 8, 0, 0},
        {CAMERA_GREY, INT32_MAX, INT32_MAX, 8, 0, 0},
        {CAMERA_RGGB16, 3, 2, 10, 0, 0},
        {CAMERA_RGGB16, 2, 3, 10, 0, 0},
        {CAMERA_GBRG10P, 6, 2, 10, 0, 1},
        {CAMERA_GBRG12P, 6, 3, 12, 0, 0},
        {CAMERA_YUYV, 4, 3, 8, 0, 1},
        {CAMERA_YUYV, 5, 2, 8, 0, 0},
        {CAMERA_NV12, 4, 3, 8, 0, 0},
        {CAMERA_NV12, 4, 2, 8, 0, 1},
        {CAMERA_ANY, 4, 4, 8, 0, 0},
        {CAMERA_FORMATS, 4, 4, 8, 0, 0},
        {(enum camera_format) - 1, 4, 4, 8, 0, 0},
        {CAMERA_RGGB16, 4, 4, 7, 0, 2},
        {CAMERA_RGGB16, 4, 4, 17, 0, 2},
        {CAMERA_RGGB16, 4, 4, INT32_MAX, 0, 2},
        {CAMERA_RGGB16, 4, 4, 10, -1, 2},
        {CAMERA_RGGB16, 4, 4, 10, 1024, 2},
        {CAMERA_RGGB16, 4, 4, 10, 1023, 1},
    };
    static const uint8_t zeros[256];
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct camera_info info = {.format = cases[i].format,
                                   .w = cases[i].w,
                                   .h = cases[i].h,
                                   .bits = cases[i].bits,
                                   .black = cases[i].black,
                                   .stride = 16};
        struct frame f = frame_of(&info, zeros, sizeof zeros);
        assert_true((unpack_count(&info) > 0) == (cases[i].good > 0));
        if (cases[i].good == 1)
            assert_int_equal(unpack_check(&info, &f), OK);
        else
            expect_err(unpack_check(&info, &f), ERR_FORMAT,
                       cases[i].good ? "bits" : "allowed are 1 to");
    }
    struct camera_info info = info_of(CAMERA_GREY, 8, W);
    for (int k = 0; k < 3; k++) {
        struct frame f = frame_of(&info, zeros, sizeof zeros);
        f.w -= k == 0;
        f.h += k == 1;
        f.format += k == 2;
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "the camera was opened for");
    }
}

static void test_words_beyond_their_bits(void **state)
{
    struct raw out = {.px = px};
    (void)state;
    uint16_t words[W * H] = {0};
    struct camera_info info = info_of(CAMERA_RGGB16, 10, 2 * W);
    struct frame f = frame_of(&info, words, sizeof words);
    words[W * H - 1] = 1023;
    assert_int_equal(unpack_run(&info, &f, &out), OK);
    words[W * H - 1] = 1024;
    assert_int_equal(unpack_check(&info, &f), OK);
    expect_err(unpack_run(&info, &f, &out), ERR_FORMAT, "words with bits 0x400, not 10 bits");
}

/* ---- YUV ---- */

static double clip(double v)
{
    return fmin(fmax(v, 0.0), 255.0);
}

/* By BT.601 and BT.709, section 3 each, with their inverse written out. */
static void yuv_formula(const struct camera_info *info, const int yuv[3], double rgb[3])
{
    double kr = info->bt709 ? 0.2126 : 0.299, kb = info->bt709 ? 0.0722 : 0.114;
    double y = info->limited ? (yuv[0] - 16) / 219.0 : yuv[0] / 255.0;
    double cb = (yuv[1] - 128) / (info->limited ? 224.0 : 255.0);
    double cr = (yuv[2] - 128) / (info->limited ? 224.0 : 255.0);
    double r = y + 2.0 * (1.0 - kr) * cr, b = y + 2.0 * (1.0 - kb) * cb;
    rgb[0] = clip(255.0 * r);
    rgb[1] = clip(255.0 * (y - kr * r - kb * b) / (1.0 - kr - kb));
    rgb[2] = clip(255.0 * b);
}

static int sample(int i)
{
    return i * 73 % 256;
}

/* Where Y, U and V of a pixel are in the bytes. */
static void places(enum camera_format format, int stride, int x, int y, int at[3])
{
    if (format == CAMERA_YUYV) {
        at[0] = y * stride + 2 * x;
        at[1] = y * stride + x / 2 * 4 + 1;
        at[2] = at[1] + 2;
    } else {
        at[0] = y * stride + x;
        at[1] = (H + y / 2) * stride + x / 2 * 2;
        at[2] = at[1] + 1;
    }
}

static void test_yuv(void **state)
{
    (void)state;
    for (int k = 0; k < 16; k++) {
        enum camera_format format = k & 1 ? CAMERA_NV12 : CAMERA_YUYV;
        int row = format == CAMERA_NV12 ? W : 2 * W, rows = format == CAMERA_NV12 ? H / 2 * 3 : H;
        struct camera_info info = info_of(format, 8, row + (k & 8 ? PAD : 0));
        size_t bytes = (size_t)(info.stride * (rows - 1) + row);
        uint8_t *data = malloc(bytes);
        struct frame f = frame_of(&info, data, bytes);
        struct raw out = {.px = px};
        info.limited = k & 2;
        info.bt709 = k & 4;
        assert_non_null(data);
        for (size_t i = 0; i < bytes; i++)
            data[i] = (uint8_t)sample((int)i + 1000 * k);
        assert_int_equal(unpack_count(&info), 3 * W * H);
        assert_int_equal(unpack_run(&info, &f, &out), OK);
        assert_true(out.cfa == RAW_RGB && out.bits == 8 && out.black == 0 && !out.linear);
        for (int i = 0; i < W * H; i++) {
            int at[3];
            double rgb[3];
            places(format, info.stride, i % W, i / W, at);
            const int yuv[3] = {data[at[0]], data[at[1]], data[at[2]]};
            yuv_formula(&info, yuv, rgb);
            for (int c = 0; c < 3; c++)
                assert_true(fabs(px[3 * i + c] - rgb[c]) < 0.51);
        }
        f.bytes--;
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "its format needs");
        free(data);
    }
}

/* ---- JPEG ---- */

struct file {
    uint8_t p[4096];
    size_t n;
};

static void load(const char *name, struct file *out)
{
    char path[128];
    snprintf(path, sizeof path, "tests/data/img/%s", name);
    FILE *f = fopen(path, "rb");
    assert_non_null(f);
    out->n = fread(out->p, 1, sizeof out->p, f);
    assert_in_range(out->n, 100, sizeof out->p - 1);
    fclose(f);
}

static const struct camera_info jpeg_info = {
    .format = CAMERA_MJPG, .w = 24, .h = 16, .bits = 8, .stride = 0};

static err_t run(const struct file *file, bool check_only)
{
    uint8_t *copy = malloc(file->n ? file->n : 1);
    assert_non_null(copy);
    memcpy(copy, file->p, file->n);
    struct frame f = frame_of(&jpeg_info, copy, file->n);
    struct raw out = {.px = px};
    err_t e = check_only ? unpack_check(&jpeg_info, &f) : unpack_run(&jpeg_info, &f, &out);
    if (!e && !check_only)
        assert_true(out.cfa == RAW_RGB && out.w == 24 && out.h == 16 && out.bits == 8);
    free(copy);
    return e;
}

static void test_jpeg(void **state)
{
    static const char *const names[] = {"rgb.jpg", "progressive.jpg", "grey.jpg", "restart.jpg"};
    (void)state;
    for (size_t k = 0; k < sizeof names / sizeof names[0]; k++) {
        struct file file;
        struct image8 want;
        load(names[k], &file);
        memset(px, 0xEE, sizeof px);
        assert_int_equal(unpack_count(&jpeg_info), 24 * 16 * 3);
        assert_int_equal(run(&file, true), OK);
        assert_int_equal(run(&file, false), OK);
        assert_int_equal(img_read_mem(file.p, file.n, names[k], &want), OK);
        for (int i = 0; i < 24 * 16 * 3; i++)
            assert_int_equal(px[i], want.px[i]);
        assert_int_equal(px[24 * 16 * 3], 0xEEEE);
        img_free(&want);
        for (int i = 0; i < 64; i++) // padding
            file.p[file.n++] = (uint8_t)(i % 3 ? 0 : 0xFF);
        assert_int_equal(run(&file, false), OK);
    }
}

/* Take the segments with that marker out. */
static void cut_segments(struct file *f, int marker)
{
    for (size_t at = 2; f->p[at + 1] != 0xDA;) {
        size_t n = 2 + (size_t)(f->p[at + 2] << 8 | f->p[at + 3]);
        if (f->p[at + 1] != marker) {
            at += n;
            continue;
        }
        memmove(f->p + at, f->p + at + n, f->n - at - n);
        f->n -= n;
    }
}

/* Motion JPEG may leave the standard tables out. */
static void test_jpeg_without_tables(void **state)
{
    static uint16_t whole[24 * 16 * 3];
    struct file file;
    (void)state;
    load("rgb.jpg", &file);
    assert_int_equal(run(&file, false), OK);
    memcpy(whole, px, sizeof whole);
    size_t n = file.n;
    cut_segments(&file, 0xC4);
    assert_true(file.n + 400 < n);
    assert_int_equal(run(&file, false), OK);
    assert_memory_equal(whole, px, sizeof whole);
    cut_segments(&file, 0xE0);
    assert_int_equal(run(&file, false), OK);
    cut_segments(&file, 0xDB); // no quantization is no picture
    assert_int_equal(run(&file, false), ERR_FORMAT);
}

static void test_jpeg_cut(void **state)
{
    static const char *const names[] = {"rgb.jpg", "progressive.jpg", "restart.jpg"};
    (void)state;
    for (size_t k = 0; k < sizeof names / sizeof names[0]; k++) {
        struct file file;
        load(names[k], &file);
        while (file.n-- > 0) // the last byte is the end's second
            expect_err(run(&file, true), ERR_FORMAT, "frame 77: JPEG of");
        load(names[k], &file);
        memset(file.p + file.n - 4, 0, 4); // zeros instead of the end
        expect_err(run(&file, true), ERR_FORMAT, "no end of the picture");
    }
    struct file file;
    load("rgb.jpg", &file); // headers and an end, nothing between them
    size_t scan = 2;
    while (file.p[scan + 1] != 0xDA)
        scan += 2 + (size_t)(file.p[scan + 2] << 8 | file.p[scan + 3]);
    file.p[scan + 1] = 0xD9;
    file.n = scan + 2;
    expect_err(run(&file, true), ERR_FORMAT, "no picture");
    load("rgb.jpg", &file);
    memmove(file.p + file.n - 60, file.p + file.n - 2, 2); // a hole in the scan
    file.n -= 58;
    assert_int_equal(run(&file, true), OK);
    expect_err(run(&file, false), ERR_FORMAT, "frame 77: JPEG:");
}

static void test_jpeg_wrong(void **state)
{
    struct file file;
    struct raw out = {.px = px};
    (void)state;
    load("rgb.jpg", &file);
    for (int k = 0; k < 2; k++) {
        struct camera_info info = jpeg_info;
        info.w += k == 0 ? 8 : 0;
        info.h -= k == 1 ? 8 : 0;
        struct frame f = frame_of(&info, file.p, file.n);
        expect_err(unpack_check(&info, &f), ERR_FORMAT, "JPEG of 24 x 16 px, not");
    }
    for (int k = 0; k < 2; k++) {
        struct image8 small = {24 - k, 15 + k, 3, (uint8_t *)px};
        expect_err(img_decode_jpeg(file.p, file.n, "it", &small), ERR_FORMAT,
                   "it: JPEG of 24 x 16 px");
    }
    load("cmyk.jpg", &file);
    assert_int_not_equal(run(&file, false), OK);
    struct frame none = frame_of(&jpeg_info, NULL, 100);
    expect_err(unpack_run(&jpeg_info, &none, &out), ERR_FORMAT, "no start of a picture");
    load("rgb.jpg", &file);
    file.p[0] = 0xFE;
    expect_err(run(&file, true), ERR_FORMAT, "no start of a picture");
    load("rgb.jpg", &file);
    for (size_t i = 0; i < file.n; i++) { // any single byte: refused or decoded, never worse
        uint8_t was = file.p[i];
        file.p[i] = (uint8_t)(was ^ 0xFF);
        err_t e = run(&file, false);
        assert_true(e == OK || e == ERR_FORMAT || e == ERR_UNSUPPORTED);
        file.p[i] = was;
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_formats),
        cmocka_unit_test(test_bounds),
        cmocka_unit_test(test_promises),
        cmocka_unit_test(test_words_beyond_their_bits),
        cmocka_unit_test(test_yuv),
        cmocka_unit_test(test_jpeg),
        cmocka_unit_test(test_jpeg_without_tables),
        cmocka_unit_test(test_jpeg_cut),
        cmocka_unit_test(test_jpeg_wrong),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
