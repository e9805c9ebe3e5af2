/* Files of splat-transform, against the splats that it wrote them from and against what it reads
 * itself (tests/data/splats/make.sh); and the same files with one thing changed. */
#include "drivers/format/sog.h"

#include "drivers/format/file.h"
#include "drivers/format/ply.h"
#include "drivers/format/zipfile.h"

#include "tests/unit/drivers/format/truth.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <webp/encode.h>
#include <zip.h>

#include <cmocka.h>

#define DATA "tests/data/splats/"

enum { SPLATS = 48, TEXT_CAP = 1 << 16 };

static struct arena arena;

static err_t read_file(const struct splats_format *format, const char *path, struct gaussians *g)
{
    struct gaussians_report report = {0};
    struct splats_info info;
    err_t e = splats_peek(format, path, &info);
    if (!e)
        e = splats_read(format, path, 1, &arena, g, &report);
    assert_true(e || (g->degree == info.degree && g->n == info.n && report.dropped == 0));
    assert_true(e || format != &sog_format || (!info.has_hdr && info.ev == 0));
    return e;
}

static void read_good(const struct splats_format *format, const char *path, struct gaussians *g)
{
    const err_t e = read_file(format, path, g);
    if (e)
        fail_msg("%s", err_text());
    assert_true(g->n == SPLATS);
}

/* ---- as others read and write it ---- */

static void check_same(const struct gaussians *g, const struct gaussians *want)
{
    assert_int_equal(g->degree, want->degree);
    for (int p = 0; p < gaussians_planes(g->degree); p++)
        for (int i = 0; i < g->n; i++)
            assert_true(fabsf(g->plane[p][i] - want->plane[p][i]) <
                        2e-6f * (1 + fabsf(want->plane[p][i])));
}

static void reading_is_that_of_splat_transform(void **state)
{
    (void)state;
    struct gaussians g, want;
    arena_reset(&arena, 0);
    read_good(&sog_format, DATA "two.sog", &g);
    read_good(&ply_format, DATA "two.ply", &want);
    check_same(&g, &want);
    read_good(&sog_format, DATA "one.sog", &g);
    read_good(&ply_format, DATA "one.ply", &want);
    check_same(&g, &want);
    assert_int_equal(g.degree, 2);
}

/* 32 sets of harmonics are left of 48, so these are only near. */
static void what_was_written_is_read(void **state)
{
    (void)state;
    struct gaussians g, truth;
    arena_reset(&arena, 0);
    read_good(&sog_format, DATA "two.sog", &g);
    read_good(&ply_format, DATA "truth.ply", &truth);
    assert_true(truth_holds(&truth, &g, &(struct truth_bound){2e-4f, 0.01f, 0.012f, 0.25f, 1}));
}

/* ---- what is changed ---- */

static char meta[TEXT_CAP];

/* A member of two.sog. */
static size_t load(const char *name, void *out, size_t cap)
{
    struct zipfile z;
    struct zipfile_info info;
    uint64_t index;
    assert_int_equal(zipfile_open(DATA "two.sog", &z), OK);
    assert_true(zipfile_find(&z, name, &index));
    assert_int_equal(zipfile_look(&z, index, &info), OK);
    assert_true(info.bytes < cap);
    assert_int_equal(zipfile_read(&z, index, 0, out, (size_t)info.bytes), OK);
    zipfile_close(&z);
    return (size_t)info.bytes;
}

static const char *copy_sog(void)
{
    struct file_map m;
    assert_int_equal(file_map(DATA "two.sog", SIZE_MAX, &m), OK);
    const char *path = tmpdir_write("x.sog", m.p, m.n);
    file_unmap(&m);
    return path;
}

/* The archive gets another member of that name; bytes NULL: it loses it. */
static const char *alter(const char *path, const char *name, const void *bytes, size_t n)
{
    int code;
    zip_t *z = zip_open(path, 0, &code);
    assert_non_null(z);
    if (bytes)
        assert_true(zip_file_add(z, name, zip_source_buffer(z, bytes, n, 0), ZIP_FL_OVERWRITE) >=
                    0);
    else
        assert_int_equal(zip_delete(z, (zip_uint64_t)zip_name_locate(z, name, 0)), 0);
    assert_int_equal(zip_close(z), 0);
    return path;
}

static const char *change(const char *name, const void *bytes, size_t n)
{
    return alter(copy_sog(), name, bytes, n);
}

