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

static void digits_of_urls(void **state)
{
    (void)state;
    uint8_t raw[256], back[256];
    char text_of[512];
    size_t got;
    for (size_t i = 0; i < sizeof raw; i++)
        raw[i] = (uint8_t)(i * 167 + 3);
    for (size_t n = 0; n <= sizeof raw; n++) {
        const size_t chars = (size_t)(base64_encode_url(text_of, raw, n) - text_of);
        assert_int_equal(chars, (n * 8 + 5) / 6);
        assert_true(base64_decode_url(text_of, chars, back, &got));
        assert_int_equal(got, n);
        assert_memory_equal(back, raw, n);
    }
    const uint8_t high[] = {0xff, 0xff, 0xfe, 0xfb, 0xef, 0xbe, 0};
    *base64_encode_url(text_of, high, sizeof high) = 0;
    assert_string_equal(text_of, "___-----AA");
    static const char *const wrong[] = {"A",    "AAAAA", "AB",    "AAB",  "AA==", "A A",
                                        "AA+A", "AA/A",  "AA\nA", "AA.A", "=",    "\xc3\xa4"};
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
        assert_false(base64_decode_url(wrong[i], strlen(wrong[i]), back, &got));
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(known_texts),
                                       cmocka_unit_test(digits_of_urls)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
