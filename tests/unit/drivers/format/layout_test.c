/* Sets as HDR-NeRF and HDR-GS publish them, in small. */
#include "drivers/format/file.h"
#include "drivers/format/imageset.h"
#include "drivers/format/img.h"
#include "drivers/format/layout.h"
#include "drivers/format/llff.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { VIEWS = 3, EXPOSURES = 5, ROWS = VIEWS * EXPOSURES, COLUMNS = 18 };

static const double times[EXPOSURES] = {0.01, 0.05, 0.2, 1, 3};

static void put_picture(const char *name)
{
    static uint8_t px[16 * 12 * 3];
    const struct image8 im = {16, 12, 3, px};
    assert_int_equal(img_write_png(tmpdir_path(name), &im), OK);
}

/* Row of picture i, taken with 32 x 24 px: camera at (i, 2, 3) that looks along -x, z up. */
static void make_row(int i, double row[COLUMNS])
{
    const double pose[15] = {0, 0, 1, i, 24, 0, 1, 0, 2, 32, -1, 0, 0, 3, 40};
    memcpy(row, pose, sizeof pose);
    row[15] = 1;
    row[16] = 9;
    row[17] = times[i % EXPOSURES];
}

struct npy {
    const char *kind, *order;
    int rows, columns;
    char head[160];
    size_t n;
    uint8_t bytes[256 + ROWS * COLUMNS * 8];
};

static void make_npy(struct npy *f)
{
    const bool small = strcmp(f->kind, "<f4") == 0, by_columns = strcmp(f->order, "True") == 0;
    snprintf(f->head, sizeof f->head, "{'descr': '%s', 'fortran_order': %s, 'shape': (%d, %d), }\n",
             f->kind, f->order, f->rows, f->columns);
    const size_t head = strlen(f->head), size = small ? 4 : 8;
    memcpy(f->bytes, "\x93NUMPY\1\0", 8);
    f->bytes[8] = (uint8_t)head;
    f->bytes[9] = 0;
    memcpy(f->bytes + 10, f->head, head);
    f->n = 10 + head;
    for (int k = 0; k < f->rows * f->columns; k++) {
        double row[COLUMNS];
        make_row(by_columns ? k % f->rows : k / f->columns, row);
        const double v = row[by_columns ? k / f->rows : k % f->columns];
        const float v4 = (float)v;
        memcpy(f->bytes + f->n, small ? (const void *)&v4 : &v, size);
        f->n += size;
    }
}

static void put_npy(const char *name, const struct npy *f)
{
    FILE *to;
    assert_int_equal(file_create(tmpdir_path(name), &to), OK);
    fwrite(f->bytes, 1, f->n, to);
    assert_int_equal(file_finish(to, tmpdir_path(name)), OK);
}

static void make_set(const char *folder, const char *pattern)
{
    char name[64];
    tmpdir_mkdir(folder);
    for (int i = 0; i < ROWS; i++) {
        snprintf(name, sizeof name, pattern, i / EXPOSURES, i % EXPOSURES);
        put_picture(name);
    }
}

static void rows_are_poses_of_llff(void **state)
{
    (void)state;
    static struct npy f = {.kind = "<f8", .order = "False", .rows = ROWS, .columns = COLUMNS};
    struct rig_view v[ROWS];
    struct rig rig = {.n = ROWS, .views = v};
    for (int k = 0; k < 3; k++) {
        memset(v, 0, sizeof v);
        f.kind = k == 1 ? "<f4" : "<f8";
        f.order = k == 2 ? "True" : "False";
        make_npy(&f);
        assert_int_equal(llff_parse("l", f.bytes, f.n, &rig), OK);
        assert_true(rig.stored && v[7].has_exposure);
        assert_true(fabsf(v[7].exposure_log2 - log2f(0.2f)) < 1e-5f);
        const struct camera *c = &v[7].cam;
        assert_true(c->w == 32 && c->h == 24 && c->fx == 40 && c->cx == 16 && c->cy == 12);
        /* the axes right, down, forward in the world: +y, -z, -x; so t = (-2, 3, 7) */
        assert_true(fabsf(c->t[0] + 2) < 1e-5f && fabsf(c->t[1] - 3) < 1e-5f &&
                    fabsf(c->t[2] - 7) < 1e-5f);
    }
    f.columns = 17;
    make_npy(&f);
    memset(v, 0, sizeof v);
    assert_int_equal(llff_parse("l", f.bytes, f.n, &rig), OK);
    assert_false(v[0].has_exposure);
}

static void other_arrays_are_refused(void **state)
{
    (void)state;
    static struct npy f = {.kind = "<f8", .order = "False", .rows = ROWS, .columns = COLUMNS};
    struct rig_view v[ROWS + 1];
    struct rig rig = {.n = ROWS, .views = v};
    memset(v, 0, sizeof v);
    make_npy(&f);
    for (size_t n = 0; n < f.n; n += n < 120 ? 1 : 97)
        assert_int_equal(llff_parse("l", f.bytes, n, &rig), ERR_FORMAT);
    rig.n = ROWS + 1;
    assert_int_equal(llff_parse("l", f.bytes, f.n, &rig), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "15 rows for 16 pictures"));
    rig.n = ROWS;
    static const struct {
        int rows, columns;
        const char *kind, *says;
    } wrong[] = {{ROWS, 16, "<f8", "15 x 16 numbers"},
                 {ROWS, COLUMNS, ">f8", "little-endian"},
                 {ROWS, COLUMNS, "<i8", "little-endian"},
                 {0, COLUMNS, "<f8", "0 x 18"}};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        f.kind = wrong[i].kind;
        f.rows = wrong[i].rows;
        f.columns = wrong[i].columns;
        make_npy(&f);
        assert_int_equal(llff_parse("l", f.bytes, f.n, &rig), ERR_FORMAT);
        assert_non_null(strstr(err_text(), wrong[i].says));
    }
    static const struct {
        int column;
        double value;
        const char *says;
    } nonsense[] = {{0, 1, "no rotation"},     {1, NAN, "no rotation"},
                    {9, 32.5, "32.5 x 24 px"}, {14, -1, "focal lengths"},
                    {17, 0, "exposure 0"},     {3, INFINITY, "translation"}};
    f = (struct npy){.kind = "<f8", .order = "False", .rows = ROWS, .columns = COLUMNS};
    for (size_t i = 0; i < sizeof nonsense / sizeof nonsense[0]; i++) {
        make_npy(&f);
        memcpy(f.bytes + 10 + strlen(f.head) + 8 * nonsense[i].column, &nonsense[i].value, 8);
        assert_int_equal(llff_parse("l", f.bytes, f.n, &rig), ERR_FORMAT);
        if (!strstr(err_text(), nonsense[i].says))
            fail_msg("\"%s\" lacks \"%s\"", err_text(), nonsense[i].says);
    }
}

