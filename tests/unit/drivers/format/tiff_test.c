/* TIFF files that libtiff writes, of all layouts that are read; what is refused; broken ones. */
#include "drivers/format/tiff.h"

#include "drivers/format/imgsize.h"
#include "drivers/format/pixels.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <tiffio.h>

enum { W = 37, H = 22, TILE = 16 };

struct layout {
    const char *mode;                              // of TIFFOpen: l or b is the byte order
    int bits, channels, planar, compression, rows; // rows of a strip; 0: tiles
    int orientation;
};

static const struct layout plain = {
    "wl", 16, 3, PLANARCONFIG_CONTIG, COMPRESSION_NONE, 5, ORIENTATION_TOPLEFT};

static uint16_t value(const struct layout *l, int x, int y, int c)
{
    const uint32_t v = (uint32_t)(x * 1733 + y * 977 + c * 12345) & 0xffff;
    return (uint16_t)(l->bits == 8 ? (v >> 8) * 257 : v);
}

static void put_sample(const struct layout *l, void *px, size_t i, int x, int y, int c)
{
    if (l->bits == 8)
        ((uint8_t *)px)[i] = (uint8_t)(value(l, x, y, c) / 257);
    else
        ((uint16_t *)px)[i] = value(l, x, y, c);
}

/* One block of one plane (or all: -1) at x, y. */
static void put_block(TIFF *t, const struct layout *l, int plane, int x0, int y0)
{
    static uint8_t px[W * H * 5 * 2 + TILE * TILE * 10];
    const int w = l->rows ? W : TILE, h = l->rows ? l->rows : TILE;
    const int n = plane < 0 ? l->channels : 1;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++)
            for (int c = 0; c < n; c++)
                put_sample(l, px, (size_t)((y * w + x) * n + c), x0 + x, y0 + y,
                           plane < 0 ? c : plane);
    const tmsize_t rows = l->rows && H - y0 < h ? H - y0 : h, bytes = rows * w * n * (l->bits / 8);
    const uint32_t ux = (uint32_t)x0, uy = (uint32_t)y0;
    const uint16_t s = (uint16_t)(plane < 0 ? 0 : plane);
    if (l->rows)
        assert_true(TIFFWriteEncodedStrip(t, TIFFComputeStrip(t, uy, s), px, bytes) == bytes);
    else
        assert_true(TIFFWriteEncodedTile(t, TIFFComputeTile(t, ux, uy, 0, s), px, bytes) == bytes);
}

static void write_exif(TIFF *t)
{
    const uint16_t iso = 400;
    uint64_t at;
    assert_true(TIFFWriteDirectory(t) && TIFFCreateEXIFDirectory(t) == 0);
    TIFFSetField(t, EXIFTAG_EXPOSURETIME, 0.008);
    TIFFSetField(t, EXIFTAG_FNUMBER, 2.8);
    TIFFSetField(t, EXIFTAG_ISOSPEEDRATINGS, 1, &iso);
    TIFFSetField(t, EXIFTAG_FOCALLENGTHIN35MMFILM, 28);
    TIFFSetField(t, EXIFTAG_FOCALLENGTH, 5.0);
    TIFFSetField(t, EXIFTAG_FOCALPLANEXRESOLUTION, 2540.0);
    TIFFSetField(t, EXIFTAG_FOCALPLANERESOLUTIONUNIT, 2);
    TIFFSetField(t, EXIFTAG_PIXELXDIMENSION, 640);
    TIFFSetField(t, EXIFTAG_PIXELYDIMENSION, 480);
    assert_true(TIFFWriteCustomDirectory(t, &at));
    assert_true(TIFFSetDirectory(t, 0));
    TIFFSetField(t, TIFFTAG_EXIFIFD, at);
    assert_true(TIFFRewriteDirectory(t));
}

static const char *write_tiff(const struct layout *l, bool exif)
{
    const char *path = tmpdir_path("a.tif");
    TIFF *t = TIFFOpen(path, l->mode);
    assert_non_null(t);
    TIFFSetField(t, TIFFTAG_IMAGEWIDTH, W);
    TIFFSetField(t, TIFFTAG_IMAGELENGTH, H);
    TIFFSetField(t, TIFFTAG_BITSPERSAMPLE, l->bits);
    TIFFSetField(t, TIFFTAG_SAMPLESPERPIXEL, l->channels);
    TIFFSetField(t, TIFFTAG_PHOTOMETRIC,
                 l->channels < 3 ? PHOTOMETRIC_MINISBLACK : PHOTOMETRIC_RGB);
    TIFFSetField(t, TIFFTAG_PLANARCONFIG, l->planar);
    TIFFSetField(t, TIFFTAG_COMPRESSION, l->compression);
    TIFFSetField(t, TIFFTAG_ORIENTATION, l->orientation);
    TIFFSetField(t, TIFFTAG_MAKE, "Maker");
    TIFFSetField(t, TIFFTAG_MODEL, "Model 1");
    if (l->rows)
        TIFFSetField(t, TIFFTAG_ROWSPERSTRIP, l->rows);
    else {
        TIFFSetField(t, TIFFTAG_TILEWIDTH, TILE);
        TIFFSetField(t, TIFFTAG_TILELENGTH, TILE);
    }
    const int planes = l->planar == PLANARCONFIG_SEPARATE ? l->channels : 1;
    const int w = l->rows ? W : TILE, h = l->rows ? l->rows : TILE;
    for (int p = 0; p < planes; p++)
        for (int y = 0; y < H; y += h)
            for (int x = 0; x < W; x += w)
                put_block(t, l, planes > 1 ? p : -1, x, y);
    if (exif)
        write_exif(t);
    TIFFClose(t);
    return path;
}

