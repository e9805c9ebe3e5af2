#include "drivers/format/spz.h"
#include "drivers/format/spzwrite.h"

#include "core/base/bytes.h"
#include "core/kernels/kernels.h"
#include "core/splat/display.h"
#include "drivers/format/compressed.h"
#include "drivers/format/file.h"

#include "tests/unit/tmpdir.h"

#include <fcntl.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#define C0 0.28209479177387814

static struct arena arena;
static unsigned seed;

/* -1 to 1. */
static float noise(void)
{
    seed = seed * 1664525u + 1013904223u;
    return (float)((int)(seed >> 8) - (1 << 23)) / (1 << 23);
}

/* n splats in a box of this half side, sigma a twentieth of that and less; radiance 1e-4 to 1e5. */
static struct scene make(int n, int degree, float side)
{
    struct scene s = {0};
    seed = 7;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 4 << 20), OK);
    assert_int_equal(gaussians_init(&s.g, &arena, n, degree), OK);
    s.g.n = n;
    display_tonemap(0.5f, &s.tone);
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) {
            s.g.plane[G_MU + k][i] = side * noise();
            s.g.plane[G_LOG_SCALE + k][i] = logf(side) - 4 + noise();
            s.g.plane[G_SH + k][i] = (float)((1.15 + 10.3 * (double)noise()) / C0);
        }
        for (int k = 0; k < 4; k++)
            s.g.plane[G_QUAT + k][i] = 3 * noise();
        s.g.plane[G_LOGIT][i] = 5 * noise();
        for (int p = G_SH + 3; p < gaussians_planes(degree); p++)
            s.g.plane[p][i] = 0.5f * noise();
    }
    return s;
}

static struct gaussians read_back(const char *path, const struct scene *s)
{
    struct splats_info info;
    struct gaussians g;
    struct gaussians_report report;
    assert_int_equal(splats_peek(&spz_format, path, &info), OK);
    assert_true(info.n == s->g.n && info.degree == s->g.degree && info.has_hdr && !info.band_lost);
    assert_true(info.ev == display_ev(&s->tone));
    assert_int_equal(splats_read(&spz_format, path, 9, &arena, &g, &report), OK);
    assert_true(g.n == info.n && g.degree == info.degree && !report.dropped);
    return g;
}

static double worst(const struct gaussians *a, const struct gaussians *b, int from, int to)
{
    double most = 0;
    for (int p = from; p < to; p++)
        for (int i = 0; i < a->n; i++)
            most = fmax(most, fabs((double)a->plane[p][i] - (double)b->plane[p][i]));
    return most;
}

/* R S S R': what a splat is, whichever way its axes are named. */
static void shape(const struct gaussians *g, int i, double out[9])
{
    double q[4], n = 0;
    for (int k = 0; k < 4; k++) {
        q[k] = (double)g->plane[G_QUAT + k][i];
        n += q[k] * q[k];
    }
    double w = q[0] / sqrt(n), x = q[1] / sqrt(n), y = q[2] / sqrt(n), z = q[3] / sqrt(n);
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    for (int a = 0; a < 9; a++) {
        out[a] = 0;
        for (int k = 0; k < 3; k++)
            out[a] +=
                r[a / 3 * 3 + k] * r[a % 3 * 3 + k] * exp(2 * (double)g->plane[G_LOG_SCALE + k][i]);
    }
}

/* Largest difference of the shapes of splat i, as share of the largest number. */
static double bent(const struct gaussians *a, const struct gaussians *b, int i)
{
    double s[9], t[9], most = 0, size = 0;
    shape(a, i, s);
    shape(b, i, t);
    for (int k = 0; k < 9; k++) {
        most = fmax(most, fabs(s[k] - t[k]));
        size = fmax(size, fabs(s[k]));
    }
    return most / size;
}

static void check_near(const struct scene *s, const struct gaussians *g, float side)
{
    double sigma = exp(-4) * (double)side;
    assert_true(worst(&s->g, g, G_MU, G_MU + 3) <= sigma / 3);
    assert_true(worst(&s->g, g, G_SH, G_SH + 3) * C0 <= 1.0 / 32 + 1e-5);
    assert_true(worst(&s->g, g, G_SH + 3, gaussians_planes(g->degree)) <= 1.0 / 32 + 1e-5);
    for (int i = 0; i < g->n; i++) {
        double a = 1 / (1 + exp(-(double)s->g.plane[G_LOGIT][i]));
        double b = 1 / (1 + exp(-(double)g->plane[G_LOGIT][i]));
        assert_true(fabs(a - b) <= 0.501 / 255);
        assert_true(bent(&s->g, g, i) < 0.14);
    }
}

