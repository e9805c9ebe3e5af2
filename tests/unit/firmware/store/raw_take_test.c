/* Stored takes read again as the sensor's numbers, and takes whose numbers cannot be used. */
#include "firmware/store/raw_take.h"

#include "drivers/format/img.h"
#include "drivers/format/pixels.h"
#include "drivers/format/rawframe.h"
#include "firmware/store/store.h"
#include "tests/unit/expect.h"
#include "tests/unit/small_take.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <unistd.h>

#include <cmocka.h>

static char take_path[512]; // of the take that is stored last

static void store_take(enum camera_format format)
{
    struct store_config cfg = {.path = tmpdir_path("store")};
    struct store *s;
    char id[STORE_ID_CAP], name[64];
    struct take *t = small_take(2, 2, format);
    expect_ok(store_open(&cfg, &s));
    expect_ok(store_commit(s, t, id));
    take_free(t);
    store_close(s);
    snprintf(name, sizeof name, "store/%s", id);
    snprintf(take_path, sizeof take_path, "%s", tmpdir_path(name));
}

static const char *in_take(const char *name)
{
    static char path[640];
    snprintf(path, sizeof path, "%s/%s", take_path, name);
    return path;
}

static void list(struct imageset *set)
{
    const struct imageset_request rq = {.images = take_path, .every_exposure = true};
    expect_ok(imageset_list(&rq, set));
    expect_ok(raw_take_attach(set));
}

/* sRGB of the light of a column, in 16 bits. */
static double expected(int x, int exposure)
{
    const int top = (1 << SMALL_BITS) - 1 - SMALL_BLACK;
    const double light = fmin(small_radiance(x, SMALL_W) * small_exposure_s(exposure), 1);
    return develop_srgb16((float)(rint(light * top) / top));
}

static void all_numbers(void **state)
{
    (void)state;
    struct imageset set;
    struct image16 deep;
    struct image8 small, file;
    store_take(CAMERA_GREY16);
    list(&set);
    assert_int_equal(set.capture.n, 4);
    assert_int_equal(set.n_notes, 0);
    for (int i = 0; i < set.capture.n; i++) {
        const struct shot *s = &set.capture.shots[i];
        assert_true(s->deep && s->linear && s->raw);
        expect_ok(imageset_decode16(&set, i, &deep));
        expect_ok(imageset_decode(&set, i, &small));
        expect_ok(img_read(in_take("images/train_00_00.png"), &file));
        for (int k = 0; k < 3 * SMALL_W; k++) {
            assert_true(fabs((double)deep.px[k] - expected(k / 3, i % 2)) <= 1);
            if (i % 2 == 0) // its picture in 8 bits was made the same way
                assert_true(abs(small.px[k] - file.px[k]) <= 1);
        }
        pixels_free16(&deep);
        img_free(&small);
        img_free(&file);
    }
    imageset_free(&set);
}

/* White balance of the manifest: red sites get half of the light. */
static void a_mosaic(void **state)
{
    (void)state;
    struct imageset set;
    struct image16 im;
    store_take(CAMERA_RGGB16);
    list(&set);
    assert_true(set.capture.shots[0].linear);
    assert_true(set.raw[0].how.red > 1.5f);
    expect_ok(imageset_decode16(&set, 0, &im));
    const uint16_t *p = im.px + 3 * (8 * SMALL_W + 8);
    for (int c = 0; c < 3; c++)
        assert_true(abs(p[c] - p[1]) < p[1] / 8);
    pixels_free16(&im);
    imageset_free(&set);
}

static void pictures_instead(const char *words)
{
    struct imageset set;
    struct image8 im;
    list(&set);
    assert_int_equal(set.n_notes, words != NULL);
    assert_true(!words || strstr(set.notes[0], words));
    for (int i = 0; i < set.capture.n; i++)
        assert_true(!set.capture.shots[i].raw && !set.capture.shots[i].linear);
    expect_ok(imageset_decode(&set, 0, &im));
    img_free(&im);
    imageset_free(&set);
}

/* A missing or short file of one frame: all are pictures. */
static void lost_files(void **state)
{
    (void)state;
    store_take(CAMERA_GREY16);
    assert_int_equal(truncate(in_take("raw/01_01.bin"), 2 * SMALL_W * SMALL_H - 1), 0);
    pictures_instead("its format needs 1024");
    assert_int_equal(unlink(in_take("raw/01_01.bin")), 0);
    pictures_instead("01_01.bin");
    assert_int_equal(unlink(in_take("manifest.json")), 0);
    pictures_instead(NULL);
    store_take(CAMERA_MJPG);
    pictures_instead(NULL);
}

/* Replace every `from` in the manifest of the take by a text of the same length. */
static void change_manifest(const char *from, const char *to)
{
    struct file_map m;
    FILE *f;
    expect_ok(file_map(in_take("manifest.json"), 1 << 20, &m));
    char *text = strndup((const char *)m.p, m.n);
    file_unmap(&m);
    assert_non_null(strstr(text, from));
    for (char *at = text; (at = strstr(at, from)); at += strlen(to))
        memcpy(at, to, strlen(to));
    f = fopen(in_take("manifest.json"), "w");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
    free(text);
}

static void hostile_facts(void **state)
{
    (void)state;
    static const char *const spoiled[][3] = {
        {"\"w\": 32", "\"w\": 99", "from row to row"},
        {"\"h\": 16", "\"h\": -6", "whole numbers"},
        {"\"bits\": 10", "\"bits\": 77", "77 bits"},
        {"\"black\": 64", "\"black\": 1e", "manifest.json"},
        {"\"black\": 64, ", "\"black\": 9999", "manifest.json"},
        {"grey16", "grey17", "needs pixels"},
        {"\"raw/00", "\"../00", "names no file"},
        {"images/train_00_00", "images/train_09_00", "has no frame of train_00_00.png"},
        {"\"camera\": 1", "\"camera\": 7", "needs one of 2 cameras"},
        {"\"white_red\": 1", "\"white_red\": 0", "white_red"},
    };
    for (size_t i = 0; i < sizeof spoiled / sizeof spoiled[0]; i++) {
        store_take(CAMERA_GREY16);
        change_manifest(spoiled[i][0], spoiled[i][1]);
        pictures_instead(spoiled[i][2]);
    }
}

/* A black level above nearly all numbers is found when they are read. */
static void wrong_black_level(void **state)
{
    (void)state;
    struct imageset set;
    struct image16 im;
    store_take(CAMERA_GREY16);
    change_manifest("\"bits\": 10, \"black\": 64, ", "\"bits\": 10, \"black\":1022,");
    list(&set);
    expect_err(imageset_decode16(&set, 0, &im), ERR_FORMAT,
               "below the black level, which must be wrong (1022)");
    assert_null(im.px);
    imageset_free(&set);
}

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_numbers),       cmocka_unit_test(a_mosaic),
        cmocka_unit_test(lost_files),        cmocka_unit_test(hostile_facts),
        cmocka_unit_test(wrong_black_level),
    };
    return cmocka_run_group_tests(tests, setup, NULL);
}
