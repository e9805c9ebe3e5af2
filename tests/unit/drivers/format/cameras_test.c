#include "drivers/format/cameras.h"
#include "drivers/format/exposures.h"
#include "drivers/format/name.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#define GOOD                                                                                       \
    "{\"name\":\"a.png\",\"w\":8,\"h\":6,\"fx\":5,\"fy\":5,\"cx\":4,\"cy\":3,\"q\":[1,0,0,0],"     \
    "\"t\":[0,0,0]}"
#define RIG(view) "{\"cameras\":[" view "]}"

static err_t parse(const char *text, struct rig *rig)
{
    return cameras_parse("c", text, strlen(text), rig);
}

static err_t find(const struct rig *rig, const char *name, int w, int h, struct rig_view *out)
{
    const struct cameras_picture picture = {name, w, h, 1};
    return cameras_find("r", rig, &picture, out);
}

/* All but the photograph. */
static void assert_same_view(const struct rig_view *a, const struct rig_view *b)
{
    assert_string_equal(a->name, b->name);
    assert_memory_equal(&a->cam, &b->cam, sizeof b->cam);
    assert_int_equal(a->lens.model, b->lens.model);
    assert_memory_equal(a->lens.term, b->lens.term, sizeof b->lens.term);
    assert_true(a->has_exposure == b->has_exposure);
    assert_true(a->exposure_log2 == b->exposure_log2);
    assert_int_equal(a->photograph.w, b->photograph.w);
    assert_string_equal(a->camera, b->camera);
    assert_true(a->has_light == b->has_light);
    assert_memory_equal(a->deviation, b->deviation, sizeof b->deviation);
    assert_true(a->has_covariance == b->has_covariance);
    assert_memory_equal(a->covariance, b->covariance, sizeof b->covariance);
    assert_memory_equal(&a->light, &b->light, sizeof b->light);
}

static void what_is_written_is_read_bit_for_bit(void **state)
{
    (void)state;
    struct rig_view v[2] = {{"a \"quoted\\\" \xc3\xa9.png",
                             {640,
                              480,
                              127.481026f,
                              0.0100531215f,
                              119.711685f,
                              -0.0103268465f,
                              {0.694912981f, 0.7071484f, -0.0930978648f, 0.0914870255f},
                              {1.f / 3, -3e8f, 1e-40f}},
                             {LENS_OPENCV,
                              127.48102569580078,
                              0.010053121484816074,
                              119.71168518066406,
                              -0.010326846502721310,
                              {-0.31, 1. / 3, 1e-3, 0},
                              0},
                             true,
                             -3.1f,
                             {0, 0, {0}},
                             "Maker \"A\" 50 mm 31x7",
                             true,
                             {{-0.5, 0.25, 0}, {0.125, 0, -1.5}},
                             true,
                             {0.0123456789f, 1e-9f},
                             true,
                             {1e-8f, -3e-9f, 2e-8f, 0, 0, 1.f / 3, [20] = 1e-40f}},
                            {"b.png",
                             {1, 65536, 1, 2, 3, 4, {0, 0, 0, -1}, {0, 0, 0}},
                             {0},
                             false,
                             0,
                             {31, 7, {LENS_RADIAL, 1. / 3, 1. / 3, 2, 3, {-0.1, 1e-9}, 0}},
                             "",
                             false,
                             {{0}, {0}},
                             false,
                             {0},
                             false,
                             {0}}};
    struct rig in = {.n = 2, .views = v}, out;
    const char *path = tmpdir_path("cameras.json");
    assert_int_equal(cameras_write(path, &in), OK);
    assert_int_equal(cameras_read(path, &out), OK);
    assert_int_equal(out.n, 2);
    for (int i = 0; i < 2; i++) {
        assert_same_view(&out.views[i], &v[i]);
        out.views[i].photograph.lens.limit = 0; // follows from the rest
        assert_memory_equal(&out.views[i].photograph, &v[i].photograph, sizeof v[i].photograph);
    }
    cameras_use_photographs(&out);
    assert_true(out.views[1].cam.w == 31 && out.views[1].lens.term[1] == 1e-9);
    assert_true(out.views[0].cam.w == 640 && out.views[0].lens.model == LENS_OPENCV);
    cameras_free(&out);
}

/* By rows up to the diagonal, in lengths of the file; not without a depth, or where it is infinite.
 */
