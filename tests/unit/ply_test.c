#include "drivers/ply.h"

#include "core/base/half.h"
#include "core/net/tonemap.h"
#include "drivers/file.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define C0 0.28209479177387814

static struct arena arena;

/* n splats with values that need all their bits; SH values are halves already. */
static struct gaussians make(int n, int degree)
{
    struct gaussians g;
    unsigned seed = 7;
    arena_free(&arena);
    assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
    assert_int_equal(gaussians_init(&g, &arena, n, degree), OK);
    g.n = n;
    for (int p = 0; p < gaussians_planes(degree); p++) {
        for (int i = 0; i < n; i++) {
            seed = seed * 1664525u + 1013904223u;
            float v = (float)((int)(seed >> 8) - (1 << 23)) / (1 << 22);
            g.plane[p][i] = p < G_SH ? v : half_to_float(half_from_float(v));
        }
    }
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 4; k++)
            g.plane[G_QUAT + k][i] = k == i % 4 ? -1 : 0; // of unit length in floats
    return g;
}

static struct tonemap make_tone(void)
{
    struct tonemap t;
    tonemap_linear(&t, 0.5f, -20, 10, 1.5f);
    return t;
}

static void what_is_written_is_read_bit_for_bit(void **state)
{
    (void)state;
    struct tonemap tone = make_tone();
    for (int degree = 0; degree <= SH_DEGREE_MAX; degree++) {
        struct gaussians in = make(21, degree), out;
        struct gaussians_report report;
        struct ply_info info;
        const char *path = tmpdir_path("scene.ply");
        assert_int_equal(ply_write(path, &in, &tone), OK);
        assert_int_equal(ply_peek(path, &info), OK);
        assert_true(info.n == 21 && info.degree == degree && info.has_hdr);
        assert_int_equal(ply_read(path, &arena, &out, &report), OK);
        assert_true(out.n == 21 && out.degree == degree && report.dropped == 0 &&
                    report.repaired == 0);
        for (int p = 0; p < gaussians_planes(degree); p++)
            assert_memory_equal(out.plane[p], in.plane[p], 21 * sizeof(float));
    }
}

static float f32_at(const struct file_map *m, size_t at)
{
    float v;
    assert_true(at + 4 <= m->n);
    memcpy(&v, m->p + at, 4);
    return v;
}

static void ordinary_viewers_see_the_photograph(void **state)
{
    (void)state;
    struct tonemap tone = make_tone();
    struct gaussians g = make(1, 1);
    struct file_map m;
    g.plane[G_LOG_SCALE][0] = -1e9f;
    for (int k = 0; k < 4; k++)
        g.plane[G_QUAT + k][0] = 3;
    assert_int_equal(ply_write(tmpdir_path("one.ply"), &g, &tone), OK);
    assert_int_equal(file_map(tmpdir_path("one.ply"), 1 << 20, &m), OK);
    size_t row = (size_t)((const uint8_t *)memmem(m.p, m.n, "end_header\n", 11) - m.p) + 11;
    assert_int_equal(m.n - row, 17 * 4 + 12 * 2);
    for (int c = 0; c < 3; c++) {
        double x = log2(exp(C0 * g.plane[G_SH + c][0]) + 1e-6);
        double shown = 1 / (1 + exp(-0.5 * x)); // of tonemap_linear
        assert_true(fabs(0.5 + C0 * f32_at(&m, row + 24 + 4 * (size_t)c) - shown) < 1e-4);
    }
    assert_true(f32_at(&m, row + 40) == GAUSSIANS_LOG_SCALE_MIN);
    assert_true(f32_at(&m, row + 52) == 0.5f); // quaternion of unit length
    file_unmap(&m);
}

static void bad_splats_are_not_written(void **state)
{
    (void)state;
    struct tonemap tone = make_tone();
    struct gaussians g = make(3, 0);
    g.plane[G_SH + 1][2] = NAN;
    assert_int_equal(ply_write(tmpdir_path("bad.ply"), &g, &tone), ERR_ARG);
    assert_non_null(strstr(err_text(), "splat 2 of 3: plane 12"));
    assert_false(file_is_regular(tmpdir_path("bad.ply")));
    g = make(3, 0);
    for (int k = 0; k < 4; k++)
        g.plane[G_QUAT + k][1] = 0;
    assert_int_equal(ply_write(tmpdir_path("bad.ply"), &g, &tone), ERR_ARG);
    g = make(3, 0);
    assert_int_equal(ply_write("/dev/full", &g, &tone), ERR_LIMIT);
}

static const char *const foreign[] = {"rot_0",   "rot_1",  "rot_2",  "rot_3",   "opacity",
                                      "z",       "y",      "x",      "scale_2", "scale_1",
                                      "scale_0", "f_dc_0", "f_dc_1", "f_dc_2"};
enum { N_FOREIGN = 14 };

/* A file of another program: other order, a double and a uchar in between, f_rest, an element
 * behind. */
static size_t make_foreign(int n_rest, const float *values, char *out)
{
    char *p = out;
    p += sprintf(
        p, "ply\r\nformat binary_little_endian 1.0\ncomment by someone else\nelement vertex 1\n"
           "property double time\n");
    for (int i = 0; i < N_FOREIGN; i++)
        p += sprintf(p, "property float%s %s\n", i % 2 ? "32" : "", foreign[i]);
    p += sprintf(p, "property uchar label\n");
    for (int i = 0; i < n_rest; i++)
        p += sprintf(p, "property float f_rest_%d\n", i);
    p += sprintf(p, "element face 1\nproperty list uchar int vertex_indices\nend_header\n");
    memset(p, 0, 8);
    memcpy(p + 8, values, 4 * N_FOREIGN);
    p[8 + 4 * N_FOREIGN] = 9;
    memcpy(p + 9 + 4 * N_FOREIGN, values + N_FOREIGN, 4 * (size_t)n_rest);
    return (size_t)(p - out) + 9 + 4 * N_FOREIGN + 4 * (size_t)n_rest;
}

