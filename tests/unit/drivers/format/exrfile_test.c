/* tests/data/exr: 21 x 19 px, channel c of R, G, B holds k = (x + 21 y) (c + 1) as k / 64 (exact in
 * half and float) or as the uint k; made with the OpenEXR Python module 3.5, one file per
 * compression, type and layout that the name says. */
#include "drivers/format/exrfile.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <float.h>
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

#include <OpenEXR/openexr.h>

enum { W = 21, H = 19, N = W * H };

static float stored(int c, int i)
{
    return (float)(i * (c + 1)) / 64.0f;
}

static void reads_what_others_wrote(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        float scale;
        bool grey;
    } files[] = {
        {"no_half", 1, false},   {"rle_half", 1, false},       {"zips_half", 1, false},
        {"zip_half", 1, false},  {"piz_half", 1, false},       {"pxr24_half", 1, false},
        {"piz_float", 1, false}, {"no_float", 1, false},       {"zip_uint", 64, false},
        {"zip_mixed", 1, false}, {"window_shifted", 1, false}, {"tiled", 1, false},
        {"zip_grey", 1, true},   {"zip_grey_az", 1, true},
    };
    for (size_t f = 0; f < sizeof files / sizeof files[0]; f++) {
        struct image im;
        char path[128];
        snprintf(path, sizeof path, "tests/data/exr/%s.exr", files[f].name);
        if (exrfile_read(path, &im) != OK)
            fail_msg("%s", err_text());
        assert_true(im.w == W && im.h == H && im.channels == 3);
        for (int i = 0; i < 3 * N; i++)
            if (im.px[i] != files[f].scale * stored(files[f].grey ? 0 : i / N, i % N))
                fail_msg("%s: sample %d is %g", path, i, (double)im.px[i]);
        exrfile_free(&im);
    }
}

static void refuses_what_it_cannot_read(void **state)
{
    (void)state;
    struct image im;
    expect_err(exrfile_read("tests/data/exr/b44_half.exr", &im), ERR_UNSUPPORTED, "B44");
    expect_err(exrfile_read("tests/data/exr/dwaa_half.exr", &im), ERR_UNSUPPORTED, "DWA");
    expect_err(exrfile_read("tests/data/exr/window_cropped.exr", &im), ERR_UNSUPPORTED,
               "display window (0 0 30 30)");
    expect_err(exrfile_read("tests/data/exr/zip_no_b.exr", &im), ERR_FORMAT, "no channel B");
    expect_err(exrfile_read("tests/data/exr/none.exr", &im), ERR_IO, "none.exr");
    assert_null(im.px);
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

/* Every truncation and every single wrong byte: an error or an image, never a crash. */
static void survives_damage(void **state)
{
    (void)state;
    static const char *const names[] = {"zip_mixed", "piz_half", "tiled", "rle_half", "pxr24_half"};
    for (size_t k = 0; k < sizeof names / sizeof names[0]; k++) {
        char path[128];
        size_t n;
        struct image im;
        snprintf(path, sizeof path, "tests/data/exr/%s.exr", names[k]);
        uint8_t *p = slurp(path, &n);
        for (size_t cut = 0; cut < n; cut++) {
            assert_int_not_equal(exrfile_read_mem(p, cut, path, &im), OK);
            assert_null(im.px);
        }
        for (size_t i = 0; i < n; i++) {
            p[i] ^= 0xff;
            if (exrfile_read_mem(p, n, path, &im) == OK)
                exrfile_free(&im);
            p[i] ^= 0xff;
        }
        free(p);
    }
}

/* An uncompressed chunk of fewer bytes than its row needs. */
static void refuses_short_chunk(void **state)
{
    (void)state;
    size_t n, row = 3 * W * 2;
    struct image im;
    uint8_t *p = slurp("tests/data/exr/no_half.exr", &n); // ends with row 18: y, size, data
    assert_int_equal(p[n - row - 8], H - 1);
    assert_int_equal(p[n - row - 4], row);
    p[n - row - 4] = 100;
    expect_err(exrfile_read_mem(p, n, "short", &im), ERR_FORMAT,
               "21 x 1 px in 100 bytes at (0, 18)");
    free(p);
}

/* A header may not make us allocate what the file cannot hold. */
static void refuses_more_than_the_file_holds(void **state)
{
    (void)state;
    static const uint8_t window[16] = {0,    0,    0, 0, 0,    0,    0, 0,
                                       0xff, 0x0f, 0, 0, 0xff, 0x0f, 0, 0}; // 4096 x 4096
    size_t n;
    struct image im;
    uint8_t *p = slurp("tests/data/exr/zip_half.exr", &n);
    const char *const names[2] = {"dataWindow", "displayWindow"};
    for (int i = 0; i < 2; i++) {
        uint8_t *at = memmem(p, n, names[i], strlen(names[i]));
        assert_non_null(at);
        memcpy(at + strlen(names[i]) + 1 + sizeof "box2i" + 4, window, sizeof window);
    }
    expect_err(exrfile_read_mem(p, n, "big", &im), ERR_FORMAT, "cannot hold 4096 x 4096");
    free(p);
}

static float px[3 * N], alpha[N], depth[N];

static void fill(struct image *im, int w, int h)
{
    *im = (struct image){w, h, 3, px};
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < N; i++)
            px[c * N + i] = stored(c, i);
    for (int i = 0; i < N; i++) {
        alpha[i] = (float)i / 512.0f;
        depth[i] = 1.0f + (float)i / 3.0f;
    }
}

