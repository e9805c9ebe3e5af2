/* The fixtures colmap_txt and colmap_bin hold the same small model: three cameras of three models,
 * three views (one name with a folder, one view with image points), two points with and without
 * track. */
#include "drivers/format/colmap.h"
#include "drivers/format/file.h"

#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define TXT "tests/data/sets/colmap_txt"
#define BIN "tests/data/sets/colmap_bin"

static void check_model(const char *dir)
{
    struct rig rig;
    assert_int_equal(colmap_read(dir, &rig), OK);
    assert_int_equal(rig.n, 3);
    assert_string_equal(rig.views[1].name, "train_ldr_001_2.png");
    const struct camera want[3] = {
        {8, 6, 5.5f, 5.25f, 4, 3, {1, 0, 0, 0}, {0, 0, 0}},
        {8, 6, 6.5f, 6.5f, 4.25f, 3, {.5f, -.5f, .5f, -.5f}, {.25f, -1.125f, 3}},
        {16, 12, 11, 10.5f, 8, 6, {.6f, 0, .8f, 0}, {1e-3f, 0, -2.5f}}};
    for (int i = 0; i < 3; i++)
        assert_memory_equal(&rig.views[i].cam, &want[i], sizeof want[i]);
    cameras_free(&rig);
}

static void check_points(const char *dir)
{
    struct colmap_points points;
    assert_int_equal(colmap_read_points(dir, &points), OK);
    assert_int_equal(points.n, 2);
    assert_true(points.p[0].xyz[1] == -0.25f && points.p[1].xyz[2] == 3);
    assert_true(points.p[0].rgb[2] == 255 && points.p[1].rgb[1] == 128);
    colmap_free_points(&points);
}

static void text_and_binary_say_the_same(void **state)
{
    (void)state;
    check_model(TXT);
    check_model(BIN);
    check_points(TXT);
    check_points(BIN);
}

static void absent_files(void **state)
{
    (void)state;
    struct rig rig;
    struct colmap_points points;
    const char *dir = tmpdir_mkdir("empty");
    assert_int_equal(colmap_read(dir, &rig), ERR_IO);
    assert_int_equal(colmap_read_points(dir, &points), OK);
    assert_int_equal(points.n, 0);
    tmpdir_text("empty/images.bin", "");
    tmpdir_text("empty/cameras.txt", "");
    assert_int_equal(colmap_read(dir, &rig), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "both"));
}

static err_t parse_text(const char *cameras, const char *images)
{
    struct rig rig;
    err_t e = colmap_parse(false, &(struct colmap_text){"cameras.txt", cameras, strlen(cameras)},
                           &(struct colmap_text){"images.txt", images, strlen(images)}, &rig);
    if (e)
        assert_null(rig.views);
    cameras_free(&rig);
    return e;
}

/* Models and parameters as COLMAP writes them; a lens whose terms are 0 is a pinhole. */
static void lenses_are_read(void **state)
{
    (void)state;
    static const struct {
        const char *camera;
        enum lens_model model;
        float fx, fy, cx, cy;
        double term[LENS_TERMS];
    } read[] = {
        {"1 SIMPLE_PINHOLE 8 6 5 4 3", LENS_PINHOLE, 5, 5, 4, 3, {0}},
        {"1 PINHOLE 8 6 5 6 4 3", LENS_PINHOLE, 5, 6, 4, 3, {0}},
        {"1 SIMPLE_RADIAL 8 6 5 4 3 -0.1", LENS_SIMPLE_RADIAL, 5, 5, 4, 3, {-0.1}},
        {"1 RADIAL 8 6 5 4 3 0 0", LENS_PINHOLE, 5, 5, 4, 3, {0}},
        {"1 RADIAL 8 6 5 4 3 -0.2 0.01", LENS_RADIAL, 5, 5, 4, 3, {-0.2, 0.01}},
        {"1 OPENCV 8 6 5 6 4 3 .1 .2 .3 .4", LENS_OPENCV, 5, 6, 4, 3, {.1, .2, .3, .4}},
        {"1 OPENCV_FISHEYE 8 6 5 6 4 3 0 0 0 0", LENS_OPENCV_FISHEYE, 5, 6, 4, 3, {0}},
    };
    static const char *const image = "1 1 0 0 0 0 0 0 1 a.png\n\n";
    for (size_t i = 0; i < sizeof read / sizeof *read; i++) {
        struct rig rig;
        const char *text = read[i].camera;
        const struct colmap_text cameras = {"cameras.txt", text, strlen(text)};
        const struct colmap_text images = {"images.txt", image, strlen(image)};
        assert_int_equal(colmap_parse(false, &cameras, &images, &rig), OK);
        const struct rig_view *v = &rig.views[0];
        assert_int_equal(v->lens.model, read[i].model);
        assert_true(v->cam.fx == read[i].fx && v->cam.fy == read[i].fy);
        assert_true(v->cam.cx == read[i].cx && v->cam.cy == read[i].cy && v->cam.w == 8);
        assert_memory_equal(v->lens.term, read[i].term, sizeof read[i].term);
        cameras_free(&rig);
    }
}