static void foreign_files_are_taken_as_srgb(void **state)
{
    (void)state;
    char file[4096];
    float v[N_FOREIGN + 9] = {1, 0, 0, 0, 0.5f, 3, 2, 1, -3, -2, -1, 0, (float)(0.5 / C0), -9};
    for (int i = 0; i < 9; i++)
        v[N_FOREIGN + i] = (float)(i + 1) / 10;
    size_t n = make_foreign(9, v, file);
    struct gaussians g;
    struct gaussians_report report;
    struct ply_bytes b = {"f", file, n};
    make(1, 0);
    assert_int_equal(ply_parse(&b, &arena, &g, &report), OK);
    assert_true(g.n == 1 && g.degree == 1);
    assert_true(g.plane[G_MU][0] == 1 && g.plane[G_MU + 2][0] == 3 &&
                g.plane[G_LOG_SCALE + 2][0] == -3);
    assert_true(g.plane[G_LOGIT][0] == 0.5f && g.plane[G_QUAT][0] == 1);
    assert_true(fabs(exp(C0 * g.plane[G_SH][0]) - 0.2140411) < 1e-6); // display 0.5
    assert_true(fabs(C0 * g.plane[G_SH + 1][0]) < 1e-6);              // display 1
    assert_true(fabs(exp(C0 * g.plane[G_SH + 2][0]) - 1e-4) < 1e-9);  // below black
    assert_true(fabs(g.plane[G_SH + 3 * 1][0] - 0.1 * 2.4 / 0.555) <
                1e-6); // red, first coefficient
    assert_true(fabs(g.plane[G_SH + 3 * 3 + 1][0] - 0.6 * 2.4 / 1.055) < 1e-6); // green, third
    assert_true(g.plane[G_SH + 3 * 2 + 2][0] == 0);                             // blue is dark
}

static err_t parse_text(const char *text)
{
    struct gaussians g;
    struct gaussians_report report;
    struct ply_info info;
    struct ply_bytes b = {"f", text, strlen(text)};
    err_t e = ply_parse(&b, &arena, &g, &report);
    assert_int_equal(ply_peek_bytes(&b, &info), e);
    assert_true(e == OK || g.plane[0] == NULL);
    return e;
}

#define HEAD "ply\nformat binary_little_endian 1.0\n"

static void hostile_headers_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *sentence;
        err_t code;
    } wrong[] = {
        {"", "no end", ERR_FORMAT},
        {"plz\n", "not a PLY", ERR_FORMAT},
        {"ply\nformat ascii 1.0\n", "ascii", ERR_UNSUPPORTED},
        {"ply\nformat binary_big_endian 1.0\n", "big_endian", ERR_UNSUPPORTED},
        {HEAD "end_header\n", "lacks", ERR_FORMAT},
        {HEAD "element vertex -1\n", "\"-1\"", ERR_FORMAT},
        {HEAD "element vertex 99999999999999999999\n", "999 splats", ERR_FORMAT},
        {HEAD "element face 1\n", "face", ERR_UNSUPPORTED},
        {HEAD "element vertex 1\nproperty float128 x\n", "float128", ERR_FORMAT},
        {HEAD "element vertex 1\nproperty list uchar int x\n", "lists", ERR_UNSUPPORTED},
        {HEAD "element vertex 1\nproperty float x y z a\n", "words", ERR_FORMAT},
        {HEAD "element vertex 1\nproperty float x\nproperty int x\n", "twice", ERR_FORMAT},
        {HEAD "element vertex 0\nelement vertex 0\n", "two vertex", ERR_FORMAT},
        {HEAD "element vertex 2\nproperty float x\nend_header\n1234567", "2 splats of 4 bytes",
         ERR_FORMAT},
        {HEAD "element vertex 0\nproperty int x\nend_header\n", "x is int", ERR_FORMAT},
        {HEAD "element vertex 0\nend_header\n", "no property x", ERR_FORMAT},
        {HEAD "element vertex 0\nproperty float f_rest_0\nend_header\n", "SH degree",
         ERR_UNSUPPORTED},
        {HEAD "nonsense\n", "nonsense", ERR_FORMAT},
    };
    make(1, 0);
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(parse_text(wrong[i].text), wrong[i].code);
        assert_non_null(strstr(err_text(), wrong[i].sentence));
    }
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    struct tonemap tone = make_tone();
    struct gaussians in = make(2, 1), g;
    struct gaussians_report report;
    struct file_map m;
    assert_int_equal(ply_write(tmpdir_path("cut.ply"), &in, &tone), OK);
    assert_int_equal(file_map(tmpdir_path("cut.ply"), 1 << 20, &m), OK);
    for (size_t n = 0; n < m.n; n++) {
        char *copy = malloc(n + 1);
        memcpy(copy + 1, m.p, n);
        assert_int_equal(ply_parse(&(struct ply_bytes){"f", copy + 1, n}, &arena, &g, &report),
                         ERR_FORMAT);
        free(copy);
    }
    file_unmap(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read_bit_for_bit),
        cmocka_unit_test(ordinary_viewers_see_the_photograph),
        cmocka_unit_test(bad_splats_are_not_written),
        cmocka_unit_test(foreign_files_are_taken_as_srgb),
        cmocka_unit_test(hostile_headers_are_refused),
        cmocka_unit_test(every_cut_is_refused),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    tmpdir_remove();
    return failed;
}
