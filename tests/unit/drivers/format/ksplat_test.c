/* Files of GaussianSplats3D, against the splats that it wrote them from
 * (tests/data/splats/make.sh); and files that are made here as it makes them (ksplat.h has the
 * layout). */
#include "drivers/format/ksplat.h"

#include "core/base/bytes.h"
#include "core/base/half.h"
#include "core/splat/display.h"

#include "tests/unit/drivers/format/truth.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define C0 0.28209479177387814

enum {
    SPLATS = 7, // of a section: a full bucket of 3, then buckets of 3 and 1
    SECTIONS = 2,
    HEADS = 4096 + SECTIONS * 1024,
    CAP = 65536
};

static struct arena arena;
static uint8_t file[CAP];
static size_t file_bytes;

static uint8_t *put_number(uint8_t *p, int level, float v)
{
    return level == 0 ? bytes_put_f32(p, v) : bytes_put_u16(p, half_from_float(v));
}

/* Harmonic j of splat i: a multiple of 1/4 from -1 to 1. */
static float harmonic(int i, int j)
{
    return (float)((i + j) % 9 - 4) / 4;
}

static uint8_t *put_harmonic(uint8_t *p, int level, float v)
{
    if (level < 2)
        return put_number(p, level, v);
    *p = (uint8_t)lrintf((v + 2) / 4 * 255); // range -2 to 2
    return p + 1;
}

/* Bucket of a section's splat, and where the bucket is. */
static int bucket_of(int i)
{
    return i / 3;
}

static float middle(int section, int bucket, int k)
{
    return (float)(100 * section + 10 * bucket + k);
}

static uint8_t *put_row(uint8_t *p, int level, int degree, int section, int i)
{
    for (int k = 0; k < 3; k++)
        p = level == 0 ? bytes_put_f32(p, middle(section, bucket_of(i), k) + (float)i / 8)
                       : bytes_put_u16(p, (uint16_t)(1000 + 100 * i)); // R = 1000, half edge 1.25
    for (int k = 0; k < 3; k++)
        p = put_number(p, level, 0.5f * (float)(k + 1));
    for (int k = 0; k < 4; k++)
        p = put_number(p, level, k == 1 ? -1 : 0);
    for (int c = 0; c < 4; c++)
        *p++ = (uint8_t)(50 * c + i);
    for (int band = 1; band <= degree; band++)
        for (int c = 0; c < 3; c++)
            for (int j = band * band; j < (band + 1) * (band + 1); j++)
                p = put_harmonic(p, level, harmonic(i, 3 * j + c));
    return p;
}

static uint8_t *put_section(uint8_t *p, int level, int degree, int section)
{
    uint8_t *h = file + 4096 + 1024 * section;
    bytes_put_u32(h, SPLATS);
    bytes_put_u32(h + 4, SPLATS + 1);
    bytes_put_u16(h + 40, (uint16_t)degree);
    if (level > 0) {
        bytes_put_u32(h + 8, 3);
        bytes_put_u32(h + 12, 3);
        bytes_put_f32(h + 16, 2.5f);
        bytes_put_u16(h + 20, 12);
        bytes_put_u32(h + 24, 1000);
        bytes_put_u32(h + 32, 1);
        bytes_put_u32(h + 36, 2);
        p = bytes_put_u32(p, 3);
        p = bytes_put_u32(p, 1);
        for (int b = 0; b < 3; b++)
            for (int k = 0; k < 3; k++)
                p = bytes_put_f32(p, middle(section, b, k));
    }
    const uint8_t *first = p;
    for (int i = 0; i < SPLATS; i++)
        p = put_row(p, level, degree, section, i);
    return p + (p - first) / SPLATS; // room for one more
}

/* Sections of this degree and the one below. */
static struct splats_bytes make(int level, int degree)
{
    memset(file, 0, sizeof file);
    file[1] = 1;
    bytes_put_u32(file + 4, SECTIONS);
    bytes_put_u32(file + 8, SECTIONS);
    bytes_put_u32(file + 12, 2 * SPLATS);
    bytes_put_u32(file + 16, 2 * SPLATS);
    bytes_put_u16(file + 20, (uint16_t)level);
    bytes_put_f32(file + 36, -2);
    bytes_put_f32(file + 40, 2);
    uint8_t *p = file + HEADS;
    p = put_section(p, level, degree, 0);
    p = put_section(p, level, degree > 0 ? degree - 1 : 0, 1);
    file_bytes = (size_t)(p - file);
    return (struct splats_bytes){"f.ksplat", file, file_bytes};
}

static void check_splat(const struct gaussians *g, int level, int degree, int at)
{
    const int section = at / SPLATS, i = at % SPLATS;
    const int stored = section == 0 || degree == 0 ? degree : degree - 1;
    float sh[3 * SH_COEFS_MAX] = {0}, want[3 * SH_COEFS_MAX];
    for (int k = 0; k < 3; k++) {
        assert_true(fabsf(g->plane[G_MU + k][at] - middle(section, bucket_of(i), k) -
                          (float)i / 8) < 1e-5f);
        assert_true(fabs((double)g->plane[G_LOG_SCALE + k][at] - log(0.5 * (k + 1))) < 1e-5);
        sh[k] = (float)(((50 * k + i) / 255.0 - 0.5) / C0);
    }
    for (int k = 0; k < 4; k++)
        assert_true(g->plane[G_QUAT + k][at] == (k == 1 ? -1 : 0));
    const double opacity = (150 + i) / 255.0;
    assert_true(fabs((double)g->plane[G_LOGIT][at] - log(opacity / (1 - opacity))) < 1e-5);
    for (int j = 3; j < 3 * (stored + 1) * (stored + 1); j++)
        sh[j] = harmonic(i, j);
    display_to_radiance(sh, g->degree, 1, want);
    for (int j = 0; j < 3 * (degree + 1) * (degree + 1); j++)
        assert_true(fabsf(g->plane[G_SH + j][at] - want[j]) < (level < 2 ? 1e-4f : 0.3f));
}