static void every_degree_comes_back_in_both_versions(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct scene s = make(300, degree, 1);
        assert_int_equal(spzwrite_scene(tmpdir_path("3.spz"), &s, 3), OK);
        assert_int_equal(spzwrite_scene(tmpdir_path("4.spz"), &s, 4), OK);
        struct gaussians g3 = read_back(tmpdir_path("3.spz"), &s);
        struct gaussians g4 = read_back(tmpdir_path("4.spz"), &s);
        check_near(&s, &g3, 1);
        for (int p = 0; p < gaussians_planes(degree); p++)
            assert_memory_equal(g3.plane[p], g4.plane[p], 300 * sizeof(float));
    }
}

static void scenes_of_any_size_keep_their_precision(void **state)
{
    (void)state;
    for (int e = -5; e <= 6; e++) {
        float side = powf(10, (float)e);
        struct scene s = make(200, 1, side);
        assert_int_equal(spzwrite_scene(tmpdir_path("sized.spz"), &s, 3), OK);
        struct gaussians g = read_back(tmpdir_path("sized.spz"), &s);
        check_near(&s, &g, side);
    }
}

static void odd_scenes_are_written(void **state)
{
    (void)state;
    for (int version = 3; version <= 4; version++) {
        const char *path = tmpdir_path("odd.spz");
        for (int n = 0; n <= 1; n++) {
            struct scene s = make(n, 2, 1);
            assert_int_equal(spzwrite_scene(path, &s, version), OK);
            read_back(path, &s);
        }
        struct scene s = make(20000, 0, 1); // all alike, in the origin: shrinks a thousandfold
        for (int p = 0; p < gaussians_planes(0); p++)
            for (int i = 0; i < s.g.n; i++)
                s.g.plane[p][i] = p == G_QUAT || p >= G_SH ? 1 : 0;
        assert_int_equal(spzwrite_scene(path, &s, version), OK);
        struct gaussians g = read_back(path, &s);
        assert_true(g.plane[G_MU][19999] == 0);
        s = make(3, 1, 1); // beyond everything
        s.g.plane[G_LOG_SCALE][0] = -1e30f;
        s.g.plane[G_LOG_SCALE][1] = 1e30f;
        s.g.plane[G_MU][2] = -3e38f;
        s.g.plane[G_LOGIT][0] = 1e30f;
        s.g.plane[G_SH][1] = -1e30f;
        s.g.plane[G_SH + 5][1] = 1e30f;
        s.g.plane[G_SH + 1][2] = (float)(55 / C0);
        assert_int_equal(spzwrite_scene(path, &s, version), OK);
        g = read_back(path, &s);
        assert_true(g.plane[G_MU][2] < -1e25f);
        assert_true(fabs((double)g.plane[G_SH + 1][2] * C0 - 55) < 0.04);
        s = make(300, 0, 1); // the longer a splat, the finer its angle
        for (int i = 0; i < 20; i++)
            s.g.plane[G_LOG_SCALE][i] = 0; // a size that is stored exactly
        assert_int_equal(spzwrite_scene(path, &s, version), OK);
        g = read_back(path, &s);
        for (int i = 0; i < 20; i++)
            assert_true(bent(&s.g, &g, i) < 0.02);
    }
}