/* Real scenes of HDR-NeRF: exposures and cameras from the array, views 0 and 2 are inputs. */
static void hdr_nerf(void **state)
{
    (void)state;
    static struct npy f = {.kind = "<f8", .order = "False", .rows = ROWS, .columns = COLUMNS};
    struct imageset set;
    make_set("input_images", "input_images/%03d_%d.png");
    make_npy(&f);
    put_npy(LLFF_NAME, &f);
    struct imageset_request rq = {.images = tmpdir_root, .brackets = true};
    if (imageset_list(&rq, &set) != OK)
        fail_msg("%s", err_text());
    const struct shot *s = set.capture.shots;
    assert_int_equal(set.capture.n, 2 * EXPOSURES);
    assert_string_equal(s[5].name, "002_0.png");
    assert_true(s[1].again && !s[5].again && fabs(s[4].exposure - 3) < 1e-5);
    assert_true(s[0].has_camera && s[0].cam.w == 16 && s[0].cam.fx == 20); // half the size
    imageset_free(&set);
    rq = (struct imageset_request){
        .images = tmpdir_path("input_images"), .which = IMAGESET_TEST, .every_exposure = true};
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_int_equal(set.capture.n, EXPOSURES);
    assert_string_equal(set.capture.shots[0].name, "001_0.png");
    imageset_free(&set);
    tmpdir_text("exposure.json", "{\"000_0.png\": 1}"); // says that others have none
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
}

/* Synthetic scenes of HDR-GS: exposures by their numbers, cameras of one exposure in sparse/0. */
static void hdr_gs(void **state)
{
    (void)state;
    struct imageset set;
    make_set("images", "images/%d_%d.png");
    tmpdir_mkdir("exr");
    tmpdir_mkdir("sparse");
    tmpdir_mkdir("sparse/0");
    tmpdir_text("sparse/0/cameras.txt", "1 PINHOLE 16 12 20 20 8 6\n");
    tmpdir_text("sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 0_1.png\n\n2 1 0 0 0 1 0 0 1 1_1.png\n\n"
                                       "3 1 0 0 0 2 0 0 1 2_1.png\n\n");
    struct imageset_request rq = {.images = tmpdir_root, .n_views = 2, .every_exposure = true};
    if (imageset_list(&rq, &set) != OK)
        fail_msg("%s", err_text());
    const struct shot *s = set.capture.shots;
    assert_int_equal(set.capture.n, 2 * EXPOSURES);
    assert_true(s[0].exposure == 0.125 && s[9].exposure == 32 && s[9].cam.t[0] == 2);
    imageset_free(&set);
    put_picture("images/more.png"); // held out
    put_picture("images/other.png");
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "EXIF has no exposure"));
}

/* nerfstudio's file gives cameras and exposures, unless exposure.json is there. */
static void transforms(void **state)
{
    (void)state;
    static const char *const pose = "[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]";
    char text[600];
    struct imageset set;
    tmpdir_mkdir("images");
    put_picture("images/a.png");
    put_picture("images/b.png");
    snprintf(text, sizeof text,
             "{\"w\":16,\"h\":12,\"fl_x\":20,\"frames\":["
             "{\"file_path\":\"images/a.png\",\"exposure\":0.5,\"transform_matrix\":%s},"
             "{\"file_path\":\"images/b.png\",\"exposure\":4,\"transform_matrix\":%s}]}",
             pose, pose);
    tmpdir_text("transforms.json", text);
    struct imageset_request rq = {.images = tmpdir_root};
    if (imageset_list(&rq, &set) != OK)
        fail_msg("%s", err_text());
    assert_true(set.capture.shots[0].exposure == 0.5 && set.capture.shots[1].exposure == 4);
    assert_true(set.capture.shots[1].has_camera && set.capture.shots[1].cam.fx == 20);
    imageset_free(&set);
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.png\": 2}");
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.shots[1].exposure == 2);
    imageset_free(&set);
    put_picture("images/c.png");
    tmpdir_text("exposure.json", "{\"a.png\": 1, \"b.png\": 2, \"c.png\": 2}");
    assert_int_equal(imageset_list(&rq, &set), ERR_FORMAT);
    rq.some_cameras = true;
    assert_int_equal(imageset_list(&rq, &set), OK);
    assert_true(set.capture.n == 2 && set.n_unplaced == 1);
    imageset_free(&set);
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

#define IN_FOLDER(test) cmocka_unit_test_setup_teardown(test, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_are_poses_of_llff), cmocka_unit_test(other_arrays_are_refused),
        IN_FOLDER(hdr_nerf), IN_FOLDER(hdr_gs), IN_FOLDER(transforms)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
