#include "core/base/bytes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

static void numbers_are_little_endian(void **state)
{
    (void)state;
    static const uint8_t raw[] = {0xfe, 0x34, 0x12, 0x78, 0x56, 0x34, 0x12, 8,    7,
                                  6,    5,    4,    3,    2,    1,    0,    0,    0xc0,
                                  0xbf, 0,    0,    0,    0,    0,    0,    0xf8, 0x3f};
    struct bytes b = bytes_of(raw, sizeof raw);
    assert_int_equal(bytes_u8(&b), 0xfe);
    assert_int_equal(bytes_u16(&b), 0x1234);
    assert_int_equal(bytes_u32(&b), 0x12345678);
    assert_true(bytes_u64(&b) == 0x0102030405060708u);
    assert_true(bytes_f32(&b) == -1.5f);
    assert_true(bytes_f64(&b) == 1.5);
    assert_int_equal(b.left, 0);
    assert_false(b.bad);
}

static void a_read_past_the_end_is_zero_and_sticks(void **state)
{
    (void)state;
    static const uint8_t raw[3] = {1, 2, 3};
    struct bytes b = bytes_of(raw, sizeof raw);
    assert_int_equal(bytes_u32(&b), 0);
    assert_true(b.bad);
    assert_int_equal(bytes_u8(&b), 0); // would fit, but the record is lost
    assert_null(bytes_take(&b, 1));
    b = bytes_of(NULL, 0);
    assert_int_equal(bytes_u8(&b), 0);
    assert_true(b.bad);
}

static void take_and_skip_stay_inside(void **state)
{
    (void)state;
    static const uint8_t raw[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    struct bytes b = bytes_of(raw, sizeof raw);
    bytes_skip(&b, 2, 2);
    assert_ptr_equal(bytes_take(&b, 4), raw + 4);
    assert_non_null(bytes_take(&b, 0));
    assert_false(b.bad);
    b = bytes_of(raw, sizeof raw);
    bytes_skip(&b, SIZE_MAX / 2 + 1, 2); // the product wraps to 0
    assert_true(b.bad);
    b = bytes_of(raw, sizeof raw);
    bytes_skip(&b, 9, 1);
    assert_true(b.bad);
}

static void put_is_the_inverse(void **state)
{
    (void)state;
    uint8_t raw[18], *p = raw;
    p = bytes_put_u16(p, 0xbeef);
    p = bytes_put_u32(p, 0xdeadbeef);
    p = bytes_put_u64(p, 0x0123456789abcdefu);
    p = bytes_put_f32(p, -0.1f);
    assert_ptr_equal(p, raw + sizeof raw);
    struct bytes b = bytes_of(raw, sizeof raw);
    assert_int_equal(bytes_u16(&b), 0xbeef);
    assert_true(bytes_u32(&b) == 0xdeadbeefu);
    assert_true(bytes_u64(&b) == 0x0123456789abcdefu);
    assert_true(bytes_f32(&b) == -0.1f);
}

static void sums_and_products_report_overflow(void **state)
{
    (void)state;
    size_t v;
    assert_true(bytes_mul(6, 7, &v));
    assert_int_equal(v, 42);
    assert_false(bytes_mul(SIZE_MAX / 2, 3, &v));
    assert_true(v == SIZE_MAX);
    assert_true(bytes_add(SIZE_MAX - 1, 1, &v));
    assert_false(bytes_add(SIZE_MAX, 1, &v));
    assert_true(v == SIZE_MAX);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_are_little_endian),
        cmocka_unit_test(a_read_past_the_end_is_zero_and_sticks),
        cmocka_unit_test(take_and_skip_stay_inside),
        cmocka_unit_test(put_is_the_inverse),
        cmocka_unit_test(sums_and_products_report_overflow),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
