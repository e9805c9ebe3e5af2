#include "core/base/err.h"

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static void code_and_sentence(void **state)
{
    (void)state;
    assert_int_equal(err_fail(ERR_LIMIT, "%s: %d of %d", "frame", 7, 5), ERR_LIMIT);
    assert_string_equal(err_text(), "frame: 7 of 5");
}

static void sentence_may_quote_itself(void **state)
{
    (void)state;
    assert_int_equal(err_fail(ERR_IO, "inner"), ERR_IO);
    assert_int_equal(err_fail(ERR_IO, "outer: %s", err_text()), ERR_IO);
    assert_string_equal(err_text(), "outer: inner");
}

static void long_sentence_is_cut(void **state)
{
    (void)state;
    char text[2000];
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = 0;
    assert_int_equal(err_fail(ERR_ARG, "%s", text), ERR_ARG);
    assert_int_equal(strlen(err_text()), 511);
}

static void *other_thread(void *seen_empty)
{
    *(int *)seen_empty = *err_text() == 0 && err_fail(ERR_IO, "theirs") == ERR_IO;
    return NULL;
}

static void sentences_belong_to_threads(void **state)
{
    (void)state;
    int seen_empty = 0;
    pthread_t t;
    assert_int_equal(err_fail(ERR_BUSY, "mine"), ERR_BUSY);
    assert_int_equal(pthread_create(&t, NULL, other_thread, &seen_empty), 0);
    pthread_join(t, NULL);
    assert_true(seen_empty);
    assert_string_equal(err_text(), "mine");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(code_and_sentence),
        cmocka_unit_test(sentence_may_quote_itself),
        cmocka_unit_test(long_sentence_is_cut),
        cmocka_unit_test(sentences_belong_to_threads),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