static void check_pixels(const struct layout *l)
{
    struct shot s = {.linear = true};
    struct image16 im;
    const char *path = write_tiff(l, false);
    const bool turned = l->orientation == ORIENTATION_RIGHTTOP;
    expect_ok(imgsize_read(path, &s.taken_w, &s.taken_h));
    expect_ok(pixels_look(path, &s));
    assert_true(s.deep && !s.linear);
    assert_true(s.taken_w == (turned ? H : W) && s.taken_h == (turned ? W : H));
    expect_ok(pixels_decode16(path, &s, &im));
    for (int y = 0; y < im.h; y++)
        for (int x = 0; x < im.w; x++)
            for (int c = 0; c < 3; c++)
                assert_int_equal(
                    im.px[3 * (y * im.w + x) + c],
                    value(l, turned ? y : x, turned ? H - 1 - x : y, l->channels < 3 ? 0 : c));
    pixels_free16(&im);
}

static void all_layouts(void **state)
{
    (void)state;
    static const int compressions[] = {COMPRESSION_NONE, COMPRESSION_LZW, COMPRESSION_ADOBE_DEFLATE,
                                       COMPRESSION_PACKBITS};
    static const char *const modes[] = {"wl", "wb"};
    for (int k = 0; k < 2 * 2 * 2 * 2 * 4; k++) {
        struct layout l = plain;
        l.mode = modes[k & 1];
        l.bits = k & 2 ? 8 : 16;
        l.rows = k & 4 ? 0 : 5;
        l.planar = k & 8 ? PLANARCONFIG_SEPARATE : PLANARCONFIG_CONTIG;
        l.compression = compressions[k >> 4];
        for (l.channels = 1; l.channels <= 5; l.channels++)
            check_pixels(&l);
    }
    struct layout one = plain, turned = plain;
    one.rows = H;
    check_pixels(&one);
    turned.orientation = ORIENTATION_RIGHTTOP;
    check_pixels(&turned);
}

static void exif_data(void **state)
{
    (void)state;
    struct img_exif x;
    struct img_camera c;
    const char *path = write_tiff(&plain, true);
    expect_ok(pixels_exif(path, &x));
    assert_true(fabs(x.seconds - 0.008) < 1e-6 && x.iso == 400 && fabs(x.f_number - 2.8) < 1e-6);
    expect_ok(pixels_camera(path, &c));
    assert_true(c.focal_35mm == 28 && c.orientation == 1);
    assert_true(fabs(c.focal_plane - 500.0 / 640) < 1e-6);
    assert_string_equal(c.name, "Maker Model 1");
    path = write_tiff(&plain, false);
    expect_err(pixels_exif(path, &x), ERR_FORMAT, "no ExposureTime");
}

static void refused(void **state)
{
    (void)state;
    int w, h;
    TIFF *t = TIFFOpen(tmpdir_path("f.tif"), "w");
    static float row[3 * W];
    TIFFSetField(t, TIFFTAG_IMAGEWIDTH, W);
    TIFFSetField(t, TIFFTAG_IMAGELENGTH, 1);
    TIFFSetField(t, TIFFTAG_BITSPERSAMPLE, 32);
    TIFFSetField(t, TIFFTAG_SAMPLESPERPIXEL, 3);
    TIFFSetField(t, TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_IEEEFP);
    TIFFSetField(t, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_RGB);
    TIFFSetField(t, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFWriteScanline(t, row, 0, 0);
    TIFFClose(t);
    expect_err(imgsize_read(tmpdir_path("f.tif"), &w, &h), ERR_FORMAT, "32 bits in floats");

    uint8_t bytes[10 + 12 * 6 + 4] = {'I', 'I', '*', 0, 8, 0, 0, 0, 6, 0};
    static const uint16_t tags[6][2] = {{256, 10000}, {257, 10000}, {258, 8},
                                        {262, 1},     {273, 20},    {279, 10}};
    for (int i = 0; i < 6; i++) { // SHORT, 1 value
        const uint8_t entry[12] = {
            (uint8_t)tags[i][0],       1, 3, 0, 1, 0, 0, 0, (uint8_t)tags[i][1],
            (uint8_t)(tags[i][1] >> 8)};
        memcpy(bytes + 10 + 12 * i, entry, 12);
    }
    expect_err(imgsize_parse("huge", bytes, sizeof bytes, &w, &h), ERR_FORMAT,
               "cannot hold 10000 x 10000 px");
}

/* Any end and any changed byte: a picture or a sentence. */
static void broken(void **state)
{
    (void)state;
    struct layout l = plain;
    l.compression = COMPRESSION_LZW;
    l.rows = 0;
    write_tiff(&l, true);
    static uint8_t whole[1 << 16], bytes[1 << 16];
    FILE *f = fopen(tmpdir_path("a.tif"), "rb");
    const size_t n = fread(whole, 1, sizeof whole, f);
    fclose(f);
    assert_true(n > 1000 && n < sizeof whole);
    for (size_t i = 0; i < 2 * n; i += i < n ? 7 : 3) {
        struct image16 im;
        struct img_info info;
        memcpy(bytes, whole, n);
        if (i >= n)
            bytes[i - n] ^= (uint8_t)(1 + i % 255);
        const size_t size = i < n ? i : n;
        if (tiff_look(bytes, size, "broken", &info) == OK)
            assert_true(info.w >= 1 && info.h >= 1);
        const err_t e = tiff_read(bytes, size, "broken", &im);
        assert_true(e == OK ? im.px != NULL : im.px == NULL);
        free(im.px);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(all_layouts), cmocka_unit_test(exif_data),
                                       cmocka_unit_test(refused), cmocka_unit_test(broken)};
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