/* Version 4 with another name of the record. No flag announces it: programs would warn. */
static void viewers_see_the_display_colours(void **state)
{
    (void)state;
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct scene s = make(60, degree, 1);
        for (int p = G_SH; p < gaussians_planes(degree); p++)
            for (int i = 0; i < 60; i++) // between black and 1.4 of the display
                s.g.plane[p][i] = p < G_SH + 3 ? -3 + noise() : 0.2f * noise();
        const char *path = tmpdir_path("seen.spz");
        assert_int_equal(spzwrite_scene(path, &s, 4), OK);
        FILE *f = fopen(path, "r+b");
        float unit = 0; // in the record, which lies behind the header
        assert_true(f && fseek(f, 48, SEEK_SET) == 0 && fread(&unit, 4, 1, f) == 1 && unit == 1);
        assert_true(fseek(f, 14, SEEK_SET) == 0 && fgetc(f) == 0);
        assert_true(fseek(f, 35, SEEK_SET) == 0 && fputc(0, f) == 0 && fclose(f) == 0);
        struct splats_info info;
        struct gaussians g;
        struct gaussians_report report;
        float ev = display_ev(&s.tone);
        assert_int_equal(splats_peek(&spz_format, path, &info), OK);
        assert_true(!info.has_hdr && info.degree == (degree < 3 ? degree : 3));
        assert_int_equal(splats_read(&spz_format, path, ev, &arena, &g, &report), OK);
        for (int i = 0; i < 60; i++) {
            float a[75], b[75], want[48], seen[48];
            for (int j = 0; j < gaussians_planes(degree) - G_SH; j++)
                a[j] = s.g.plane[G_SH + j][i];
            for (int j = 0; j < gaussians_planes(g.degree) - G_SH; j++)
                b[j] = g.plane[G_SH + j][i];
            display_from_radiance(a, degree, ev, want);
            display_from_radiance(b, g.degree, ev, seen);
            for (int j = 0; j < gaussians_planes(g.degree) - G_SH; j++)
                assert_true(fabsf(want[j] - seen[j]) < (j < 3 ? 0.03f : j < 12 ? 0.05f : 0.09f));
        }
    }
}

/* A scene of which every colour is too bright. */
static void display_colours_end_at_the_headroom(void **state)
{
    (void)state;
    struct scene s = make(1, 0, 1);
    struct gaussians g;
    struct gaussians_report report;
    const char *path = tmpdir_path("bright.spz");
    for (int c = 0; c < 3; c++)
        s.g.plane[G_SH + c][0] = 20;
    assert_int_equal(spzwrite_scene(path, &s, 4), OK);
    FILE *f = fopen(path, "r+b"); // the name of the record
    assert_true(f && fseek(f, 35, SEEK_SET) == 0 && fputc(0, f) == 0 && fclose(f) == 0);
    assert_int_equal(splats_read(&spz_format, path, 0, &arena, &g, &report), OK);
    assert_true(fabs((double)g.plane[G_SH][0] * C0 / log(2) - (double)spz_format.headroom) < 0.01);
}

static void what_cannot_be_written_says_why(void **state)
{
    (void)state;
    struct scene s = make(3, 0, 1);
    const char *path = tmpdir_path("none.spz");
    assert_int_equal(spzwrite_scene(path, &s, 2), ERR_ARG);
    for (int version = 3; version <= 4; version++)
        assert_int_equal(spzwrite_scene("/dev/full", &s, version), ERR_LIMIT);
    const char *pipe = tmpdir_path("pipe.spz"); // takes no second look at what was written
    assert_int_equal(mkfifo(pipe, 0600), 0);
    int fd = open(pipe, O_RDONLY | O_NONBLOCK);
    assert_int_equal(spzwrite_scene(pipe, &s, 3), OK);
    assert_int_equal(spzwrite_scene(pipe, &s, 4), ERR_IO);
    assert_non_null(strstr(err_text(), "pipe.spz: writing failed: Illegal seek"));
    close(fd);
    s.g.plane[G_SH + 1][2] = NAN;
    assert_int_equal(spzwrite_scene(path, &s, 3), ERR_ARG);
    assert_non_null(strstr(err_text(), "splat 2 of 3: plane 12"));
    s = make(3, 0, 1);
    for (int k = 0; k < 4; k++)
        s.g.plane[G_QUAT + k][1] = 0;
    assert_int_equal(spzwrite_scene(path, &s, 3), ERR_ARG);
    assert_false(file_is_regular(path));
}

/* ---- files of others ---- */

static uint8_t raw[4096];
static size_t n_raw;

static void put(const void *p, size_t n)
{
    assert_true(n_raw + n <= sizeof raw);
    memcpy(raw + n_raw, p, n);
    n_raw += n;
}

static void put_u32(uint32_t v)
{
    uint8_t b[4];
    bytes_put_u32(b, v);
    put(b, 4);
}