static void contradictions_are_named(void **state)
{
    (void)state;
    static const char *const camera = "1 PINHOLE 8 6 5 5 4 3\n", *const image =
                                                                     "1 1 0 0 0 0 0 0 1 a.png\n\n";
    static const struct {
        const char *cameras, *images, *sentence;
        err_t code;
    } wrong[] = {
        {"1 FULL_OPENCV 8 6 5 5 4 3 0 0 0 0 0 0 0 0", image, "FULL_OPENCV", ERR_UNSUPPORTED},
        {"1 NEW_MODEL 8 6 5 5 4 3 0 0 0 0", image, "NEW_MODEL", ERR_UNSUPPORTED},
        {"1 SIMPLE_RADIAL 8 6 5 4 3", image, "line 1", ERR_FORMAT},
        {"1 SIMPLE_RADIAL 8 6 5 4 3 nan", image, "SIMPLE_RADIAL", ERR_FORMAT},
        {"1 PINHOLE 8 6 5 5 4", image, "line 1", ERR_FORMAT},
        {"1 PINHOLE 8 6 5 5 4 3 9", image, "more parameters", ERR_FORMAT},
        {"1 PINHOLE 8 6 0 5 4 3", image, "focal", ERR_FORMAT},
        {"1 PINHOLE 8 6 5 5 nan 3", image, "parameter 2 is not finite", ERR_FORMAT},
        {"1 PINHOLE 0 6 5 5 4 3", image, "0 x 6", ERR_FORMAT},
        {"1 PINHOLE 8 9e9 5 5 4 3", image, "whole number", ERR_FORMAT},
        {"1 PINHOLE 8 6 5 5 4 3\n1 PINHOLE 8 6 5 5 4 3", image, "twice", ERR_FORMAT},
        {"", image, "camera 1", ERR_FORMAT},
        {camera, "", "no images", ERR_FORMAT},
        {camera, "1 1 0 0 0 0 0 0 2 a.png\n\n", "camera 2", ERR_FORMAT},
        {camera, "1 2 0 0 0 0 0 0 1 a.png\n\n", "quaternion", ERR_FORMAT},
        {camera, "1 1 0 0 0 inf 0 0 1 a.png\n\n", "translation", ERR_FORMAT},
        {camera, "1 1 0 0 0 0 0 0 1\n\n", "name", ERR_FORMAT},
        {camera, "1 1 0 0 0 0 0 0 1 x/..\n\n", "folder", ERR_FORMAT},
        {camera, "1 1 0 0 0 0 0 x 1 a.png\n\n", "\"x 1 a.png\"", ERR_FORMAT},
        {camera, "1 1 0 0 0 0 0 0 1 b/a.png\n\n2 1 0 0 0 0 0 0 1 b/a.png\n\n",
         "b_a.png is named twice", ERR_FORMAT},
    };
    assert_int_equal(parse_text(camera, image), OK);
    assert_int_equal(parse_text(camera, "1 1 0 0 0 0 0 0 1 with blank.png\r\n"), OK);
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_equal(parse_text(wrong[i].cameras, wrong[i].images), wrong[i].code);
        if (!strstr(err_text(), wrong[i].sentence))
            fail_msg("\"%s\" lacks \"%s\"", err_text(), wrong[i].sentence);
    }
}

/* Copies of exact length, so that the address sanitiser sees a byte too many. */
static err_t parse_cut(const struct file_map *cameras, size_t n_cameras,
                       const struct file_map *images, size_t n_images)
{
    struct rig rig;
    char *c = malloc(n_cameras + 1), *i = malloc(n_images + 1);
    memcpy(c + 1, cameras->p, n_cameras);
    memcpy(i + 1, images->p, n_images);
    err_t e = colmap_parse(true, &(struct colmap_text){"cameras.bin", c + 1, n_cameras},
                           &(struct colmap_text){"images.bin", i + 1, n_images}, &rig);
    cameras_free(&rig);
    free(c);
    free(i);
    return e;
}

static void every_cut_of_the_binaries_is_refused(void **state)
{
    (void)state;
    struct file_map c, i, p;
    struct colmap_points points;
    assert_int_equal(file_map(BIN "/cameras.bin", 1 << 20, &c), OK);
    assert_int_equal(file_map(BIN "/images.bin", 1 << 20, &i), OK);
    assert_int_equal(file_map(BIN "/points3D.bin", 1 << 20, &p), OK);
    assert_int_equal(parse_cut(&c, c.n, &i, i.n), OK);
    for (size_t n = 0; n < c.n; n++)
        assert_int_equal(parse_cut(&c, n, &i, i.n), ERR_FORMAT);
    for (size_t n = 0; n < i.n; n++)
        assert_int_equal(parse_cut(&c, c.n, &i, n), ERR_FORMAT);
    for (size_t n = 0; n < p.n; n++)
        assert_int_equal(colmap_parse_points(true, &(struct colmap_text){"p", p.p, n}, &points),
                         ERR_FORMAT);
    file_unmap(&c);
    file_unmap(&i);
    file_unmap(&p);
}

static void absurd_counts_are_refused(void **state)
{
    (void)state;
    uint8_t many[16] = {0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff};
    struct rig rig;
    struct colmap_points points;
    struct colmap_text t = {"t", many, sizeof many};
    assert_int_equal(colmap_parse(true, &t, &t, &rig), ERR_FORMAT);
    assert_int_equal(colmap_parse_points(true, &t, &points), ERR_FORMAT);
    assert_null(points.p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(text_and_binary_say_the_same),
        cmocka_unit_test(absent_files),
        cmocka_unit_test(lenses_are_read),
        cmocka_unit_test(contradictions_are_named),
        cmocka_unit_test(every_cut_of_the_binaries_is_refused),
        cmocka_unit_test(absurd_counts_are_refused),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failed;
}