static void round_trip(void **state)
{
    (void)state;
    for (int turn = 0; turn < 4; turn++) {
        struct image im, back;
        struct exrfile_extra extra = {.half = turn & 1};
        size_t saturated = 7;
        fill(&im, turn == 3 ? 1 : W, turn == 3 ? 1 : H);
        if (turn == 2) {
            extra.alpha = alpha;
            extra.depth = depth;
        }
        const char *path = tmpdir_path("round.exr");
        assert_int_equal(exrfile_write(path, &im, &extra, &saturated), OK);
        assert_int_equal(saturated, 0);
        assert_int_equal(exrfile_read(path, &back), OK);
        assert_true(back.w == im.w && back.h == im.h && back.channels == 3);
        assert_memory_equal(back.px, px, 3 * sizeof(float) * (size_t)(im.w * im.h));
        exrfile_free(&back);
    }
}

static void values_out_of_range(void **state)
{
    (void)state;
    float v[12] = {1e9f, -70000.0f, NAN, INFINITY, 65519.0f, 1e-9f, 0, 0, 0, -INFINITY, 0, FLT_MAX};
    const float half[12] = {65504, -65504, 0, 65504, 65504, 0, 0, 0, 0, -65504, 0, 65504};
    const float full[12] = {1e9f, -70000.0f, 0, FLT_MAX,  65519.0f, 1e-9f,
                            0,    0,         0, -FLT_MAX, 0,        FLT_MAX};
    struct image im = {2, 2, 3, v}, back;
    for (int h = 0; h < 2; h++) {
        struct exrfile_extra extra = {.half = h};
        size_t saturated;
        const char *path = tmpdir_path("range.exr");
        assert_int_equal(exrfile_write(path, &im, &extra, &saturated), OK);
        assert_int_equal(saturated, h ? 5 : 2);
        assert_int_equal(exrfile_read(path, &back), OK);
        for (int i = 0; i < 12; i++)
            assert_true(back.px[i] == (h ? half : full)[i]);
        exrfile_free(&back);
    }
}

/* The value of an attribute, found as name 0 type 0 size in the bytes of the file. */
static const float *attribute(const uint8_t *p, size_t n, const char *name, const char *type,
                              uint32_t size)
{
    uint8_t key[64];
    size_t a = strlen(name) + 1, b = strlen(type) + 1;
    static float value[16];
    memcpy(key, name, a);
    memcpy(key + a, type, b);
    memcpy(key + a + b, &size, 4);
    const uint8_t *at = memmem(p, n, key, a + b + 4);
    if (!at)
        fail_msg("no attribute %s of type %s", name, type);
    memcpy(value, at + a + b + 4, size);
    return value;
}