/* Two splats as the reference packs them. */
static void put_file(int version, int degree, int flags)
{
    static const uint8_t positions[18] = {0, 16, 0, 0, 0xf0, 0xff, 1, 0, 0, 0, 0, 0x80};
    static const uint8_t alphas[2] = {0, 255}, colours[6] = {128, 255, 0, 90, 127, 200};
    static const uint8_t scales[6] = {0, 160, 255, 80, 81, 82};
    static const uint8_t turns_2[6] = {255, 128, 128, 191, 0x80, 64};
    static const uint8_t turns_3[8] = {0, 0, 0, 0xc0, 0xff, 0x01, 0, 0x48};
    const uint8_t head[4] = {(uint8_t)degree, 12, (uint8_t)flags, 0};
    n_raw = 0;
    put_u32(0x5053474e);
    put_u32((uint32_t)version);
    put_u32(2);
    put(head, 4);
    put(positions, 18);
    put(alphas, 2);
    put(colours, 6);
    put(scales, 6);
    put(version == 2 ? turns_2 : turns_3, version == 2 ? 6 : 8);
    for (int i = 0; i < 2 * 3 * ((degree + 1) * (degree + 1) - 1); i++)
        put(&(uint8_t){(uint8_t)(128 + 7 * i)}, 1);
}

static const char *packed(const char *name)
{
    const char *path = tmpdir_path(name);
    struct compressed_out out;
    FILE *f;
    assert_int_equal(file_create(path, &f), OK);
    assert_int_equal(compressed_begin(&out, path, COMPRESSED_GZIP, f, n_raw), OK);
    assert_int_equal(compressed_put(&out, raw, n_raw), OK);
    assert_int_equal(compressed_end(&out), OK);
    assert_int_equal(file_finish(f, path), OK);
    return path;
}

static struct gaussians read_file(float ev)
{
    struct gaussians g;
    struct gaussians_report report;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
    assert_int_equal(splats_read(&spz_format, packed("foreign.spz"), ev, &arena, &g, &report), OK);
    assert_true(g.n == 2 && report.dropped == 0);
    return g;
}

static void assert_near(float a, double b)
{
    if (!(fabs((double)a - b) <= 2e-6 * fmax(1, fabs(b))))
        fail_msg("%.9g is not %.9g", (double)a, b);
}

static void the_numbers_of_others_are_understood(void **state)
{
    (void)state;
    for (int version = 2; version <= 3; version++) {
        put_file(version, 0, 0);
        struct gaussians g = read_file(0);
        assert_near(g.plane[G_MU][0], 1);
        assert_near(g.plane[G_MU + 1][0], 1); // up is down
        assert_near(g.plane[G_MU + 2][0], -1 / 4096.0);
        assert_near(g.plane[G_MU][1], -2048);
        assert_near(g.plane[G_LOG_SCALE][0], -10);
        assert_near(g.plane[G_LOG_SCALE + 1][0], 0);
        assert_near(g.plane[G_LOG_SCALE + 2][0], 5.9375);
        assert_true(g.plane[G_LOGIT][0] < -6 && g.plane[G_LOGIT][1] > 6);
        double shown = 0.5 + C0 * (127 / 255.0 - 0.5) / 0.15;
        assert_near(g.plane[G_SH + 1][1], log((double)display_decode((float)shown)) / C0);
        assert_near(g.plane[G_SH + 2][0], log((double)DISPLAY_FLOOR) / C0);
        assert_near(g.plane[G_QUAT][0], version == 2 ? 0 : 1);
    }
    put_file(2, 0, 0);
    struct gaussians g = read_file(0);
    assert_near(g.plane[G_QUAT + 1][0], 1);
    double x = 191 / 127.5 - 1, y = 128 / 127.5 - 1, z = 64 / 127.5 - 1;
    assert_near(g.plane[G_QUAT + 1][1], x);
    assert_near(g.plane[G_QUAT + 2][1], -y);
    assert_near(g.plane[G_QUAT + 3][1], -z);
    assert_near(g.plane[G_QUAT][1], sqrt(1 - x * x - y * y - z * z));
    put_file(3, 0, 0); // y is the largest; x = 0x080: 128, z = 0, w = 0x1ff: 511
    g = read_file(0);
    double s = sqrt(0.5) / 511;
    assert_near(g.plane[G_QUAT + 1][1], 128 * s);
    assert_near(g.plane[G_QUAT + 3][1], 0);
    assert_near(g.plane[G_QUAT][1], 511 * s);
    assert_near(g.plane[G_QUAT + 2][1], -sqrt(0.5 - 128 * 128 * s * s));
}

