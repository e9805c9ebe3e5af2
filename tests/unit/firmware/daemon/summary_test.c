/* What the list of takes tells about their scenes. */
#include "firmware/daemon/summary.h"
#include "tests/unit/expect.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

static void warnings_of_a_scene(void **state)
{
    (void)state;
    char results[64];
    struct summary s = {.id = "0123abcd-000001"};
    snprintf(results, sizeof results, "%s", tmpdir_root);
    assert_int_equal(summary_warnings(results, &s), -1);
    tmpdir_mkdir("0123abcd-000001");
    assert_int_equal(summary_warnings(results, &s), -1);
    tmpdir_text("0123abcd-000001/report.json", "{\"warnings\": [\"a\", \"b\"]}");
    assert_int_equal(summary_warnings(results, &s), 2);
    assert_int_equal(summary_warnings(results, &s), 2);
    s.report_ns = 0; // a scene that was made anew
    tmpdir_text("0123abcd-000001/report.json", "{\"warnings\": []}");
    assert_int_equal(summary_warnings(results, &s), 0);
    s.report_ns = 0;
    tmpdir_text("0123abcd-000001/report.json", "[");
    assert_int_equal(summary_warnings(results, &s), -1);
}

/* The manifest of a take with that many cameras and exposures, without what is not read. */
static void read_take(int cameras, int exposures, struct summary *s)
{
    char *text, store[64];
    size_t n;
    FILE *f = open_memstream(&text, &n);
    assert_non_null(f);
    fputs("{\"status\": \"complete\", \"cameras\": [", f);
    for (int i = 0; i < cameras; i++)
        fprintf(f, "%s{}", i ? ", " : "");
    fputs("], \"frames\": [", f);
    for (int i = 0; i < cameras * exposures; i++)
        fprintf(f, "%s{}", i ? ", " : "");
    fputs("], \"files\": [{\"name\": \"exposure.json\"}, {\"name\": 5}", f);
    for (int i = 0; i < cameras * exposures; i++)
        fprintf(f, ", {\"name\": \"images/train_%02d_%02d.jpg\"}, {\"name\": \"raw/%d\"}",
                i / exposures, i % exposures, i);
    fputs("]}", f);
    assert_int_equal(fclose(f), 0);
    tmpdir_text("0123abcd-000001/manifest.json", text);
    free(text);
    snprintf(store, sizeof store, "%s", tmpdir_root);
    expect_ok(summary_read(store, "0123abcd-000001", s));
    assert_int_equal(s->cameras, cameras);
}

/* The exposures of one camera; one picture of each of many. */
static void pictures(void **state)
{
    (void)state;
    struct summary s;
    tmpdir_mkdir("0123abcd-000001");
    read_take(1, 5, &s);
    assert_int_equal(s.n_images, SUMMARY_EXPOSURES);
    assert_string_equal(s.image[2], "train_00_02.jpg");
    read_take(2, 3, &s);
    assert_int_equal(s.n_images, 2);
    assert_string_equal(s.image[1], "train_01_01.jpg");
    read_take(128, 9, &s);
    assert_int_equal(s.n_images, 128);
    assert_string_equal(s.image[127], "train_127_04.jpg");
    read_take(140, 1, &s);
    assert_int_equal(s.n_images, SUMMARY_IMAGES);
    read_take(0, 1, &s);
    assert_int_equal(s.n_images, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(warnings_of_a_scene, tmpdir_setup, tmpdir_teardown),
        cmocka_unit_test_setup_teardown(pictures, tmpdir_setup, tmpdir_teardown)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
