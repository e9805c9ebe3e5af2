#include "drivers/format/rigfile.h"
#include "drivers/format/transforms.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

/* A camera at (1, 2, 3) that looks along -x of the world, with z up. */
#define POSE "[[0,0,1,1],[1,0,0,2],[0,1,0,3],[0,0,0,1]]"
#define FRAME "{\"file_path\":\"./images/a.jpg\",\"transform_matrix\":" POSE "}"
#define SIZES "\"w\":640,\"h\":480,\"fl_x\":500,\"fl_y\":510,\"cx\":321,\"cy\":239"
#define FILE_OF(top, frames) "{" top ",\"frames\":[" frames "]}"

static err_t parse(const char *text, struct rig *out)
{
    return transforms_parse("t", text, strlen(text), out);
}

static void axes_are_those_of_opengl(void **state)
{
    (void)state;
    struct rig rig;
    assert_int_equal(parse(FILE_OF(SIZES, FRAME), &rig), OK);
    assert_true(rig.n == 1 && rig.stored);
    const struct camera *c = &rig.views[0].cam;
    assert_string_equal(rig.views[0].name, "a.jpg");
    assert_true(c->w == 640 && c->h == 480 && c->fx == 500 && c->fy == 510 && c->cx == 321);
    assert_int_equal(rig.views[0].lens.model, LENS_PINHOLE);
    float x[3]; // a point ahead, to the right and above: (-4, 1, 2) from the camera
    const float world[3] = {-3, 3, 5}, want[3] = {1, -2, 4}, *q = c->q;
    const float r[9] = {1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]),
                        2 * (q[1] * q[3] + q[0] * q[2]),     2 * (q[1] * q[2] + q[0] * q[3]),
                        1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[2] * q[3] - q[0] * q[1]),
                        2 * (q[1] * q[3] - q[0] * q[2]),     2 * (q[2] * q[3] + q[0] * q[1]),
                        1 - 2 * (q[1] * q[1] + q[2] * q[2])};
    for (int i = 0; i < 3; i++) {
        x[i] = r[3 * i] * world[0] + r[3 * i + 1] * world[1] + r[3 * i + 2] * world[2] + c->t[i];
        assert_true(fabsf(x[i] - want[i]) < 1e-5f);
    }
    cameras_free(&rig);
}

/* As ns-process-data and instant-ngp write them. */
static void lenses_of_both_kinds(void **state)
{
    (void)state;
    struct rig rig;
    assert_int_equal(parse(FILE_OF(SIZES ",\"camera_model\":\"OPENCV\",\"k1\":-0.1,\"k2\":0.02,"
                                         "\"p1\":0.001,\"p2\":-0.002,\"k3\":0,\"aabb_scale\":16",
                                   FRAME),
                           &rig),
                     OK);
    const struct lens *l = &rig.views[0].lens;
    assert_true(l->model == LENS_OPENCV && l->term[1] == 0.02 && l->term[3] == -0.002);
    cameras_free(&rig);
    assert_int_equal(parse(FILE_OF(SIZES ",\"camera_model\":\"OPENCV_FISHEYE\",\"k1\":-0.01,"
                                         "\"k4\":0.002",
                                   FRAME),
                           &rig),
                     OK);
    l = &rig.views[0].lens;
    assert_true(l->model == LENS_OPENCV_FISHEYE && l->term[0] == -0.01 && l->term[3] == 0.002);
    cameras_free(&rig);
    assert_int_equal(
        parse(FILE_OF(SIZES ",\"camera_model\":\"SIMPLE_PINHOLE\",\"k1\":0.1", FRAME), &rig),
        OK); // programs apply the term nevertheless
    assert_true(rig.views[0].lens.model == LENS_OPENCV && rig.views[0].lens.term[0] == 0.1);
    cameras_free(&rig);
    assert_int_equal(
        parse(FILE_OF("\"w\":640,\"h\":480,\"camera_angle_x\":1.5707963267948966", FRAME), &rig),
        OK);
    assert_true(fabsf(rig.views[0].cam.fx - 320) < 1e-3f && rig.views[0].cam.cy == 240);
    cameras_free(&rig);
}

static void a_frame_may_have_its_own(void **state)
{
    (void)state;
    struct rig rig;
    assert_int_equal(
        parse(
            FILE_OF(SIZES ",\"k1\":0.1",
                    "{\"file_path\":\"images/b.png\",\"w\":320,\"h\":240,\"fl_x\":100,\"fl_y\":100,"
                    "\"cx\":160,\"cy\":120,\"k1\":0,\"exposure\":0.125,\"transform_matrix\":" POSE
                    "}," FRAME),
            &rig),
        OK);
    assert_true(rig.n == 2 && rig.views[0].cam.w == 320 && rig.views[0].cam.fx == 100);
    assert_true(rig.views[0].lens.model == LENS_PINHOLE && rig.views[1].lens.term[0] == 0.1);
    assert_true(rig.views[0].has_exposure && rig.views[0].exposure_log2 == -3);
    assert_true(!rig.views[1].has_exposure && rig.views[1].cam.w == 640);
    cameras_free(&rig);
}