static void every_level_and_degree_is_read(void **state)
{
    (void)state;
    for (int level = 0; level < 3; level++)
        for (int degree = 0; degree <= 3; degree++) {
            struct gaussians g;
            struct gaussians_report report;
            struct splats_info info;
            const struct splats_bytes b = make(level, degree);
            assert_int_equal(ksplat_format.peek(&b, &info), OK);
            assert_true(info.n == 2 * SPLATS && info.degree == degree && !info.has_hdr);
            arena_reset(&arena, 0);
            assert_int_equal(ksplat_format.parse(&b, 1, &arena, &g, &report), OK);
            assert_true(g.n == 2 * SPLATS && g.degree == degree && report.dropped == 0);
            for (int i = 0; i < g.n; i++)
                check_splat(&g, level, degree, i);
        }
}

/* Colours and opacities lose less than the last of their 8 bits. */
static void what_its_program_wrote_is_read(void **state)
{
    (void)state;
    static const struct truth_bound bounds[] = {{0, 1e-6f, 1e-6f, 0.25f, 0.11f},
                                                {1e-4f, 1e-3f, 1e-3f, 0.25f, 0.11f},
                                                {1e-4f, 1e-3f, 1e-3f, 0.25f, 0.11f}};
    for (int level = 0; level < 3; level++) {
        char path[64];
        struct gaussians g, truth;
        struct gaussians_report report;
        snprintf(path, sizeof path, "tests/data/splats/level%d.ksplat", level);
        arena_reset(&arena, 0);
        assert_int_equal(
            splats_read(&ply_format, "tests/data/splats/truth.ply", 1, &arena, &truth, &report),
            OK);
        assert_int_equal(splats_read(&ksplat_format, path, 1, &arena, &g, &report), OK);
        assert_true(truth_holds(&truth, &g, &bounds[level]));
    }
}

static void expect(err_t want, const char *words)
{
    const struct splats_bytes b = {"f.ksplat", file, file_bytes};
    struct gaussians g;
    struct gaussians_report report;
    struct splats_info info;
    assert_int_equal(ksplat_format.peek(&b, &info), want);
    assert_non_null(strstr(err_text(), words));
    assert_int_equal(ksplat_format.parse(&b, 0, &arena, &g, &report), want);
    assert_true(g.plane[0] == NULL);
}

/* What a hostile header may claim: u32 at this place. */
static void headers_that_lie_are_refused(void **state)
{
    (void)state;
    enum { FIRST = 4096 };
    static const struct {
        size_t at;
        uint32_t v;
        const char *words;
        err_t code;
    } lies[] = {
        {0, 1, "version 1.0", ERR_UNSUPPORTED},
        {0, 0, "version 0.0", ERR_UNSUPPORTED},
        {4, 70000, "70000 sections", ERR_FORMAT},
        {4, 60000, "60000 sections", ERR_FORMAT},
        {16, 99999999, "99999999 splats", ERR_FORMAT},
        {16, 15, "14 splats in its sections, its header says 15", ERR_FORMAT},
        {20, 3, "level 3", ERR_UNSUPPORTED},
        {FIRST, 9, "9 splats where 8 have room", ERR_FORMAT},
        {FIRST + 4, 0xffffffff, "leaves the file", ERR_FORMAT},
        {FIRST + 8, 2, "7 splats, 1 full and 2 other", ERR_FORMAT},
        {FIRST + 12, 2, "of 2 buckets", ERR_FORMAT},
        {FIRST + 12, 0xffffffff, "leaves the file", ERR_FORMAT},
        {FIRST + 20, 13, "buckets of 13 bytes", ERR_FORMAT},
        {FIRST + 32, 0xffffffff, "4294967295 full", ERR_FORMAT},
        {FIRST + 36, 0xffffffff, "leaves the file", ERR_FORMAT},
        {FIRST + 40, 4, "degree 4", ERR_FORMAT},
    };
    for (size_t i = 0; i < sizeof lies / sizeof lies[0]; i++) {
        make(1, 2);
        bytes_put_u32(file + lies[i].at, lies[i].v);
        expect(lies[i].code, lies[i].words);
    }
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    make(2, 3);
    const size_t n = file_bytes;
    for (file_bytes = 0; file_bytes < n; file_bytes += file_bytes < HEADS ? 97 : 1)
        expect(ERR_FORMAT, "f.ksplat");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_level_and_degree_is_read),
        cmocka_unit_test(what_its_program_wrote_is_read),
        cmocka_unit_test(headers_that_lie_are_refused),
        cmocka_unit_test(every_cut_is_refused),
    };
    if (arena_init(&arena, "test", 1 << 20) != OK)
        return 1;
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    return failed;
}