/* What display.h makes of the same harmonics with the signs of the other axes. */
static void harmonics_change_their_axes(void **state)
{
    (void)state;
    static const int sign[16] = {1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};
    for (int degree = 1; degree <= 4; degree++) {
        put_file(3, degree, 0);
        struct gaussians g = read_file(0.75f);
        int read = degree < 3 ? degree : 3, n = 3 * (read + 1) * (read + 1);
        float f[48], want[48];
        static const uint8_t colours[3] = {128, 255, 0};
        assert_int_equal(g.degree, read);
        for (int j = 0; j < n; j++) {
            int byte = (128 + 7 * (j - 3)) & 255;
            f[j] = j < 3 ? (float)((colours[j] / 255.0 - 0.5) / 0.15)
                         : (float)(sign[j / 3] * (byte - 128)) / 128;
        }
        display_to_radiance(f, read, 0.75f, want);
        for (int j = 0; j < n; j++)
            assert_near(g.plane[G_SH + j][0], (double)want[j]);
        struct splats_info info;
        assert_int_equal(splats_peek(&spz_format, tmpdir_path("foreign.spz"), &info), OK);
        assert_true(!info.has_hdr && info.band_lost == (degree == 4) && info.ev == 0);
    }
}

static void records_of_others_are_skipped_and_axes_obeyed(void **state)
{
    (void)state;
    put_file(3, 0, 2);
    put_u32(0x12340001);
    put_u32(3);
    put("abc", 3);
    put_u32(0xadbe0003);
    put_u32(4);
    put_u32(6); // right, down, forward
    struct gaussians g = read_file(0);
    assert_near(g.plane[G_MU][0], 1);
    assert_near(g.plane[G_MU + 1][0], -1);
    assert_near(g.plane[G_MU + 2][0], 1 / 4096.0);
}

/* Without the flag of records, what follows the arrays is ours or nothing. */
static void what_follows_without_the_flag_is_skipped(void **state)
{
    (void)state;
    static const char *const rests[] = {"", "1234", "12345678", "123456789"};
    for (size_t i = 0; i < sizeof rests / sizeof rests[0]; i++) {
        put_file(3, 0, 0);
        put(rests[i], strlen(rests[i]));
        assert_near(read_file(0).plane[G_MU][0], 1);
    }
}

static void expect(err_t code, const char *word)
{
    struct splats_info info;
    err_t e = splats_peek(&spz_format, packed("bad.spz"), &info);
    if (e != code || !strstr(err_text(), word) || !strstr(err_text(), "bad.spz"))
        fail_msg("%d, \"%s\", not %d with \"%s\"", e, err_text(), code, word);
}

static void put_radiance(const uint8_t head[4], float ev, float unit, size_t planes)
{
    uint8_t b[8];
    put_u32(0x48440001);
    put_u32((uint32_t)(12 + planes));
    put(head, 4);
    bytes_put_f32(bytes_put_f32(b, ev), unit);
    put(b, 8);
    for (size_t i = 0; i < planes; i++)
        put("x", 1);
}

static void headers_that_lie_are_named(void **state)
{
    (void)state;
    static const struct {
        size_t at;
        uint8_t value;
        err_t code;
        const char *word;
    } cases[] = {{0, 'X', ERR_FORMAT, "not an SPZ file"},
                 {4, 1, ERR_UNSUPPORTED, "version 1"},
                 {4, 5, ERR_UNSUPPORTED, "version 5"},
                 {4, 4, ERR_FORMAT, "version 4 in a gzip stream"},
                 {8, 3, ERR_FORMAT, "rotations: cut off"},
                 {11, 9, ERR_FORMAT, "splats in"},
                 {11, 1, ERR_FORMAT, "at most 16777216 are read"},
                 {12, 5, ERR_FORMAT, "degree 5"},
                 {13, 31, ERR_FORMAT, "31 fractional bits"},
                 {14, 2, ERR_FORMAT, "extension record: cut off"}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        put_file(3, 1, 0);
        put("12345", 5);
        n_raw -= cases[i].at == 8 ? 5 : 0;
        raw[cases[i].at] = cases[i].value;
        expect(cases[i].code, cases[i].word);
    }
}

static void a_wrong_checksum_is_noticed(void **state)
{
    (void)state;
    put_file(3, 0, 0);
    FILE *f = fopen(packed("bad.spz"), "r+b");
    assert_true(f && fseek(f, -6, SEEK_END) == 0);
    int c = fgetc(f);
    assert_true(fseek(f, -6, SEEK_END) == 0 && fputc(c ^ 1, f) != EOF && fclose(f) == 0);
    struct splats_info info;
    assert_int_equal(splats_peek(&spz_format, tmpdir_path("bad.spz"), &info), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "incorrect data check"));
}

