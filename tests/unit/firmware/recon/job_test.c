/* Planning of a job: what is refused before the work, and how the memory grows. The work itself is
 * tested end to end. */
#include "drivers/format/json.h"
#include "firmware/recon/job.h"
#include "tests/unit/small_job.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static struct shot shots[600];

static struct capture capture(int n, int side)
{
    for (int i = 0; i < n; i++) {
        shots[i] = (struct shot){.image = {side, side, 3, NULL}, .exposure = 1, .has_camera = true};
        snprintf(shots[i].name, NAME_CAP, "view%d.png", i);
    }
    return (struct capture){n, shots};
}

static struct job_config config(int size, int splats)
{
    return (struct job_config){.size = size,
                               .refine = {.steps = 10, .degree_max = 1, .gaussians_max = splats}};
}

static void refusals(void **state)
{
    (void)state;
    struct job_memory m;
    struct job_config cfg = config(56, 1000);
    struct capture c = capture(1, 100);
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "1 view"));
    c = capture(0, 100);
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    c = capture(2, 100); // two exposures of one place
    shots[1].again = true;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "1 view"));
    c = capture(3, 100);
    shots[1].has_camera = false;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "view1.png"));
    assert_non_null(strstr(err_text(), "--rig"));
}

/* Cameras are found for as many views as bundle adjustment takes, if they are not too small. */
static void what_cameras_cannot_be_found_for(void **state)
{
    (void)state;
    struct job_memory m;
    struct job_config cfg = config(70, 1000);
    struct capture c = capture(600, 100);
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), OK);
    for (int i = 0; i < 600; i++)
        shots[i].has_camera = false;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "600 views, cameras can be found for at most 512"));
    assert_non_null(strstr(err_text(), "--rig"));
    c.n = 513;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    c.n = 512;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), OK);
    cfg.size = 56;
    assert_int_equal(job_plan(&c, &cfg, 1, false, NULL, &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "views of 56 px are too small"));
    assert_non_null(strstr(err_text(), "--size 64"));
}

static size_t total(int n, int side, struct job_config cfg, int threads)
{
    struct job_memory m;
    struct capture c = capture(n, side);
    assert_int_equal(job_plan(&c, &cfg, threads, false, NULL, &m), OK);
    return arena_add(m.pictures, arena_add(m.keep, m.tmp));
}

static void memory_grows_with_the_work(void **state)
{
    (void)state;
    struct job_memory m;
    struct capture c = capture(4, 1000);
    struct job_config cfg = config(112, 20000);
    assert_int_equal(job_plan(&c, &cfg, 2, false, NULL, &m), OK);
    assert_true(m.pictures >= 4u * 3000000 && m.pictures < 4u * 3000000 + 10000);
    size_t base = total(4, 1000, cfg, 2);
    assert_true(base > 10e6 && base < 200e6);
    assert_true(total(8, 1000, cfg, 2) > base);
    assert_true(total(4, 2000, cfg, 2) > base);
    assert_true(total(4, 1000, config(224, 20000), 2) > base);
    assert_true(total(4, 1000, config(112, 40000), 2) > base);
    assert_true(total(4, 1000, cfg, 8) > base);
}

/* Brackets cost what their pixels take, not what places cost. */
static void exposures_are_cheaper_than_places(void **state)
{
    (void)state;
    struct job_memory m;
    struct job_config cfg = config(112, 20000);
    struct capture c = capture(12, 200);
    size_t few = total(4, 200, cfg, 2), many = total(12, 200, cfg, 2), photo = 112 * 112 * 3;
    for (int i = 0; i < 12; i++)
        shots[i].again = i % 3 > 0;
    assert_int_equal(job_plan(&c, &cfg, 2, false, NULL, &m), OK);
    size_t brackets = arena_add(m.pictures, arena_add(m.keep, m.tmp));
    assert_true(brackets > few + 8 * (200 * 200 * 3 + photo));
    assert_true(brackets < few + 8 * (200 * 200 * 3 + 4 * photo) && brackets < many);
}

/* Pixels that are read when they are needed are few at a time. */
static void pixels_read_later_take_less(void **state)
{
    (void)state;
    const struct prep_source from = {.ctx = NULL};
    struct job_memory all, two;
    struct job_config cfg = config(112, 20000);
    struct capture c = capture(6, 1000);
    assert_int_equal(job_plan(&c, &cfg, 2, false, NULL, &all), OK);
    cfg.source = &from;
    assert_int_equal(job_plan(&c, &cfg, 2, false, NULL, &two), OK);
    assert_true(two.pictures >= 2 * 3000000 && 3 * two.pictures == all.pictures);
    assert_true(two.keep == all.keep && two.tmp == all.tmp);
    assert_int_equal(job_plan(&c, &cfg, 7, false, NULL, &two), OK);
    assert_int_equal(two.pictures, all.pictures);
}

/* There are never more splats than pixels, whatever the settings allow. */
static void room_for_no_more_splats_than_pixels(void **state)
{
    (void)state;
    size_t all = total(2, 100, config(56, 2 * 56 * 56), 1);
    assert_int_equal(total(2, 100, config(56, 4000000), 1), all);
}

static void warnings_are_bounded(void **state)
{
    (void)state;
    static struct job_result j;
    for (int i = 0; i < JOB_WARNINGS + 3; i++)
        job_result_warn(&j, "%0600d", i);
    assert_int_equal(j.n_warnings, JOB_WARNINGS);
    assert_int_equal(strlen(j.warnings[0]), sizeof j.warnings[0] - 1);
}

/* Names that scripts rely on. */
static void report_has_every_member(void **state)
{
    (void)state;
    static const char *const members[] = {"views",       "size",      "precision",    "threads",
                                          "gaussians",   "sh_degree", "refine_steps", "seconds",
                                          "peak_rss_mb", "quality",   "modelled",     "warnings"};
    static const char *const stages[] = {"preprocess", "response", "sweep", "seed",
                                         "refine",     "render",   "write", "total"};
    static struct small_job job;
    char *text;
    size_t size;
    struct cJSON *doc;
    struct report rep;
    small_job_init(&job, 16);
    job.result.input_psnr = NAN;
    for (int i = 0; i <= JOB_WRITE; i++)
        job.result.seconds[i] = 1;
    job_result_warn(&job.result, "one \"warning\"");
    FILE *f = open_memstream(&text, &size);
    report_begin(&rep, f);
    job_report(&job.result, 3, &rep);
    report_close(&rep);
    fclose(f);
    assert_int_equal(json_parse("report", text, size, &doc), OK);
    for (size_t i = 0; i < sizeof members / sizeof members[0]; i++)
        assert_non_null(json_member(doc, members[i]));
    for (size_t i = 0; i < sizeof stages / sizeof stages[0]; i++)
        assert_non_null(json_member(json_member(doc, "seconds"), stages[i]));
    assert_null(json_member(json_member(doc, "seconds"), "measure")); // it did not run
    assert_string_equal(json_string(json_first(json_member(doc, "warnings"))), "one \"warning\"");
    json_free(doc);
    free(text);
    small_job_free(&job);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(refusals),
        cmocka_unit_test(what_cameras_cannot_be_found_for),
        cmocka_unit_test(memory_grows_with_the_work),
        cmocka_unit_test(exposures_are_cheaper_than_places),
        cmocka_unit_test(pixels_read_later_take_less),
        cmocka_unit_test(room_for_no_more_splats_than_pixels),
        cmocka_unit_test(warnings_are_bounded),
        cmocka_unit_test(report_has_every_member),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
