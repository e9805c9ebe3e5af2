#include "core/base/log.h"

#include <errno.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static char seen[4096];

/* Send stderr to a file, log, and read it back into `seen`. */
static void logged(enum log_level level, const char *text)
{
    FILE *f = tmpfile();
    assert_non_null(f);
    int old = dup(STDERR_FILENO);
    assert_true(dup2(fileno(f), STDERR_FILENO) >= 0);
    log_write(level, "%s", text);
    assert_true(dup2(old, STDERR_FILENO) >= 0);
    close(old);
    rewind(f);
    size_t n = fread(seen, 1, sizeof seen - 1, f);
    seen[n] = 0;
    fclose(f);
}

static void plain_line(void **state)
{
    (void)state;
    unsetenv("JOURNAL_STREAM");
    logged(LOG_INFO, "camera 2: opened");
    assert_string_equal(seen, "camera 2: opened\n");
}

static void journal_gets_the_priority(void **state)
{
    (void)state;
    setenv("JOURNAL_STREAM", "8:1234", 1);
    logged(LOG_WARN, "late frame");
    unsetenv("JOURNAL_STREAM");
    assert_string_equal(seen, "<4>late frame\n");
}

static void level_hides(void **state)
{
    (void)state;
    logged(LOG_DEBUG, "hidden");
    assert_string_equal(seen, "");
    log_set_level(LOG_DEBUG);
    logged(LOG_DEBUG, "shown");
    assert_string_equal(seen, "shown\n");
    log_set_level(LOG_ERROR);
    logged(LOG_WARN, "hidden");
    assert_string_equal(seen, "");
    log_set_level(LOG_INFO);
}

static void a_line_stays_one_line(void **state)
{
    (void)state;
    logged(LOG_INFO, "name\n<0>forged\x1b[31m\x7f");
    assert_string_equal(seen, "name?<0>forged?[31m?\n");
    char text[3000];
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = 0;
    logged(LOG_INFO, text);
    assert_int_equal(strlen(seen), 1024);
    assert_int_equal(seen[1023], '\n');
}

static void errno_survives(void **state)
{
    (void)state;
    int old = dup(STDERR_FILENO);
    close(STDERR_FILENO);
    errno = ENOSPC;
    log_error("nobody listens");
    int after = errno;
    dup2(old, STDERR_FILENO);
    close(old);
    assert_int_equal(after, ENOSPC);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(plain_line),     cmocka_unit_test(journal_gets_the_priority),
        cmocka_unit_test(level_hides),    cmocka_unit_test(a_line_stays_one_line),
        cmocka_unit_test(errno_survives),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
