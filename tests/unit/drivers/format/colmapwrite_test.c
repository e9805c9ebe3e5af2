/* Cameras of all five models and a pinhole, written and read back by every format. */
#include "drivers/format/colmapwrite.h"
#include "drivers/format/file.h"
#include "drivers/format/rigfile.h"
#include "drivers/format/transforms.h"

#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { VIEWS = 7 };

static void make_rig(struct rig_view v[VIEWS])
{
    static const enum lens_model model[VIEWS] = {LENS_PINHOLE, LENS_SIMPLE_RADIAL,  LENS_RADIAL,
                                                 LENS_OPENCV,  LENS_OPENCV_FISHEYE, LENS_PINHOLE,
                                                 LENS_OPENCV};
    memset(v, 0, VIEWS * sizeof *v);
    for (int i = 0; i < VIEWS; i++) {
        const bool one = model[i] == LENS_SIMPLE_RADIAL || model[i] == LENS_RADIAL;
        const double turn = 0.3 + i, away = 0.2 * i;
        struct lens l = {.model = model[i], .fx = 500.123456789, .cx = 321.1, .cy = 239.7};
        l.fy = one ? l.fx : 503.987654321;
        for (int k = 0; k < lens_count(model[i]) - (one ? 3 : 4); k++)
            l.term[k] = -0.0123456789012345 / (k + 1);
        snprintf(v[i].name, NAME_CAP, "photo %d.png", i);
        v[i].cam = (struct camera){.w = 640, .h = 480, .t = {1.1f, -2.2f, 3.3f * (float)i}};
        v[i].cam.q[0] = (float)(cos(turn) * cos(away));
        v[i].cam.q[1] = (float)(sin(turn) * cos(away));
        v[i].cam.q[2] = (float)(sin(away) * 0.6);
        v[i].cam.q[3] = (float)(sin(away) * 0.8);
        assert_int_equal(cameras_set_lens("r", v[i].name, &l, &v[i]), OK);
        assert_int_equal(cameras_check("r", v[i].name, &v[i].cam), OK);
    }
}

/* Within 1e-6; a quaternion and its negative are the same rotation. */
static void expect_same(const struct rig_view *a, const struct rig_view *b)
{
    assert_string_equal(a->name, b->name);
    assert_true(a->cam.w == b->cam.w && a->cam.h == b->cam.h);
    assert_int_equal(a->lens.model, b->lens.model);
    const float sign = a->cam.q[0] * b->cam.q[0] < 0 ? -1 : 1;
    for (int k = 0; k < 4; k++)
        assert_true(fabsf(a->cam.q[k] - sign * b->cam.q[k]) < 1e-6f);
    for (int k = 0; k < 3; k++)
        assert_true(fabsf(a->cam.t[k] - b->cam.t[k]) < 1e-6f * 20);
    assert_true(a->cam.fx == b->cam.fx && a->cam.fy == b->cam.fy && a->cam.cx == b->cam.cx &&
                a->cam.cy == b->cam.cy);
    assert_memory_equal(a->lens.term, b->lens.term, sizeof a->lens.term);
    assert_true(a->lens.fx == b->lens.fx && a->lens.cy == b->lens.cy);
}

static void expect_rig(const struct rig_view *v, int n, const char *path)
{
    struct rig out;
    if (rigfile_read(path, &out) != OK)
        fail_msg("%s", err_text());
    assert_int_equal(out.n, n);
    for (int i = 0; i < n; i++)
        expect_same(&v[i], &out.views[i]);
    cameras_free(&out);
}

static void lenses_and_poses_survive_colmap(void **state)
{
    (void)state;
    struct rig_view v[VIEWS];
    struct colmap_point p[2] = {{{1, 2, 3.5f}, {0, 128, 255}}, {{-1e-3f, 0, 7}, {9, 8, 7}}};
    struct colmap_points points = {2, p}, back;
    make_rig(v);
    const struct rig rig = {.n = VIEWS, .views = v};
    for (int binary = 0; binary < 2; binary++) {
        const char *dir = tmpdir_mkdir(binary ? "bin" : "txt");
        assert_int_equal(colmapwrite_run(dir, binary, &rig, &points), OK);
        expect_rig(v, VIEWS, dir);
        assert_int_equal(colmap_read_points(dir, &back), OK);
        assert_int_equal(back.n, 2);
        assert_memory_equal(back.p, p, sizeof p);
        colmap_free_points(&back);
    }
    assert_int_equal(colmapwrite_run(tmpdir_path("gone"), true, &rig, NULL), ERR_IO);
}

/* The last two views have lenses of views before them. */
static void images_of_one_camera_share_it(void **state)
{
    (void)state;
    struct rig_view v[VIEWS];
    struct file_map m;
    make_rig(v);
    const struct rig rig = {.n = VIEWS, .views = v};
    const char *dir = tmpdir_mkdir("shared");
    assert_int_equal(colmapwrite_run(dir, true, &rig, NULL), OK);
    assert_int_equal(file_map(tmpdir_path("shared/cameras.bin"), 4096, &m), OK);
    assert_int_equal(m.p[0], 5);
    file_unmap(&m);
    expect_rig(v, VIEWS, dir);
}

static void lenses_and_poses_survive_transforms(void **state)
{
    (void)state;
    struct rig_view v[VIEWS];
    make_rig(v);
    v[0].has_exposure = v[2].has_exposure = true;
    v[0].exposure_log2 = -3.25f;
    const char *path = tmpdir_path("transforms.json");
    for (int i = 0; i < VIEWS; i++) { // a file has one model
        const struct rig rig = {.n = 1, .views = &v[i]};
        assert_int_equal(transforms_write(path, &rig, NULL), OK);
        expect_rig(&v[i], 1, path);
    }
    const struct rig first = {.n = 2, .views = v}, mixed = {.n = 5, .views = v};
    struct rig out;
    assert_int_equal(transforms_write(path, &first, "points.ply"), OK);
    assert_int_equal(transforms_read(path, &out), OK);
    assert_true(out.stored && out.views[0].has_exposure && !out.views[1].has_exposure);
    assert_true(fabsf(out.views[0].exposure_log2 + 3.25f) < 1e-6f);
    cameras_free(&out);
    assert_int_equal(transforms_write(path, &mixed, NULL), ERR_ARG);
    assert_non_null(strstr(err_text(), "different kinds"));
}

static void cameras_json_keeps_lenses(void **state)
{
    (void)state;
    struct rig_view v[VIEWS];
    make_rig(v);
    const struct rig rig = {.n = VIEWS, .views = v};
    assert_int_equal(cameras_write(tmpdir_path("cameras.json"), &rig), OK);
    expect_rig(v, VIEWS, tmpdir_path("cameras.json"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lenses_and_poses_survive_colmap),
        cmocka_unit_test(images_of_one_camera_share_it),
        cmocka_unit_test(lenses_and_poses_survive_transforms),
        cmocka_unit_test(cameras_json_keeps_lenses),
    };
    tmpdir_make();
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    tmpdir_remove();
    return failed;
}