static void records_that_lie_are_named(void **state)
{
    (void)state;
    static const struct {
        uint8_t head[4];
        float ev, unit;
        size_t planes;
        err_t code;
        const char *word;
    } cases[] = {{{2, 0, 16, 0}, 0, 1, 12, ERR_UNSUPPORTED, "record of version 2"},
                 {{1, 5, 16, 0}, 0, 1, 12, ERR_FORMAT, "degree 5"},
                 {{1, 0, 0, 0}, 0, 1, 12, ERR_FORMAT, "0 steps"},
                 {{1, 0, 16, 2}, 0, 1, 12, ERR_FORMAT, "form 2"},
                 {{1, 0, 16, 0}, NAN, 1, 12, ERR_FORMAT, "ev nan"},
                 {{1, 0, 16, 0}, 0, 0, 12, ERR_FORMAT, "unit 0"},
                 {{1, 0, 16, 0}, 0, -1, 12, ERR_FORMAT, "unit -1"},
                 {{1, 0, 16, 0}, 0, INFINITY, 12, ERR_FORMAT, "unit inf"},
                 {{1, 0, 16, 0}, 0, 1, 11, ERR_FORMAT, "2 splats need 12"},
                 {{1, 1, 16, 0}, 0, 1, 12, ERR_FORMAT, "2 splats need 48"},
                 {{1, 0, 16, 1}, 0, 1, 12, ERR_FORMAT, "12 packed bytes"}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        put_file(3, 0, 2);
        put_radiance(cases[i].head, cases[i].ev, cases[i].unit, cases[i].planes);
        expect(cases[i].code, cases[i].word);
    }
    static const uint8_t good[4] = {1, 0, 16, 0};
    put_file(3, 0, 2);
    put_radiance(good, 0, 1, 12);
    size_t one = n_raw;
    put_radiance(good, 0, 1, 12);
    expect(ERR_FORMAT, "two radiance records");
    n_raw = one - 1;
    expect(ERR_FORMAT, "extension record: cut off");
    put_file(3, 0, 2);
    put_u32(0xadbe0003);
    put_u32(4);
    put_u32(9);
    expect(ERR_UNSUPPORTED, "axes 9");
}

/* The same whatever one byte is, and however much is missing: an error, or a scene. */
static void damaged_files_are_refused_or_read(void **state)
{
    (void)state;
    for (int version = 3; version <= 4; version++) {
        struct scene s = make(5, 1, 1);
        struct file_map m;
        uint8_t copy[2048];
        assert_int_equal(spzwrite_scene(tmpdir_path("whole.spz"), &s, version), OK);
        assert_int_equal(file_map(tmpdir_path("whole.spz"), sizeof copy, &m), OK);
        arena_free(&arena);
        assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
        for (size_t i = 0; i < 2 * m.n; i++) {
            struct splats_bytes file = {"damaged", copy, i < m.n ? i : m.n};
            struct splats_info info;
            struct gaussians g;
            struct gaussians_report report;
            memcpy(copy, m.p, m.n);
            if (i >= m.n)
                copy[i - m.n] ^= (uint8_t)(1 + i % 255);
            size_t mark = arena_mark(&arena);
            err_t peek = spz_format.peek(&file, &info), e = ERR_FORMAT;
            if (!peek && gaussians_need(info.n, info.degree) < 1 << 19)
                e = spz_format.parse(&file, 0, &arena, &g, &report);
            assert_true(i >= m.n || e == ERR_FORMAT); // what is cut off is noticed
            assert_true(e == OK || g.n == 0 || peek || info.n > 5);
            arena_reset(&arena, mark);
        }
        file_unmap(&m);
    }
}

