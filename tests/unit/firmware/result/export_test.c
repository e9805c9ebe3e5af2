#include "firmware/result/export.h"

#include "core/base/gaussians.h"
#include "core/splat/display.h"
#include "drivers/format/img.h"
#include "tests/unit/tmpdir.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

enum { MANY = EXPORT_POINTS_MAX + EXPORT_POINTS_MAX / 2 };

static struct arena arena;
static struct scene scene;

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    scene = (struct scene){0};
    display_tonemap(0, &scene.tone);
    if (arena_init(&arena, "keep", gaussians_need(MANY, 0) + 4096) != OK)
        return -1;
    return gaussians_init(&scene.g, &arena, MANY, 0) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&arena);
    tmpdir_remove();
    return 0;
}

static void put_splat(int i, float x, float logit, float radiance)
{
    for (int c = 0; c < 3; c++) {
        scene.g.plane[G_MU + c][i] = x + (float)c;
        scene.g.plane[G_SH + c][i] = logf(radiance) / (float)SH_BASIS0 - (c == 2 ? 100.0f : 0.0f);
    }
    scene.g.plane[G_LOGIT][i] = logit;
}

static void points_are_opaque_splats(void **state)
{
    (void)state;
    struct colmap_points points;
    put_splat(0, 1, 2, 1);
    put_splat(1, 2, -1, 1); // more transparent than not
    put_splat(2, 3, 0.5f, 0.2140f);
    scene.g.n = 3;
    assert_int_equal(export_points(&scene, &points), OK);
    assert_int_equal(points.n, 2);
    assert_true(points.p[0].xyz[0] == 1 && points.p[1].xyz[2] == 5);
    const float ev = display_ev(&scene.tone), shown = display_encode(exp2f(ev) * 0.2140f);
    assert_true(abs(points.p[1].rgb[0] - (int)lrintf(255 * fminf(shown, 1))) <= 1);
    assert_true(points.p[0].rgb[0] > points.p[1].rgb[0] && points.p[1].rgb[2] <= 1);
    colmap_free_points(&points);
    scene.g.n = 0;
    assert_int_equal(export_points(&scene, &points), OK);
    assert_int_equal(points.n, 0);
    colmap_free_points(&points);
}

static void many_points_are_thinned_evenly(void **state)
{
    (void)state;
    struct colmap_points points;
    for (int i = 0; i < MANY; i++)
        put_splat(i, (float)i, 1, 1);
    scene.g.n = MANY;
    assert_int_equal(export_points(&scene, &points), OK);
    assert_int_equal(points.n, EXPORT_POINTS_MAX);
    for (int k = 1; k < points.n; k++) {
        const float step = points.p[k].xyz[0] - points.p[k - 1].xyz[0];
        assert_true(step == 1 || step == 2);
    }
    assert_true(points.p[points.n - 1].xyz[0] >= MANY - 2);
    colmap_free_points(&points);
}

/* Two photographs that would get one name. */
static void names_must_differ(void **state)
{
    (void)state;
    static uint8_t px[8 * 6 * 3];
    const struct image8 im = {8, 6, 3, px};
    struct shot shots[2] = {{.name = "a.png", .taken_w = 8, .taken_h = 6, .has_camera = true},
                            {.name = "a.jpg", .taken_w = 8, .taken_h = 6, .has_camera = true}};
    struct imageset set = {.capture = {2, shots}};
    const struct export_request rq = {.set = &set, .scene = &scene};
    const struct run run = {0};
    struct export_result result;
    struct outdir out;
    snprintf(set.dir, sizeof set.dir, "%s", tmpdir_root);
    assert_int_equal(img_write_png(tmpdir_path("a.png"), &im), OK);
    scene.g.n = 0;
    for (int i = 0; i < 2; i++)
        shots[i].cam = (struct camera){8, 6, 5, 5, 4, 3, {1, 0, 0, 0}, {0}};
    assert_int_equal(outdir_open(tmpdir_path("out"), NULL, &out), OK);
    assert_int_equal(export_run(&run, &rq, &out, &result), ERR_ARG);
    assert_non_null(strstr(err_text(), "a.png and a.jpg would both be written as a.png"));
    set.capture.n = 1;
    assert_int_equal(export_run(&run, &rq, &out, &result), OK);
    assert_true(result.n_images == 1 && result.n_points == 0);
    assert_int_equal(outdir_commit(&out), OK);
    assert_true(file_is_regular(tmpdir_path("out/images/a.png")));
    assert_false(file_exists(tmpdir_path("out/exposure.json"))); // it is not known
    outdir_close(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(points_are_opaque_splats, setup, teardown),
        cmocka_unit_test_setup_teardown(many_points_are_thinned_evenly, setup, teardown),
        cmocka_unit_test_setup_teardown(names_must_differ, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
