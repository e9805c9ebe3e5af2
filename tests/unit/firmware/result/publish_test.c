#include "drivers/format/cameras.h"
#include "drivers/format/exrfile.h"
#include "drivers/format/img.h"
#include "drivers/format/json.h"
#include "drivers/format/ply.h"
#include "drivers/format/scenefile.h"
#include "drivers/format/sidecar.h"
#include "firmware/result/publish.h"
#include "tests/unit/small_job.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/resource.h>

#include <cmocka.h>

enum { SPLATS = 300 };

static struct small_job job;
static struct outdir out;

static int setup(void **state)
{
    (void)state;
    tmpdir_make();
    small_job_init(&job, SPLATS);
    return outdir_open(tmpdir_path("out"), NULL, &out) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    outdir_close(&out);
    small_job_free(&job);
    tmpdir_remove();
    return 0;
}

static void everything_is_there_and_can_be_read(void **state)
{
    (void)state;
    struct cJSON *doc;
    struct scenefile_info scene;
    struct splats_info ply;
    struct sidecar_info side;
    struct rig rig;
    struct image8 ldr;
    struct image hdr;
    double v;
    assert_int_equal(publish_run(&job.run, &job.result, &out), OK);
    assert_int_equal(scenefile_peek(tmpdir_path("out/scene.hdrig"), &scene), OK);
    assert_int_equal(scene.n, SPLATS);
    assert_int_equal(splats_peek(&ply_format, tmpdir_path("out/scene.ply"), &ply), OK);
    assert_int_equal(ply.n, SPLATS);
    assert_int_equal(sidecar_peek(tmpdir_path("out/scene.ply"), &side), OK);
    assert_int_equal(side.n_views, SMALL_VIEWS);
    assert_int_equal(cameras_read(tmpdir_path("out/cameras.json"), &rig), OK);
    assert_int_equal(rig.n, SMALL_VIEWS);
    assert_true(rig.views[1].has_exposure && rig.views[1].exposure_log2 == 1.0f);
    cameras_free(&rig);
    assert_int_equal(img_read(tmpdir_path("out/ldr/b.png"), &ldr), OK);
    assert_int_equal(ldr.w, SMALL_SIZE);
    img_free(&ldr);
    assert_int_equal(exrfile_read(tmpdir_path("out/hdr/a.exr"), &hdr), OK);
    exrfile_free(&hdr);
    assert_int_equal(json_read(tmpdir_path("out/tone.json"), &doc), OK);
    json_free(doc);
    assert_true(file_is_regular(tmpdir_path("out/view.html")));
    assert_int_equal(json_read(tmpdir_path("out/report.json"), &doc), OK);
    assert_true(json_number(json_member(doc, "gaussians"), &v) && (int)v == SPLATS);
    assert_int_equal(json_count(json_member(doc, "warnings")), 0);
    assert_string_equal(json_string(json_member(doc, "viewer")), "view.html");
    assert_true(json_number(json_member(json_member(doc, "seconds"), "total"), &v));
    assert_true(json_number(json_member(json_member(doc, "quality"), "ldr_input_psnr"), &v));
    assert_true(v > 5 && v < 60);
    json_free(doc);
}

/* The same splat in 8 bits and as radiance: the tone curve of the scene joins them. */
static void pictures_show_the_scene(void **state)
{
    (void)state;
    struct image8 dark, bright;
    assert_int_equal(publish_run(&job.run, &job.result, &out), OK);
    assert_int_equal(img_read(tmpdir_path("out/ldr/a.png"), &dark), OK);
    assert_int_equal(img_read(tmpdir_path("out/ldr/b.png"), &bright), OK);
    int middle = 3 * (SMALL_SIZE / 2 * SMALL_SIZE + SMALL_SIZE / 2);
    assert_true(bright.px[middle] > dark.px[middle] + 50); // two stops more
    img_free(&dark);
    img_free(&bright);
}

/* Before the work: of a capture and what is to become of it. */
static err_t check(const char *second, int size)
{
    struct shot shots[3] = {{.name = "a.b.png"}, {.name = "a.png"}};
    const struct capture c = {3, shots};
    const struct job_config cfg = {.size = size,
                                   .refine = {.gaussians_max = 300000, .degree_max = 2}};
    snprintf(shots[2].name, NAME_CAP, "%s", second);
    return publish_check(&c, &cfg, &out);
}

static void names_that_would_collide_are_refused(void **state)
{
    (void)state;
    assert_int_equal(check("a.jpg", 56), ERR_ARG);
    assert_non_null(strstr(err_text(), "a.png and a.jpg would both be written as ldr/a.png"));
    assert_int_equal(check("b.jpg", 56), OK);
    assert_int_equal(check("a.b.c.jpg", 56), OK);
}

/* What is asked for before the work is never less than what is asked for after it. */
static void room_is_asked_for_before_the_work(void **state)
{
    (void)state;
    assert_int_equal(check("b.jpg", 448), OK);
    const uint64_t larger = out.need;
    assert_int_equal(check("b.jpg", 112), OK);
    assert_true(larger > 300000 * 56 && out.need < larger); // 300000 splats, each in the .ply
    struct shot shots[SMALL_VIEWS] = {{.name = "a.png"}, {.name = "b.png"}};
    const struct capture c = {SMALL_VIEWS, shots};
    const struct job_config cfg = {
        .size = SMALL_SIZE,
        .refine = {.gaussians_max = SPLATS, .degree_max = job.result.scene.g.degree}};
    assert_int_equal(publish_check(&c, &cfg, &out), OK);
    const uint64_t before = out.need;
    assert_int_equal(publish_run(&job.run, &job.result, &out), OK);
    assert_true(before >= out.need);
}

static void highlights_beyond_half_are_told(void **state)
{
    (void)state;
    struct cJSON *doc;
    for (int i = 0; i < SPLATS; i++)
        job.result.scene.g.plane[G_SH][i] = 60; // e^(60 * 0.282) is 2e7
    assert_int_equal(publish_run(&job.run, &job.result, &out), OK);
    assert_int_equal(json_read(tmpdir_path("out/report.json"), &doc), OK);
    assert_int_equal(json_count(json_member(doc, "warnings")), 1);
    json_free(doc);
}

static void cancelled(void **state)
{
    (void)state;
    atomic_store(&job.cancel, true);
    assert_int_equal(publish_run(&job.run, &job.result, &out), ERR_CANCELLED);
    outdir_close(&out);
    assert_false(file_is_dir(tmpdir_path("out")));
}

/* Files may not grow beyond a limit: the same path as a full disk. */
static void full_disk(void **state)
{
    (void)state;
    struct rlimit was, small = {.rlim_cur = 1000};
    getrlimit(RLIMIT_FSIZE, &was);
    small.rlim_max = was.rlim_max;
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &small);
    err_t e = publish_run(&job.run, &job.result, &out);
    setrlimit(RLIMIT_FSIZE, &was);
    assert_int_equal(e, ERR_LIMIT);
    assert_non_null(strstr(err_text(), "there is room for 1000)"));
    outdir_close(&out);
    assert_false(file_is_dir(tmpdir_path("out")));
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, setup, teardown)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(everything_is_there_and_can_be_read),
        TEST(pictures_show_the_scene),
        TEST(names_that_would_collide_are_refused),
        TEST(room_is_asked_for_before_the_work),
        TEST(highlights_beyond_half_are_told),
        TEST(cancelled),
        TEST(full_disk),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