static void tables_that_lie_are_named(void **state)
{
    (void)state;
    static const struct {
        int at; // from the table, or in the header if negative
        uint8_t value;
        const char *word;
    } cases[] = {{-17, 5, "5 streams, its header needs 6"},
                 {-16, 1, "table of 6 streams at byte 1"},
                 {-13, 0xff, "table of 6 streams"},
                 {6, 1, "positions: "},
                 {8, 1, "positions: "},
                 {24, 1, "alphas: "},
                 {88, 1, "harmonics: "}};
    struct scene s = make(5, 1, 1);
    struct file_map m;
    uint8_t copy[2048];
    assert_int_equal(spzwrite_scene(tmpdir_path("four.spz"), &s, 4), OK);
    assert_int_equal(file_map(tmpdir_path("four.spz"), sizeof copy - 1, &m), OK);
    struct bytes b = bytes_of(m.p + 16, 4);
    size_t table = bytes_u32(&b);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct splats_bytes file = {"four", copy, m.n};
        struct splats_info info;
        memcpy(copy, m.p, m.n);
        int at = cases[i].at;
        copy[at < 0 ? at + 32 : (int)table + at] = cases[i].value;
        assert_int_equal(spz_format.peek(&file, &info), ERR_FORMAT);
        if (!strstr(err_text(), cases[i].word))
            fail_msg("\"%s\" without \"%s\"", err_text(), cases[i].word);
    }
    struct splats_bytes longer = {"four", copy, m.n + 1};
    struct splats_info info;
    memcpy(copy, m.p, m.n);
    assert_int_equal(spz_format.peek(&longer, &info), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "1 bytes behind the last stream"));
    file_unmap(&m);
}

/* A file of version 4 whose header and table agree on another number of splats. */
static struct splats_bytes recounted(int degree, uint32_t n, uint8_t copy[2048])
{
    struct scene s = make(5, degree, 1);
    struct file_map m;
    size_t width[SPZ_ARRAYS];
    assert_int_equal(spzwrite_scene(tmpdir_path("five.spz"), &s, 4), OK);
    assert_int_equal(file_map(tmpdir_path("five.spz"), 2048, &m), OK);
    struct splats_bytes file = {"five", copy, m.n};
    memcpy(copy, m.p, m.n);
    file_unmap(&m);
    bytes_put_u32(copy + 8, n);
    struct bytes b = bytes_of(copy + 16, 4);
    uint8_t *entry = copy + bytes_u32(&b);
    spz_widths(4, degree, width);
    for (int a = 0; a < SPZ_ARRAYS && width[a] > 0; a++, entry += SPZ_TOC_ENTRY)
        bytes_put_u64(entry + 8, (uint64_t)n * width[a]);
    return file;
}

static void counts_that_lie_are_named(void **state)
{
    (void)state;
    uint8_t copy[2048];
    struct splats_info info;
    struct gaussians g;
    struct gaussians_report report;
    struct splats_bytes file = recounted(0, GAUSSIANS_MAX, copy);
    assert_int_equal(spz_format.peek(&file, &info), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "positions: 5"));
    assert_non_null(strstr(err_text(), " bytes cannot unpack to 150994944"));
    file = recounted(0, 4, copy);
    assert_int_equal(spz_format.peek(&file, &info), OK);
    assert_int_equal(spz_format.parse(&file, 0, &arena, &g, &report), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "five: positions: more bytes than its header says"));
    assert_true(g.n == 0 && g.plane[0] == NULL);
    file = recounted(0, 6, copy);
    assert_int_equal(spz_format.parse(&file, 0, &arena, &g, &report), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "five: positions: cut off"));
}

static int remove_folder(void **state)
{
    (void)state;
    arena_free(&arena);
    tmpdir_remove();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_degree_comes_back_in_both_versions),
        cmocka_unit_test(scenes_of_any_size_keep_their_precision),
        cmocka_unit_test(odd_scenes_are_written),
        cmocka_unit_test(viewers_see_the_display_colours),
        cmocka_unit_test(display_colours_end_at_the_headroom),
        cmocka_unit_test(what_cannot_be_written_says_why),
        cmocka_unit_test(the_numbers_of_others_are_understood),
        cmocka_unit_test(harmonics_change_their_axes),
        cmocka_unit_test(records_of_others_are_skipped_and_axes_obeyed),
        cmocka_unit_test(what_follows_without_the_flag_is_skipped),
        cmocka_unit_test(headers_that_lie_are_named),
        cmocka_unit_test(a_wrong_checksum_is_noticed),
        cmocka_unit_test(records_that_lie_are_named),
        cmocka_unit_test(tables_that_lie_are_named),
        cmocka_unit_test(counts_that_lie_are_named),
        cmocka_unit_test(damaged_files_are_refused_or_read),
    };
    return cmocka_run_group_tests(tests, tmpdir_setup, remove_folder);
}
