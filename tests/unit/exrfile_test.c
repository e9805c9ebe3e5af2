/* tests/data/exr: 21 x 19 px, channel c of R, G, B holds k = (x + 21 y) (c + 1) as k / 64 (exact in
 * half and float) or as the uint k; made with the OpenEXR Python module 3.5, one file per
 * compression, type and layout that the name says. */
#include "drivers/exrfile.h"
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

enum { W = 21, H = 19, N = W * H };

static float stored(int c, int i)
{
    return (float)(i * (c + 1)) / 64.0f;
}

static void says(err_t got, err_t want, const char *words)
{
    if (got != want || !strstr(err_text(), words))
        fail_msg("%s, \"%s\" instead of %s with \"%s\"", err_name(got), err_text(), err_name(want),
                 words);
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
    says(exrfile_read("tests/data/exr/b44_half.exr", &im), ERR_UNSUPPORTED, "B44");
    says(exrfile_read("tests/data/exr/dwaa_half.exr", &im), ERR_UNSUPPORTED, "DWA");
    says(exrfile_read("tests/data/exr/window_cropped.exr", &im), ERR_UNSUPPORTED,
         "display window (0 0 30 30)");
    says(exrfile_read("tests/data/exr/zip_no_b.exr", &im), ERR_FORMAT, "no channel B");
    says(exrfile_read("tests/data/exr/none.exr", &im), ERR_IO, "none.exr");
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
    says(exrfile_read_mem(p, n, "short", &im), ERR_FORMAT, "21 x 1 px in 100 bytes at (0, 18)");
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
    says(exrfile_read_mem(p, n, "big", &im), ERR_FORMAT, "cannot hold 4096 x 4096");
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

static void writing_fails_cleanly(void **state)
{
    (void)state;
    struct image im;
    const struct exrfile_extra extra = {0};
    const struct rlimit small = {1000, RLIM_INFINITY};
    struct rlimit old;
    fill(&im, W, H);
    says(exrfile_write(tmpdir_path("no/such/folder.exr"), &im, &extra, NULL), ERR_IO, "folder.exr");
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    const char *path = tmpdir_path("full.exr");
    err_t e = exrfile_write(path, &im, &extra, NULL);
    setrlimit(RLIMIT_FSIZE, &old);
    says(e, ERR_IO, "File too large");
    assert_int_not_equal(access(path, F_OK), 0);
    if (access("/dev/full", W_OK) == 0) {
        assert_int_equal(exrfile_write("/dev/full", &im, &extra, NULL), ERR_LIMIT);
        assert_int_equal(access("/dev/full", W_OK), 0);
    }
    im.channels = 2;
    says(exrfile_write(path, &im, &extra, NULL), ERR_ARG, "2 channels");
}

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    tmpdir_remove();
    return 0;
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
        cmocka_unit_test(writing_fails_cleanly),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