/* two.sog with other words in meta.json. */
static const char *reword(const char *from, const char *to)
{
    static char text[TEXT_CAP];
    meta[load(SOG_META, meta, sizeof meta)] = 0;
    const char *at = strstr(meta, from);
    assert_non_null(at);
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - meta), meta, to, at + strlen(from));
    return change(SOG_META, text, strlen(text));
}

/* The archive gets a picture of w x h px that are all these four bytes. */
static const char *paint(const char *path, const char *name, int w, int h, const uint8_t px[4])
{
    uint8_t *all = malloc(4 * (size_t)w * (size_t)h), *out;
    for (int i = 0; i < w * h; i++)
        memcpy(all + 4 * i, px, 4);
    const size_t n = WebPEncodeLosslessRGBA(all, w, h, 4 * w, &out);
    assert_true(n > 0);
    alter(path, name, out, n);
    WebPFree(out);
    free(all);
    return path;
}

static void expect(const char *path, err_t code, const char *words)
{
    struct gaussians g = {0};
    arena_reset(&arena, 0);
    const err_t e = read_file(&sog_format, path, &g);
    if (e != code || !strstr(err_text(), words))
        fail_msg("%d: \"%s\" instead of %d: \"%s\"", e, err_text(), code, words);
    assert_true(g.plane[0] == NULL || e == OK);
}

static void a_meta_that_lies_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *from, *to, *words;
        err_t code;
    } lies[] = {
        {"\"version\":2", "\"version\":3", "version 3 of SOG, 1 and 2", ERR_UNSUPPORTED},
        {"\"version\":2", "\"version\":\"2\"", "version 0", ERR_UNSUPPORTED},
        {"\"version\":2", "\"version\":1", "\"shape\" is not an array", ERR_FORMAT},
        {"\"count\":48", "\"count\":20000000", "2e+07 splats, 0 to 16777216", ERR_FORMAT},
        {"\"count\":48", "\"count\":4.5", "4.5 splats", ERR_FORMAT},
        {"\"count\":48", "\"many\":48", "\"count\" is absent", ERR_FORMAT},
        {"\"count\":48", "\"count\":-1", "-1 splats", ERR_FORMAT},
        {"\"count\":48", "\"count\":65", "8 x 8 px for 65 splats", ERR_FORMAT},
        {"\"mins\":[", "\"mins\":[0,", "\"means\": \"mins\" is not an array of 3", ERR_FORMAT},
        {"\"mins\":[", "\"mins\":[1e99],\"x\":[", "\"mins\" is not", ERR_FORMAT},
        {"\"codebook\":[", "\"codebook\":[0,", "\"scales\": no \"codebook\" of 256", ERR_FORMAT},
        {"\"codebook\":[", "\"codebook\":[0,null],\"x\":[", "of 256 numbers", ERR_FORMAT},
        {"[\"means_l.webp\",", "[", "\"means\": no 2 \"files\"", ERR_FORMAT},
        {"[\"means_l.webp\"", "[7", "\"files\" holds what is no name", ERR_FORMAT},
        {"\"means_l.webp\"", "\"../means_l.webp\"", "slashes", ERR_FORMAT},
        {"\"means_l.webp\"", "\"none.webp\"", "none.webp: not in the archive", ERR_FORMAT},
        {"\"quats\":", "\"quads\":", "\"quats\": no 1 \"files\"", ERR_FORMAT},
        {"{", "[", "meta.json", ERR_FORMAT},
    };
    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++)
        expect(reword(lies[i].from, lies[i].to), lies[i].code, lies[i].words);
    expect(change(SOG_META, NULL, 0), ERR_FORMAT, "x.sog: meta.json: not in the archive");
    expect(change(SOG_META, meta, sizeof meta), ERR_FORMAT, "meta.json");
}

