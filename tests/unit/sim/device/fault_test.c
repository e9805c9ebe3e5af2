/* Scripts: every verb is read as written; what is wrong is refused with line and reason. */
#include "sim/device/fault.h"

#include "tests/unit/tmpdir.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static struct fault_script script;

static err_t parse(const char *text)
{
    return fault_parse("script", text, strlen(text), &script);
}

static void test_every_verb(void **state)
{
    static const char *const line[FAULT_VERBS] = {
        "drop 3 nogap",   "lose 0.05",       "duplicate",     "repeat",
        "error",          "short 10",        "corrupt 99",    "tear 0.5",
        "late 0.25",      "stall 0",         "eio",           "index",
        "unplug",         "sequence stuck",  "sequence wrap", "stamp zero",
        "stamp realtime", "stamp back 2",    "stamp jump -3", "ignore 0",
        "rollover 656",   "quantum 0.0001",  "gain 1.01",     "balance 0.99",
        "digital 1.5",    "refuse access 2", "refuse busy 1", "refuse range 0",
        "format"};
    static const double number[FAULT_VERBS] = {3,  0.05, 0,   0,    0,    10,   99,  0.5, 0.25,
                                               0,  0,    0,   0,    0,    0,    0,   0,   2,
                                               -3, 0,    656, 1e-4, 1.01, 0.99, 1.5, 2,   1};
    (void)state;
    for (int v = 0; v < FAULT_VERBS; v++) {
        char text[128];
        snprintf(text, sizeof text, "  at frame %d\t%s # why\r\n", v, line[v]);
        assert_int_equal(parse(text), OK);
        assert_int_equal(script.n, 1);
        assert_int_equal(script.v[0].verb, v);
        assert_int_equal(script.v[0].frame, v);
        assert_false(script.v[0].by_time);
        assert_true(script.v[0].number == number[v]);
        assert_int_equal(script.v[0].nogap, v == FAULT_DROP);
    }
}

static void test_lines(void **state)
{
    (void)state;
    assert_int_equal(parse(""), OK);
    assert_int_equal(script.n, 0);
    assert_int_equal(parse("# nothing\n\n  \n;;"), OK);
    assert_int_equal(script.n, 0);
    assert_int_equal(parse("at frame 3 drop 1;at time 1.5 unplug\n# x\nat frame 7 eio"), OK);
    assert_int_equal(script.n, 3);
    assert_false(script.v[0].nogap);
    assert_true(script.v[1].by_time && script.v[1].time_ns == 1500000000);
    assert_int_equal(script.v[2].frame, 7);
}

static void test_refusals(void **state)
{
    static const struct {
        const char *text, *says;
    } bad[] = {
        {"at frame 1", "script: line 1 is not"},
        {"\nat frame one eio", "script: line 2: \"one\" is not a number"},
        {"at frame 1.5 eio", "1.5 is not a whole number"},
        {"at frame -1 eio", "\"-1\" is not a number in 0..1e+09"},
        {"at time nan eio", "\"nan\" is not a number"},
        {"at noon 1 eio", "\"noon\" is neither frame nor time"},
        {"on frame 1 eio", "line 1 is not"},
        {"at frame 1 melt", "no fault is called \"melt\""},
        {"at frame 1 eio 3", "unexpected word \"3\" at the end"},
        {"at frame 1 drop", "ends before the number after \"drop\""},
        {"at frame 1 drop 0", "\"0\" is not a number in 1..1e+06"},
        {"at frame 1 drop 1 quietly", "unexpected word \"quietly\" at the end"},
        {"at frame 1 drop 1 nogap nogap", "unexpected word \"nogap\" at the end"},
        {"at frame 1 sequence", "\"sequence\" does not take \"\""},
        {"at frame 1 stamp yesterday", "\"stamp\" does not take \"yesterday\""},
        {"at frame 1 stamp back", "ends before the number after \"back\""},
        {"at frame 1 drop 2.5", "2.5 is not a whole number"},
        {"at frame 1 gain 3x", "\"3x\" is not a number"},
        {"at frame 1 a b c d e f", "more than 8 words"},
        {"at frame 1 \x01", "line 1 has byte 1,"},
        {"at frame 1 \xc3\xa4", "line 1 has byte 195,"},
        {"at frame 1 eio;at frame 2 eoi", "line 2: no fault is called \"eoi\""},
    };
    (void)state;
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        assert_int_equal(parse(bad[i].text), ERR_FORMAT);
        assert_non_null(strstr(err_text(), bad[i].says));
        assert_int_equal(script.n, 0);
    }
    assert_int_equal(fault_parse("script", "at frame 1 e\0o", 14, &script), ERR_FORMAT);
    char word[100] = "at frame 1 ";
    memset(word + 11, 'x', 80);
    assert_int_equal(parse(word), ERR_FORMAT);
}

static void test_too_many(void **state)
{
    static char text[(FAULT_MAX + 1) * 16 + 1];
    (void)state;
    for (int i = 0; i < FAULT_MAX; i++)
        strcat(text, "at frame 1 eio\n");
    assert_int_equal(parse(text), OK);
    assert_int_equal(script.n, FAULT_MAX);
    strcat(text, "at frame 1 eio\n");
    assert_int_equal(parse(text), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "line 257: there are more than 256 faults"));
}

static void test_file(void **state)
{
    (void)state;
    tmpdir_make();
    assert_int_equal(fault_read(tmpdir_text("f", "at frame 5 stall 2\n"), &script), OK);
    assert_int_equal(script.v[0].verb, FAULT_STALL);
    assert_int_equal(fault_read(tmpdir_text("empty", ""), &script), OK);
    assert_int_equal(fault_read(tmpdir_text("g", "\nat frame 5 stal 2\n"), &script), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "/g: line 2: no fault is called"));
    assert_int_equal(fault_read(tmpdir_path("none"), &script), ERR_IO);
    assert_int_equal(fault_read("at frame 5 eio", &script), OK);
    assert_int_equal(script.n, 1);
    tmpdir_remove();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_verb), cmocka_unit_test(test_lines),
        cmocka_unit_test(test_refusals),   cmocka_unit_test(test_too_many),
        cmocka_unit_test(test_file),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