static void a_rig_has_a_folder_for_each_camera(void **state)
{
    (void)state;
    struct rig rig;
    assert_int_equal(parse(FILE_OF(SIZES, FRAME ",{\"file_path\":\"right/a.jpg\","
                                                "\"transform_matrix\":" POSE "}"),
                           &rig),
                     OK);
    assert_string_equal(rig.views[0].name, "images_a.jpg");
    assert_string_equal(rig.views[1].name, "right_a.jpg");
    cameras_free(&rig);
}

static void nonsense_is_refused_with_its_name(void **state)
{
    (void)state;
    static const struct {
        err_t e;
        const char *text, *says;
    } wrong[] = {
        {ERR_FORMAT, "{\"frame\":[]}", "no array \"frames\""},
        {ERR_FORMAT, FILE_OF(SIZES, ""), "0 frames"},
        {ERR_FORMAT, FILE_OF(SIZES, "{}"), "frame 0: \"file_path\""},
        {ERR_FORMAT, FILE_OF(SIZES, "7"), "\"file_path\""},
        {ERR_FORMAT, FILE_OF(SIZES, FRAME "," FRAME), "images_a.jpg is named twice"},
        {ERR_FORMAT, FILE_OF("\"fl_x\":5", FRAME), "\"w\" is absent"},
        {ERR_FORMAT, FILE_OF("\"w\":8.5", FRAME), "\"w\" is absent"},
        {ERR_FORMAT, FILE_OF("\"w\":8,\"h\":6", FRAME), "neither \"fl_x\" nor"},
        {ERR_FORMAT, FILE_OF("\"w\":8,\"h\":6,\"camera_angle_x\":4", FRAME), "neither \"fl_x\""},
        {ERR_FORMAT, FILE_OF("\"w\":8,\"h\":6,\"fl_x\":\"5\"", FRAME), "\"fl_x\" is not a finite"},
        {ERR_FORMAT, FILE_OF("\"w\":8,\"h\":6,\"fl_x\":-5", FRAME), "not positive"},
        {ERR_FORMAT, FILE_OF("\"w\":99999,\"h\":6,\"fl_x\":5", FRAME), "99999 x 6 px"},
        {ERR_FORMAT, FILE_OF(SIZES, "{\"file_path\":\"a\"}"), "not 4 x 4 numbers"},
        {ERR_FORMAT, FILE_OF(SIZES, "{\"file_path\":\"a/\",\"transform_matrix\":" POSE "}"),
         "name"},
        {ERR_FORMAT,
         FILE_OF(SIZES, "{\"file_path\":\"a\",\"transform_matrix\":[[1,0,0,0],[0,1,0,0],[0,0,1]]}"),
         "not 4 x 4 numbers"},
        {ERR_FORMAT,
         FILE_OF(SIZES, "{\"file_path\":\"a\",\"transform_matrix\":[[2,0,0,0],[0,2,0,0],[0,0,2,0],"
                        "[0,0,0,1]]}"),
         "no rotation within"},
        {ERR_FORMAT,
         FILE_OF(SIZES, "{\"file_path\":\"a\",\"transform_matrix\":[[-1,0,0,0],[0,1,0,0],[0,0,1,0],"
                        "[0,0,0,1]]}"),
         "no rotation within"},
        {ERR_FORMAT,
         FILE_OF(SIZES, "{\"file_path\":\"a\",\"exposure\":0,\"transform_matrix\":" POSE "}"),
         "\"exposure\" is not"},
        {ERR_UNSUPPORTED, FILE_OF(SIZES ",\"camera_model\":\"EQUIRECTANGULAR\"", FRAME),
         "EQUIRECTANGULAR is not read"},
        {ERR_UNSUPPORTED, FILE_OF(SIZES ",\"camera_model\":7", FRAME), "is not read"},
        {ERR_UNSUPPORTED, FILE_OF(SIZES ",\"k3\":0.1", FRAME), "OPENCV has no such term"},
        {ERR_UNSUPPORTED, FILE_OF(SIZES ",\"camera_model\":\"OPENCV_FISHEYE\",\"p1\":1", FRAME),
         "OPENCV_FISHEYE has no such term"},
    };
    struct rig rig;
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        if (parse(wrong[i].text, &rig) != wrong[i].e || !strstr(err_text(), wrong[i].says))
            fail_msg("%zu: \"%s\" lacks \"%s\"", i, err_text(), wrong[i].says);
        assert_null(rig.views);
    }
}

static void a_rig_is_known_by_what_is_in_it(void **state)
{
    (void)state;
    struct rig rig;
    tmpdir_mkdir("set");
    tmpdir_text("set/transforms.json", FILE_OF(SIZES, FRAME));
    assert_int_equal(rigfile_read(tmpdir_path("set"), &rig), OK);
    cameras_free(&rig);
    assert_int_equal(rigfile_read(tmpdir_text("any.json", FILE_OF(SIZES, FRAME)), &rig), OK);
    cameras_free(&rig);
    assert_int_equal(rigfile_read(tmpdir_text("any.json", "{}"), &rig), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "no array \"cameras\""));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(axes_are_those_of_opengl),
        cmocka_unit_test(lenses_of_both_kinds),
        cmocka_unit_test(a_frame_may_have_its_own),
        cmocka_unit_test(a_rig_has_a_folder_for_each_camera),
        cmocka_unit_test(nonsense_is_refused_with_its_name),
        cmocka_unit_test(a_rig_is_known_by_what_is_in_it),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failed;
}
