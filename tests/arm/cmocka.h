/* cmocka.h - the part of cmocka that the unit tests of core use, for builds without the library.
 * A failed assertion prints its place and ends the program. */
#ifndef ARM_CMOCKA_H
#define ARM_CMOCKA_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct CMUnitTest {
    const char *name;
    void (*run)(void **state);
};

// clang-format off
#define cmocka_unit_test(f) {#f, f}
// clang-format on
#define cmocka_run_group_tests(tests, setup, teardown)                                             \
    cmocka_run_all(tests, sizeof(tests) / sizeof((tests)[0]))

static inline int cmocka_run_all(const struct CMUnitTest *tests, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        void *state = NULL;
        tests[i].run(&state);
        printf("ok %s\n", tests[i].name);
    }
    return 0;
}

#define cmocka_check(cond)                                                                         \
    ((cond) ? (void)0 : (fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #cond), exit(1)))

#define fail_msg(...)                                                                              \
    (fprintf(stderr, "%s:%d: ", __FILE__, __LINE__), fprintf(stderr, __VA_ARGS__), exit(1))
#define print_message printf
#define skip() return

#define assert_true(c) cmocka_check(c)
#define assert_false(c) cmocka_check(!(c))
#define assert_null(p) cmocka_check((p) == NULL)
#define assert_non_null(p) cmocka_check((p) != NULL)
#define assert_ptr_equal(a, b) cmocka_check((const void *)(a) == (const void *)(b))
#define assert_int_equal(a, b) cmocka_check((unsigned long long)(a) == (unsigned long long)(b))
#define assert_int_not_equal(a, b) cmocka_check((unsigned long long)(a) != (unsigned long long)(b))
#define assert_in_range(v, lo, hi) cmocka_check((v) >= (lo) && (v) <= (hi))
#define assert_float_equal(a, b, eps) cmocka_check(fabs((double)(a) - (double)(b)) <= (double)(eps))
#define assert_double_equal assert_float_equal
#define assert_string_equal(a, b) cmocka_check(strcmp(a, b) == 0)
#define assert_memory_equal(a, b, n) cmocka_check(memcmp(a, b, n) == 0)

#endif
