#include "firmware/base/progress.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static int count(const char *text, const char *what)
{
    int n = 0;
    for (const char *p = text; (p = strstr(p, what)); p++)
        n++;
    return n;
}

static void lines(void **state)
{
    (void)state;
    char b[160];
    assert_string_equal(progress_line("refine", 430, 1000, 12.2, "loss 0.031, 61200 splats", b),
                        "refine 43 % step 430/1000, 12 s left, loss 0.031, 61200 splats");
    assert_string_equal(progress_line("refine", 0, 10, -1, NULL, b), "refine 0 % step 0/10");
    assert_string_equal(progress_line("refine", 1, 10, 0.4, NULL, b), "refine 10 % step 1/10");
    assert_string_equal(progress_line("sweep", 3, 3, -1, "", b), "sweep 100 % step 3/3");
    assert_string_equal(progress_line("none", 0, 0, -1, NULL, b), "none 100 % step 0/0");
    char note[400];
    memset(note, 'x', sizeof note - 1);
    note[sizeof note - 1] = 0;
    assert_int_equal(strlen(progress_line("s", 1, 2, 1e9, note, b)), 159);
    assert_string_equal(progress_line("s", 2147483647, 2147483647, -1, NULL, b),
                        "s 100 % step 2147483647/2147483647");
}

/* Not a terminal: a line at each tenth. */
static void plain(void **state)
{
    (void)state;
    char *text;
    size_t size;
    FILE *f = tmpfile();
    struct progress p;
    assert_non_null(f);
    progress_init(&p, f);
    assert_false(p.terminal);
    for (int i = 1; i <= 1000; i++)
        progress_step(&p, "refine", i, 1000, NULL);
    for (int i = 1; i <= 3; i++)
        progress_step(&p, "write", i, 3, "note");
    progress_end(&p);
    size = (size_t)ftell(f);
    text = calloc(1, size + 1);
    assert_non_null(text);
    rewind(f);
    assert_int_equal(fread(text, 1, size, f), size);
    assert_int_equal(count(text, "refine"), 11);
    assert_int_equal(count(text, "refine 100 % step 1000/1000\n"), 1);
    assert_int_equal(count(text, "write"), 3);
    assert_int_equal(count(text, ", note\n"), 3);
    assert_int_equal(count(text, "\n"), 14);
    assert_int_equal(count(text, "\r"), 0);
    free(text);
    fclose(f);
}

/* The time of the first step is not known where it is over when the stage is first heard of. */
static void times_left(void **state)
{
    (void)state;
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    struct progress p = {.f = f};
    progress_step(&p, "write", 1, 8, NULL);
    assert_int_equal(fflush(f), 0);
    assert_int_equal(count(text, "left"), 0);
    p.start_ns -= 10000000000; // as if 10 s had gone by
    progress_step(&p, "write", 2, 8, NULL);
    assert_int_equal(fflush(f), 0);
    assert_int_equal(count(text, "write 25 % step 2/8, 60 s left\n"), 1);
    p.start_ns -= 110000000000;
    progress_step(&p, "write", 7, 8, NULL);
    progress_step(&p, "write", 8, 8, NULL);
    assert_int_equal(fclose(f), 0);
    assert_int_equal(count(text, "write 87 % step 7/8, 20 s left\n"), 1);
    assert_int_equal(count(text, "write 100 % step 8/8\n"), 1);
    free(text);
}

/* A terminal: one line, written again; the end of a stage is always shown. */
static void terminal(void **state)
{
    (void)state;
    char *text = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&text, &size);
    struct progress p = {.f = f, .terminal = true};
    for (int i = 1; i <= 100; i++)
        progress_step(&p, "refine", i, 100, NULL);
    progress_step(&p, "write", 1, 2, NULL);
    progress_end(&p);
    progress_end(&p);
    fclose(f);
    assert_int_equal(count(text, "refine 1 %"), 1);
    assert_int_equal(count(text, "\rrefine 100 %"), 1);
    assert_true(count(text, "\r") < 10);
    assert_int_equal(count(text, "\n"), 2);
    free(text);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lines),
        cmocka_unit_test(plain),
        cmocka_unit_test(times_left),
        cmocka_unit_test(terminal),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
