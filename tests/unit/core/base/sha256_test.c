/* Vectors of NIST (FIPS 180-4 examples, CAVP SHA256ShortMsg) and every way to cut a message. */
#include "core/base/sha256.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static const char *hash(const void *p, size_t n, size_t step)
{
    static char hex[SHA256_HEX_CAP];
    struct sha256 s;
    sha256_init(&s);
    for (size_t at = 0; at < n; at += step)
        sha256_add(&s, (const char *)p + at, n - at < step ? n - at : step);
    return sha256_hex(&s, hex);
}

static void known_messages(void **state)
{
    (void)state;
    static char million[1000000];
    const char *two = "abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq";
    const uint8_t d3 = 0xd3;
    memset(million, 'a', sizeof million);
    assert_string_equal(hash("", 0, 1),
                        "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    assert_string_equal(hash(&d3, 1, 1),
                        "28969cdfa74a12c82f3bad960b0b000aca2ac329deea5c2328ebc6f2ba9802c1");
    assert_string_equal(hash("abc", 3, 3),
                        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    assert_string_equal(hash(two, strlen(two), 100),
                        "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
    assert_string_equal(hash(million, sizeof million, 999),
                        "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

static void cuts_do_not_matter(void **state)
{
    (void)state;
    uint8_t text[200];
    char whole[SHA256_HEX_CAP];
    for (size_t i = 0; i < sizeof text; i++)
        text[i] = (uint8_t)(i * 37);
    for (size_t n = 0; n < sizeof text; n++) {
        strcpy(whole, hash(text, n, sizeof text));
        for (size_t step = 1; step < 70; step++)
            assert_string_equal(hash(text, n, step), whole);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_messages),
        cmocka_unit_test(cuts_do_not_matter),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
