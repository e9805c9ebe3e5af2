/* What the list of takes tells about their scenes. */
#include "firmware/daemon/summary.h"
#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(warnings_of_a_scene, tmpdir_setup, tmpdir_teardown)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