static void covariances_are_taken_over(void **state)
{
    struct rig_view v = {0};
    double c[COVARIANCE_POSE];
    (void)state;
    for (int i = 0; i < COVARIANCE_POSE; i++)
        c[i] = 1e-6 * (i / 6 == i % 6 ? 4 : i / 6 + i % 6);
    cameras_set_covariance(c, 10, 20, &v);
    assert_true(v.has_covariance && v.has_deviation);
    assert_float_equal(v.covariance[0], 4e-6, 1e-12);  // w0 w0
    assert_float_equal(v.covariance[4], 3e-6, 1e-12);  // w2 w1
    assert_float_equal(v.covariance[6], 3e-5, 1e-11);  // v0 w0
    assert_float_equal(v.covariance[20], 4e-4, 1e-10); // v2 v2
    assert_float_equal(v.deviation[0], sqrt(12e-6) * 180 / NUM_PI, 1e-6);
    assert_float_equal(v.deviation[1], sqrt(12e-6) * 10 / 20, 1e-8);
    cameras_set_covariance(c, 10, 0, &v);
    assert_false(v.has_covariance || v.has_deviation);
    c[35] = INFINITY;
    cameras_set_covariance(c, 10, 20, &v);
    assert_false(v.has_covariance || v.has_deviation);
}

static void the_unit_is_kept(void **state)
{
    struct rig_view v = {.name = "a.png", .cam = {1, 1, 1, 1, 0, 0, {1, 0, 0, 0}, {0, 0, 0}}};
    struct rig in = {.n = 1, .views = &v}, out;
    const char *path = tmpdir_path("unit.json");
    (void)state;
    for (int i = 0; i < 2; i++) {
        in.metres = i == 1;
        assert_int_equal(cameras_write(path, &in), OK);
        assert_int_equal(cameras_read(path, &out), OK);
        assert_true(out.metres == in.metres);
        cameras_free(&out);
    }
}

static void a_full_disk_is_noticed(void **state)
{
    (void)state;
    struct rig none = {0};
    assert_int_equal(cameras_write("/dev/full", &none), ERR_LIMIT);
    assert_non_null(strstr(err_text(), "No space"));
    assert_int_equal(cameras_write(tmpdir_path("no/such/folder"), &none), ERR_IO);
}

static void nonsense_is_refused_with_its_name(void **state)
{
    (void)state;
    static const struct {
        const char *text, *sentence;
        err_t code;
    } wrong[] = {
        {"", "not JSON", ERR_FORMAT},
        {"{\"cameras\":[]}", "0 cameras", ERR_FORMAT},
        {"[1]", "no array", ERR_FORMAT},
        {RIG("7"), "name", ERR_FORMAT},
        {RIG("{}"), "name", ERR_FORMAT},
        {RIG("{\"name\":\"../a\"}"), "slashes", ERR_FORMAT},
        {RIG("{\"name\":\"..\"}"), "folder", ERR_FORMAT},
        {RIG("{\"name\":\"a\",\"w\":8.5}"), "\"w\"", ERR_FORMAT},
        {RIG("{\"name\":\"a\",\"w\":8,\"h\":1e9}"), "\"h\"", ERR_FORMAT},
        {RIG(GOOD "," GOOD), "a.png is named twice", ERR_FORMAT},
        {RIG(GOOD) "x", "not JSON", ERR_FORMAT},
    };
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        struct rig rig;
        assert_int_equal(parse(wrong[i].text, &rig), wrong[i].code);
        assert_non_null(strstr(err_text(), wrong[i].sentence));
        assert_null(rig.views);
    }
}

/* GOOD with the first `from` replaced by `to`. */
static err_t parse_changed(const char *from, const char *to, struct rig *rig)
{
    char text[512];
    const char *good = RIG(GOOD), *at = strstr(good, from);
    assert_non_null(at);
    snprintf(text, sizeof text, "%.*s%s%s", (int)(at - good), good, to, at + strlen(from));
    return parse(text, rig);
}

