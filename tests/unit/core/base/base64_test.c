/* The vectors of RFC 4648, section 10, and bytes with every bit. */
#include "core/base/base64.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static const char *text(const void *p, size_t n)
{
    static char out[64];
    char *end;
    memset(out, '?', sizeof out);
    end = base64_encode(out, p, n);
    assert_int_equal(end - out, base64_chars(n));
    assert_int_equal(*end, '?');
    *end = 0;
    return out;
}

static void known_texts(void **state)
{
    (void)state;
    static const char *const want[] = {"",         "Zg==",     "Zm8=",    "Zm9v",
                                       "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"};
    for (size_t n = 0; n < 7; n++)
        assert_string_equal(text("foobar", n), want[n]);
    const uint8_t high[] = {0xff, 0xff, 0xfe, 0xfb, 0xef, 0xbe, 0};
    assert_string_equal(text(high, sizeof high), "///+++++AA==");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(known_texts)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