static void attributes(void **state)
{
    (void)state;
    /* x right, y down, z forward; turned by 90 degrees about y, so that world x is camera -z and
     * world z camera x */
    const struct camera cam = {.w = W,
                               .h = H,
                               .fx = 30,
                               .fy = 31,
                               .cx = 10,
                               .cy = 9,
                               .q = {0.70710678f, 0, 0.70710678f, 0},
                               .t = {1, 2, 3}};
    const float log2t = -3.5f;
    const struct exrfile_extra extra = {
        .half = true, .exposure_s = 0.25f, .log2t = &log2t, .cam = &cam};
    struct image im;
    size_t n;
    fill(&im, W, H);
    const char *path = tmpdir_path("attributes.exr");
    assert_int_equal(exrfile_write(path, &im, &extra, NULL), OK);
    uint8_t *p = slurp(path, &n);
    assert_true(*attribute(p, n, "expTime", "float", 4) == 0.25f);
    assert_true(*attribute(p, n, "hdrigExposureLog2", "float", 4) == -3.5f);
    assert_true(attribute(p, n, "hdrigFocal", "v2f", 8)[1] == 31.0f);
    assert_true(attribute(p, n, "hdrigCentre", "v2f", 8)[1] == 9.0f);
    assert_true(fabsf(attribute(p, n, "chromaticities", "chromaticities", 32)[6] - 0.3127f) <
                1e-6f);
    /* world (4, 5, 6): camera x = 6 + 1, y = 5 + 2 down, z = -4 + 3; row vector times matrix, y
     * up */
    const float world[4] = {4, 5, 6, 1};
    float c[4] = {0}, d[4] = {0};
    const float *m = attribute(p, n, "worldToCamera", "m44f", 64);
    for (int i = 0; i < 16; i++)
        c[i % 4] += world[i / 4] * m[i];
    m = attribute(p, n, "worldToNDC", "m44f", 64);
    for (int i = 0; i < 16; i++)
        d[i % 4] += world[i / 4] * m[i];
    assert_true(fabsf(c[0] - 7) < 1e-5f && fabsf(c[1] + 7) < 1e-5f && fabsf(c[2] + 1) < 1e-5f &&
                c[3] == 1.0f);
    assert_true(fabsf(d[0] / d[3] - (30 * 7 / -1.0f + 10) / W) < 1e-4f);
    assert_true(fabsf(d[1] / d[3] - (31 * 7 / -1.0f + 9) / H) < 1e-4f);
    free(p);
}

/* ---- several parts, read back by the library ---- */

struct three {
    struct image im;
    float value[3]; // values of the parts
    int asked;
};

static err_t fill_part(void *ctx, int i, const struct image **out)
{
    struct three *t = ctx;
    if (i != t->asked++)
        return err_fail(ERR_ARG, "part %d out of turn", i);
    for (int k = 0; k < 3 * W * H; k++)
        t->im.px[k] = t->value[i] * (float)(k % 64);
    t->im.px[5] = NAN;
    *out = &t->im;
    return OK;
}

/* Channel `name` of a part, converted to float by the library. */
static void library_plane(exr_context_t f, int part, const char *name, float *out)
{
    int32_t lines;
    assert_int_equal(exr_get_scanlines_per_chunk(f, part, &lines), 0);
    for (int y = 0; y < H; y += lines) {
        exr_chunk_info_t chunk;
        exr_decode_pipeline_t pipe;
        assert_int_equal(exr_read_scanline_chunk_info(f, part, y, &chunk), 0);
        assert_int_equal(exr_decoding_initialize(f, part, &chunk, &pipe), 0);
        static float rest[3][W * H]; // the library wants a place for every channel
        for (int c = 0; c < pipe.channel_count; c++) {
            bool mine = strcmp(pipe.channels[c].channel_name, name) == 0;
            pipe.channels[c].decode_to_ptr = (uint8_t *)(mine ? out + y * W : rest[c]);
            pipe.channels[c].user_bytes_per_element = 4;
            pipe.channels[c].user_data_type = EXR_PIXEL_FLOAT;
            pipe.channels[c].user_pixel_stride = 4;
            pipe.channels[c].user_line_stride = 4 * W;
        }
        assert_int_equal(exr_decoding_choose_default_routines(f, part, &pipe), 0);
        assert_int_equal(exr_decoding_run(f, part, &pipe), 0);
        exr_decoding_destroy(f, &pipe);
    }
}