static void numbers_are_checked(void **state)
{
    (void)state;
    static const char *const wrong[][2] = {{"\"fx\":5", "\"fx\":0"},
                                           {"\"fy\":5", "\"fy\":-1"},
                                           {"\"fx\":5", "\"fx\":1e99"},
                                           {"\"cx\":4", "\"cx\":\"4\""},
                                           {"\"fx\":5", "\"fx\":5,\"deviation\":[-1,0]"},
                                           {"\"fx\":5", "\"fx\":5,\"deviation\":[1]"},
                                           {"\"fx\":5", "\"fx\":5,\"covariance\":[1,0,1]"},
                                           {"\"fx\":5", "\"fx\":5,\"covariance\":[1,0,1,0,0,1,0,"
                                                        "0,0,1,0,0,0,0,1,0,0,0,0,0,-1]"},
                                           {"[1,0,0,0]", "[1,0,0]"},
                                           {"[1,0,0,0]", "[1.01,0,0,0]"},
                                           {"[1,0,0,0]", "[0,0,0,0]"},
                                           {"[1,0,0,0]", "[1,0,0,null]"},
                                           {"\"t\":[0,0,0]", "\"t\":0"},
                                           {"[0,0,0]}", "[0,1e400,0]}"},
                                           {"\"w\":8", "\"w\":0"},
                                           {"\"t\":", "\"exposure_log2\":[],\"t\":"}};
    struct rig rig;
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
        assert_int_equal(parse_changed(wrong[i][0], wrong[i][1], &rig), ERR_FORMAT);
    assert_int_equal(parse_changed("[1,0,0,0]", "[1.0005,0,0,0]", &rig), OK);
    assert_true(rig.views[0].cam.q[0] == 1); // normalised
    cameras_free(&rig);
}

static void lenses_are_checked(void **state)
{
    (void)state;
    static const char *const wrong[][2] = {
        {"\"model\":7,\"params\":[]", "\"model\"  is not known"},
        {"\"model\":\"FOV\",\"params\":[5,4,3,1]", "\"model\" FOV is not known"},
        {"\"model\":\"RADIAL\"", "\"params\" has 0 numbers, RADIAL has 5"},
        {"\"model\":\"RADIAL\",\"params\":[5,4,3,0,0,0,0,0,0,0]", "has 10 numbers, RADIAL has 5"},
        {"\"model\":\"RADIAL\",\"params\":[5,4,3,0,\"1\"]", "something other than numbers"},
        {"\"model\":\"RADIAL\",\"params\":[5,4,3,0,1e999]", "other than numbers"},
        {"\"model\":\"RADIAL\",\"params\":[-5,4,3,0,0.1]", "not positive"},
    };
    char text[200];
    struct rig rig;
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        snprintf(text, sizeof text, "\"w\":8,%s", wrong[i][0]);
        assert_int_equal(parse_changed("\"w\":8", text, &rig), ERR_FORMAT);
        if (!strstr(err_text(), wrong[i][1]))
            fail_msg("\"%s\" lacks \"%s\"", err_text(), wrong[i][1]);
    }
    const char *lens = "\"model\":\"RADIAL\",\"params\":[6,4,3,-0.2,0.01]";
    assert_int_equal(parse_changed("\"fx\":5,\"fy\":5,\"cx\":4,\"cy\":3", lens, &rig), OK);
    assert_true(rig.views[0].cam.fx == 6 && rig.views[0].cam.fy == 6);
    assert_true(rig.views[0].lens.model == LENS_RADIAL && rig.views[0].lens.term[0] == -0.2);
    struct rig_view v;
    assert_int_equal(find(&rig, "a.png", 16, 12, &v), OK);
    assert_true(v.lens.fx == 12 && v.lens.cy == 6 && v.lens.term[1] == 0.01);
    cameras_free(&rig);
}

static void every_cut_is_refused(void **state)
{
    (void)state;
    const char *good = RIG(GOOD);
    struct rig rig;
    for (size_t n = 0; n < strlen(good); n++) {
        assert_int_equal(cameras_parse("c", good, n, &rig), ERR_FORMAT);
        assert_null(rig.views);
    }
    assert_int_equal(cameras_parse("c", good, strlen(good), &rig), OK);
    cameras_free(&rig);
}