static void pictures_that_do_not_fit_are_refused(void **state)
{
    (void)state;
    const uint8_t last[4] = {255, 255, 0, 255};
    static uint8_t bytes[TEXT_CAP];
    expect(paint(copy_sog(), "sh0.webp", 6, 7, last), ERR_FORMAT,
           "sh0.webp: 6 x 7 px for 48 splats");
    expect(paint(copy_sog(), "sh0.webp", 257, 257, last), ERR_FORMAT,
           "257 x 257 px, at most 65728 in all");
    expect(paint(copy_sog(), "shN_labels.webp", 8, 8, last), ERR_FORMAT,
           "splat 0 has harmonics 65535 of 64");
    expect(paint(copy_sog(), "shN_centroids.webp", 513, 1, last), ERR_FORMAT, "513 px wide");
    expect(paint(copy_sog(), "shN_centroids.webp", 960, 1025, last), ERR_FORMAT,
           "at most 983040 in all");
    expect(change("quats.webp", NULL, 0), ERR_FORMAT, "quats.webp: not in the archive");
    const size_t n = load("means_l.webp", bytes, sizeof bytes);
    for (size_t k = 0; k < n; k++)
        expect(change("means_l.webp", bytes, k), ERR_FORMAT, "x.sog: means_l.webp: ");
    memcpy(bytes + 12, "VP8?", 4);
    expect(change("means_l.webp", bytes, n), ERR_FORMAT, "no WebP picture");
    bytes[0] = 0;
    expect(change("means_l.webp", bytes, 3 << 13), ERR_FORMAT, "no WebP picture");
}

static void damaged_archives_are_refused(void **state)
{
    (void)state;
    struct file_map m;
    static uint8_t bytes[TEXT_CAP];
    assert_int_equal(file_map(DATA "two.sog", sizeof bytes, &m), OK);
    const size_t n = m.n;
    memcpy(bytes, m.p, n);
    file_unmap(&m);
    for (size_t k = 0; k < n; k += 83)
        expect(tmpdir_write("cut.sog", bytes, k), ERR_FORMAT, "cut.sog: ");
    const uint8_t *at = memmem(bytes, n, "means_l.webp", 12); // its local header, then its data
    bytes[at - bytes + 12 + 40] ^= 1;
    expect(tmpdir_write("bit.sog", bytes, n), ERR_FORMAT, "means_l.webp: CRC error");
}

static void a_folder_is_read_as_its_archive(void **state)
{
    (void)state;
    struct gaussians g, want;
    arena_reset(&arena, 0);
    read_good(&sog_format, DATA "one.sog", &want);
    read_good(&sog_format, DATA "one/meta.json", &g);
    for (int p = 0; p < gaussians_planes(g.degree); p++)
        assert_memory_equal(g.plane[p], want.plane[p], SPLATS * sizeof(float));
    const char *path = tmpdir_write("meta.json", meta, load(SOG_META, meta, sizeof meta));
    expect(path, ERR_IO, "/shN_centroids.webp: ");
}

static void what_writers_leave_out_is_read(void **state)
{
    (void)state;
    const uint8_t unturned[4] = {9, 9, 9, 251}, ends[4] = {0, 1, 255, 255};
    const char *path;
    struct gaussians g;
    arena_reset(&arena, 0);
    read_good(&sog_format, reword("\"shN\":", "\"shM\":"), &g);
    assert_int_equal(g.degree, 0);
    read_good(&sog_format, paint(copy_sog(), "quats.webp", 8, 8, unturned), &g);
    for (int i = 0; i < g.n; i++)
        assert_true(g.plane[G_QUAT][i] == 1 && g.plane[G_QUAT + 1][i] == 0 &&
                    g.plane[G_QUAT + 2][i] == 0 && g.plane[G_QUAT + 3][i] == 0);

    /* What comes before the first number of a codebook goes on as the others do. */
    char first[64];
    const char *scales = strstr(meta, "\"scales\"");
    snprintf(first, sizeof first, "%.*s", (int)strcspn(scales, ","), scales);
    path = paint(reword(first, "\"scales\":{\"codebook\":[null"), "scales.webp", 8, 8, ends);
    read_good(&sog_format, path, &g);
    const float second = g.plane[G_LOG_SCALE + 1][0], last = g.plane[G_LOG_SCALE + 2][0];
    assert_true(second < last &&
                fabsf(g.plane[G_LOG_SCALE][0] - second - (second - last) / 255) < 1e-6f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reading_is_that_of_splat_transform),
        cmocka_unit_test(what_was_written_is_read),
        cmocka_unit_test(a_meta_that_lies_is_refused),
        cmocka_unit_test(pictures_that_do_not_fit_are_refused),
        cmocka_unit_test(damaged_archives_are_refused),
        cmocka_unit_test(a_folder_is_read_as_its_archive),
        cmocka_unit_test(what_writers_leave_out_is_read),
    };
    if (arena_init(&arena, "test", 1 << 20) != OK)
        return 1;
    int failed = cmocka_run_group_tests(tests, tmpdir_setup, tmpdir_teardown);
    arena_free(&arena);
    return failed;
}
