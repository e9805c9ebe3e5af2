/* The JSON that report.c prints: read back, and compared as text where the layout matters. */
#include "drivers/format/json.h"
#include "firmware/result/report.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

static char *text;
static size_t size;
static struct report rep;
static FILE *file;

static void begin(void)
{
    file = open_memstream(&text, &size);
    report_init(&rep, file);
}

static void end(void)
{
    fclose(file);
}

static void layout(void **state)
{
    (void)state;
    begin();
    report_open(&rep, NULL, '{');
    report_int(&rep, "a", -3);
    report_open(&rep, "b", '[');
    report_number(&rep, NULL, 0.5);
    report_bool(&rep, NULL, true);
    report_close(&rep);
    report_open(&rep, "c", '{');
    report_close(&rep);
    report_text(&rep, "d", NULL);
    report_row(&rep, "e", (const double[]){1, -0.25, NAN}, 3);
    report_row(&rep, "f", NULL, 0);
    report_close(&rep);
    end();
    assert_string_equal(
        text,
        "{\n  \"a\": -3,\n  \"b\": [\n    0.5,\n    true\n  ],\n  \"c\": {},\n  \"d\": null,\n"
        "  \"e\": [1, -0.25, null],\n  \"f\": []\n}\n");
    free(text);
}

static void hostile_values_stay_json(void **state)
{
    (void)state;
    struct cJSON *doc;
    double v;
    begin();
    report_open(&rep, NULL, '{');
    report_number(&rep, "nan", NAN);
    report_number(&rep, "inf", -INFINITY);
    report_number(&rep, "tiny", 1e-300);
    report_int(&rep, "big", INT64_MAX);
    report_text(&rep, "bytes", "a\xff\xc3\xa4\xed\xa0\x80\xc3"); // broken, whole, a surrogate
    report_text(&rep, "text", "quote \" backslash \\ newline \n");
    report_close(&rep);
    end();
    assert_int_equal(json_parse("report", text, size, &doc), OK);
    assert_false(json_number(json_member(doc, "nan"), &v));
    assert_false(json_number(json_member(doc, "inf"), &v));
    assert_true(json_number(json_member(doc, "tiny"), &v));
    assert_true(v > 0);
    assert_string_equal(json_string(json_member(doc, "text")), "quote \" backslash \\ newline \n");
    assert_string_equal(json_string(json_member(doc, "bytes")),
                        "a\xef\xbf\xbd\xc3\xa4\xef\xbf\xbd\xef\xbf\xbd\xef\xbf\xbd"
                        "\xef\xbf\xbd");
    json_free(doc);
    free(text);
}

static void deepest(void **state)
{
    (void)state;
    struct cJSON *doc;
    begin();
    for (int i = 0; i < REPORT_DEPTH; i++)
        report_open(&rep, NULL, '[');
    for (int i = 0; i < REPORT_DEPTH; i++)
        report_close(&rep);
    end();
    assert_int_equal(json_parse("report", text, size, &doc), OK);
    json_free(doc);
    free(text);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(layout),
        cmocka_unit_test(hostile_values_stay_json),
        cmocka_unit_test(deepest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