static void a_view_is_found_for_each_of_its_exposures(void **state)
{
    (void)state;
    struct rig_view v[3] = {
        {.name = "train_ldr_000_2.png", .cam = {8, 6, 5, 5, 4, 3, {1, 0, 0, 0}, {0}}},
        {.name = "train_ldr_001_2.png", .cam = {8, 6, 6, 6, 4, 3, {1, 0, 0, 0}, {0}}},
        {.name = "IMG_0001.jpg", .cam = {8, 6, 7, 7, 4, 3, {1, 0, 0, 0}, {0}}}};
    struct rig rig = {.n = 3, .views = v};
    struct rig_view c;
    assert_int_equal(find(&rig, "train_ldr_001_4.png", 8, 6, &c), OK);
    assert_true(c.cam.fx == 6);
    assert_int_equal(find(&rig, "IMG_0002.jpg", 8, 6, &c), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "IMG_0002.jpg"));
    assert_int_equal(find(&rig, "IMG_0001.jpg", 16, 12, &c), OK); // twice the size
    assert_true(c.cam.fx == 14 && c.cam.cy == 6 && c.cam.w == 16 && c.cam.h == 12);
    assert_int_equal(find(&rig, "IMG_0001.jpg", 16, 8, &c), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "aspect"));
    strcpy(v[1].name, "train_ldr_000_3.png"); // now two cameras claim view 000
    assert_int_equal(find(&rig, "train_ldr_000_3.png", 8, 6, &c), OK);
    assert_true(c.cam.fx == 6);
    assert_int_equal(find(&rig, "train_ldr_000_4.png", 8, 6, &c), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "differ"));
}

static void names_follow_one_rule(void **state)
{
    (void)state;
    static const char *const wrong[] = {
        "",         "a/b", "a\nb", "\xff", "\xc0\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80",
        "\xe2\x82", ".",   ".."};
    char out[NAME_CAP], longest[NAME_CAP + 1];
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
        assert_int_equal(name_copy("f", wrong[i], strlen(wrong[i]), out), ERR_FORMAT);
    memset(longest, 'x', sizeof longest);
    assert_int_equal(name_copy("f", longest, NAME_CAP, out), ERR_FORMAT);
    assert_int_equal(name_copy("f", longest, NAME_CAP - 1, out), OK);
    assert_int_equal(strlen(out), NAME_CAP - 1);
    assert_int_equal(name_copy("f", "\xe2\x82\xac .. \xf0\x9f\x93\xb7", 11, out), OK);
    assert_true(name_same_view("train_ldr_000_2.png", "train_ldr_000_10.jpg"));
    assert_false(name_same_view("train_ldr_000_2.png", "train_ldr_001_2.png"));
    assert_false(name_same_view("IMG_1.png", "IMG_2.png"));
    assert_int_equal(name_view("7_2"), 1);
    assert_int_equal(name_view("_2"), 2);
}

static void exposures_are_checked(void **state)
{
    (void)state;
    static const char *const wrong[] = {"{}",
                                        "[]",
                                        "{\"a\":0}",
                                        "{\"a\":-1}",
                                        "{\"a\":1e999}",
                                        "{\"a\":\"1\"}",
                                        "{\"\":1}",
                                        "{\"a\":1,\"b\":2,\"a\":1}",
                                        "{\"a/b\":1}",
                                        "{\"a\":1"};
    struct exposures x;
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        assert_int_not_equal(exposures_parse("e", wrong[i], strlen(wrong[i]), &x), OK);
        assert_null(x.v);
    }
    const char *good = " {\"b.png\": 0.125, \"a.png\": 32}\n";
    assert_int_equal(exposures_parse("e", good, strlen(good), &x), OK);
    assert_true(exposures_find(&x, "a.png") == 32 && exposures_find(&x, "b.png") == 0.125);
    assert_true(exposures_find(&x, "c.png") == 0);
    exposures_free(&x);
    assert_true(exposures_find(&x, "a.png") == 0);
}

static void in_camera(const struct camera *cam, const double world[3], double out[3])
{
    double r[9];
    rotation_of_camera(cam, r);
    for (int i = 0; i < 3; i++)
        out[i] = lin_dot(r + 3 * i, world) + (double)cam->t[i];
}

