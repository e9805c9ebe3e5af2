/* Lines are read as they were written; every change of one, and every wrong field, is refused
 * without the secret in the sentence. */
#include "firmware/rig/joinline.h"

#include "core/base/sha256.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static struct joinline sample(const char *host, size_t n_ca)
{
    struct joinline j = {
        .port = 8883, .rig = "rig", .board = "m-1", .password = "0123456789_-abcdefABCD"};
    snprintf(j.host, sizeof j.host, "%s", host);
    j.n_ca = n_ca;
    for (size_t i = 4; i < n_ca; i++)
        j.ca[i] = (unsigned char)(i * 31 + i / 7);
    j.ca[0] = 0x30;
    j.ca[1] = 0x82;
    j.ca[2] = (unsigned char)((n_ca - 4) >> 8);
    j.ca[3] = (unsigned char)(n_ca - 4);
    return j;
}

static void there_and_back(void **state)
{
    (void)state;
    static const char *const hosts[] = {"pi1.local", "192.168.1.5", "[fd00::5]", "a"};
    char line[JOINLINE_CAP], pasted[JOINLINE_CAP + 16];
    for (size_t i = 0; i < 4; i++)
        for (size_t n = 132; n <= JOINLINE_CA_MAX; n += i < 3 ? 479 : 1) {
            const struct joinline j = sample(hosts[i], n);
            struct joinline back;
            assert_int_equal(joinline_write(&j, line), OK);
            assert_int_equal(joinline_read(line, &back), OK);
            assert_memory_equal(&j, &back, sizeof j);
            snprintf(pasted, sizeof pasted, " '%s'\r\n", line);
            assert_int_equal(joinline_read(pasted, &back), OK);
        }
}

static void other_letters_are_refused(void **state)
{
    (void)state;
    char line[JOINLINE_CAP];
    struct joinline j = sample("pi1", 300), back;
    assert_int_equal(joinline_write(&j, line), OK);
    const size_t n = strlen(line);
    for (size_t i = 0; i < n; i++) {
        const char was = line[i];
        line[i] = was == 'x' ? 'y' : 'x';
        assert_int_equal(joinline_read(line, &back), ERR_FORMAT);
        assert_null(strstr(err_text(), j.password));
        assert_true(back.host[0] == 0 && back.password[0] == 0 && back.n_ca == 0);
        line[i] = 0;
        assert_int_equal(joinline_read(line, &back), ERR_FORMAT);
        line[i] = was;
    }
}

static void with_sum(const char *fields, char out[JOINLINE_CAP])
{
    char hex[SHA256_HEX_CAP];
    struct sha256 s;
    sha256_init(&s);
    sha256_add(&s, fields, strlen(fields));
    snprintf(out, JOINLINE_CAP, "%s:%.8s", fields, sha256_hex(&s, hex));
}

static void wrong_fields_are_named(void **state)
{
    (void)state;
    static const struct {
        const char *head, *said;
    } cases[] = {
        {"hdrig1:a b:1:rig:m1:0123456789abcdef:", "no host"},
        {"hdrig1::1:rig:m1:0123456789abcdef:", "no host"},
        {"hdrig1:[::1:1:rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:[::1]x:1:rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:a::rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:a:0:rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:a:01:rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:a:-1:rig:m1:0123456789abcdef:", "lacks a part"},
        {"hdrig1:a:99999:rig:m1:0123456789abcdef:", "port 99999"},
        {"hdrig1:a:1:Rig:m1:0123456789abcdef:", "name of a rig"},
        {"hdrig1:a:1:rig:m/1:0123456789abcdef:", "name of a board"},
        {"hdrig1:a:1:rig:m1:0123456789abcde:", "password is too short"},
        {"hdrig1:a:1:rig:m1:0123456789abcde$:", "password is too short"},
        {"hdrig1:a:1:rig:m1:0123456789abcdef:MII", "certificate"},
        {"hdrig1:a:1:rig:m1:0123456789abcdef", "lacks a part"},
        {"hdrig1:", "lacks a part"},
    };
    char line[JOINLINE_CAP];
    struct joinline back;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        with_sum(cases[i].head, line);
        assert_int_equal(joinline_read(line, &back), ERR_FORMAT);
        if (!strstr(err_text(), cases[i].said))
            fail_msg("%s: %s", cases[i].head, err_text());
    }
    assert_int_equal(joinline_read("", &back), ERR_FORMAT);
    assert_int_equal(joinline_read("hdrig1", &back), ERR_FORMAT);
    assert_int_equal(joinline_read("mqtts://pi1", &back), ERR_FORMAT);
}

static void wrong_parts_are_not_written(void **state)
{
    (void)state;
    char line[JOINLINE_CAP];
    struct joinline j = sample("pi1:3", 300);
    assert_int_equal(joinline_write(&j, line), ERR_ARG);
    j = sample("pi1", 131);
    assert_int_equal(joinline_write(&j, line), ERR_ARG);
    j = sample("pi1", 300);
    j.ca[3]++;
    assert_int_equal(joinline_write(&j, line), ERR_ARG);
    j = sample("pi1", 300);
    j.board[0] = 0;
    assert_int_equal(joinline_write(&j, line), ERR_ARG);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(there_and_back),
        cmocka_unit_test(other_letters_are_refused),
        cmocka_unit_test(wrong_fields_are_named),
        cmocka_unit_test(wrong_parts_are_not_written),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