static void check_part(exr_context_t f, int part, float value)
{
    static const char *const names[3] = {"merged", "e00", "e01"}, *const rgb[3] = {"R", "G", "B"};
    static float plane[W * H];
    const char *got;
    float number;
    int32_t length;
    assert_int_equal(exr_get_name(f, part, &got), 0);
    assert_string_equal(got, names[part]);
    assert_int_equal(exr_attr_get_float(f, part, "expTime", &number), 0);
    assert_true(number == value);
    assert_int_equal(exr_attr_get_string(f, part, "capDate", &length, &got), 0);
    assert_string_equal(got, "2026:01:02 03:04:05");
    for (int c = 0; c < 3; c++) {
        library_plane(f, part, rgb[c], plane);
        for (int i = 0; i < W * H; i++)
            if (plane[i] != (c == 0 && i == 5 ? 0.0f : value * (float)((c * W * H + i) % 64)))
                fail_msg("part %d, %s, pixel %d: %g", part, rgb[c], i, (double)plane[i]);
    }
}

static void several_parts(void **state)
{
    (void)state;
    struct three t = {.value = {1.0f, 0.25f, 4.0f}};
    struct exrfile_attr attr[3][2] = {
        {{"expTime", NULL, 1.0f}, {"capDate", "2026:01:02 03:04:05", 0}},
        {{"expTime", NULL, 0.25f}, {"capDate", "2026:01:02 03:04:05", 0}},
        {{"expTime", NULL, 4.0f}, {"capDate", "2026:01:02 03:04:05", 0}}};
    const struct exrfile_part part[3] = {
        {"merged", attr[0], 2}, {"e00", attr[1], 2}, {"e01", attr[2], 2}};
    struct exrfile_parts p = {3, W, H, part, fill_part, &t};
    const char *path = tmpdir_path("parts.exr");
    FILE *f = fopen(path, "wb");
    fill(&t.im, W, H);
    assert_int_equal(exrfile_put_parts(f, path, &p), OK);
    fclose(f);
    assert_int_equal(t.asked, 3);
    exr_context_t x;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    int n;
    assert_int_equal(exr_start_read(&x, path, &init), 0);
    assert_int_equal(exr_get_count(x, &n), 0);
    assert_int_equal(n, 3);
    for (int i = 0; i < n; i++)
        check_part(x, i, t.value[i]);
    exr_finish(&x);
    struct image first;
    assert_int_equal(exrfile_read(path, &first), OK);
    assert_true(first.px[7] == 7.0f);
    exrfile_free(&first);
    p.w = W - 1;
    t.asked = 0;
    f = fopen(path, "wb");
    expect_err(exrfile_put_parts(f, path, &p), ERR_ARG, "part merged is 21 x 19");
    fclose(f);
    f = fopen("/dev/full", "wb");
    p.w = W;
    t.asked = 0;
    assert_true(exrfile_put_parts(f, "full", &p) != OK || fflush(f) != 0);
    fclose(f);
}

static void writing_fails_cleanly(void **state)
{
    (void)state;
    struct image im;
    const struct exrfile_extra extra = {0};
    const struct rlimit small = {1000, RLIM_INFINITY};
    struct rlimit old;
    fill(&im, W, H);
    expect_err(exrfile_write(tmpdir_path("no/such/folder.exr"), &im, &extra, NULL), ERR_IO,
               "folder.exr");
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    const char *path = tmpdir_path("full.exr");
    err_t e = exrfile_write(path, &im, &extra, NULL);
    setrlimit(RLIMIT_FSIZE, &old);
    expect_err(e, ERR_IO, "File too large");
    assert_int_not_equal(access(path, F_OK), 0);
    if (access("/dev/full", W_OK) == 0) {
        assert_int_equal(exrfile_write("/dev/full", &im, &extra, NULL), ERR_LIMIT);
        assert_int_equal(access("/dev/full", W_OK), 0);
    }
    im.channels = 2;
    expect_err(exrfile_write(path, &im, &extra, NULL), ERR_ARG, "2 channels");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reads_what_others_wrote),
        cmocka_unit_test(refuses_what_it_cannot_read),
        cmocka_unit_test(survives_damage),
        cmocka_unit_test(refuses_short_chunk),
        cmocka_unit_test(refuses_more_than_the_file_holds),
        cmocka_unit_test(round_trip),
        cmocka_unit_test(values_out_of_range),
        cmocka_unit_test(attributes),
        cmocka_unit_test(several_parts),
        cmocka_unit_test(writing_fails_cleanly),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
}