/* A point projects to the same place of the picture before and after both are turned. */
static void a_camera_is_turned_with_its_picture(void **state)
{
    (void)state;
    static const int orientation[4] = {1, 6, 3, 8};
    struct rig_view v = {.name = "a.jpg",
                         .cam = {80, 60, 50, 55, 41, 28, {0.5f, 0.1f, -0.7f, 0.5f}, {1, 2, 9}},
                         .lens = {LENS_OPENCV, 50, 55, 41, 28, {-0.1, 0.02, 0.01, -0.02}, 0}};
    assert_int_equal(lens_init(&v.lens), OK);
    struct rig rig = {.n = 1, .views = &v, .stored = true};
    for (int i = 0; i < 4; i++) {
        const bool lies = i % 2;
        const struct cameras_picture p = {"a.jpg", lies ? 60 : 80, lies ? 80 : 60, orientation[i]};
        struct rig_view out;
        assert_int_equal(cameras_find("r", &rig, &p, &out), OK);
        assert_true(out.cam.w == p.w && out.cam.h == p.h);
        for (int k = 0; k < 20; k++) {
            const double world[3] = {k % 5 - 2, k / 5 - 2, 3 + k % 3};
            double a[3], b[3], x[2], y[2];
            in_camera(&v.cam, world, a);
            in_camera(&out.cam, world, b);
            assert_true(lens_project(&v.lens, a, x) && lens_project(&out.lens, b, y));
            const double want[4][2] = {
                {x[0], x[1]}, {60 - x[1], x[0]}, {80 - x[0], 60 - x[1]}, {x[1], 80 - x[0]}};
            assert_true(fabs(y[0] - want[i][0]) < 1e-4 && fabs(y[1] - want[i][1]) < 1e-4);
            assert_true(fabsf(out.cam.cx - (float)out.lens.cx) < 1e-4f);
            assert_true(fabsf(out.cam.fy - (float)out.lens.fy) < 1e-4f);
        }
    }
    struct rig_view out;
    const struct cameras_picture mirrored = {"a.jpg", 60, 80, 5}, half = {"a.jpg", 30, 40, 6};
    assert_int_equal(cameras_find("r", &rig, &mirrored, &out), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "orientation 5 mirrors image a.jpg"));
    assert_int_equal(cameras_find("r", &rig, &half, &out), OK); // scaled, then turned
    assert_true(out.cam.w == 30 && out.cam.cx == 16 && out.cam.fx == 27.5f && out.lens.cy == 20.5);
}

/* Which picture a camera is of: by its size; where both sizes fit, by the kind of its file. */
static void the_size_tells_which_picture_a_camera_is_of(void **state)
{
    (void)state;
    struct rig_view v = {.name = "a.jpg", .cam = {80, 60, 50, 55, 41, 28, {1, 0, 0, 0}, {0}}}, out;
    struct rig rig = {.n = 1, .views = &v};
    struct cameras_picture p = {"a.jpg", 60, 80, 6};
    assert_int_equal(cameras_find("r", &rig, &p, &out), OK); // only the stored one has this aspect
    assert_true(out.cam.cx == 32 && out.cam.cy == 41);
    p = (struct cameras_picture){"a.jpg", 80, 60, 6}; // stored 60 x 80
    for (int k = 0; k < 2; k++) {
        rig.stored = k;
        assert_int_equal(cameras_find("r", &rig, &p, &out), OK);
        assert_true(out.cam.cx == 41);
    }
    p.orientation = 3;
    assert_int_equal(cameras_find("r", &rig, &p, &out), OK);
    assert_true(out.cam.cx == 39 && out.cam.cy == 32);
    rig.stored = false;
    assert_int_equal(cameras_find("r", &rig, &p, &out), OK);
    assert_true(out.cam.cx == 41);
    p.orientation = 2; // mirrors, but the camera is that of the upright picture
    assert_int_equal(cameras_find("r", &rig, &p, &out), OK);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_written_is_read_bit_for_bit),
        cmocka_unit_test(covariances_are_taken_over),
        cmocka_unit_test(the_unit_is_kept),
        cmocka_unit_test(a_full_disk_is_noticed),
        cmocka_unit_test(nonsense_is_refused_with_its_name),
        cmocka_unit_test(numbers_are_checked),
        cmocka_unit_test(lenses_are_checked),
        cmocka_unit_test(every_cut_is_refused),
        cmocka_unit_test(a_view_is_found_for_each_of_its_exposures),
        cmocka_unit_test(a_camera_is_turned_with_its_picture),
        cmocka_unit_test(the_size_tells_which_picture_a_camera_is_of),
        cmocka_unit_test(names_follow_one_rule),
        cmocka_unit_test(exposures_are_checked),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failed;
}
