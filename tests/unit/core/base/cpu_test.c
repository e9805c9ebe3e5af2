#include "core/base/cpu.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static void detection_is_sane(void **state)
{
    (void)state;
    unsigned found = cpu_detect();
    assert_int_equal(found, cpu_detect());
    assert_int_equal(found & ~(unsigned)CPU_ALL, 0);
#if defined(__x86_64__)
    assert_int_equal(found & (CPU_NEON | CPU_NEONDOT | CPU_I8MM), 0);
    assert_true(!(found & CPU_AVX2) || (found & CPU_SSE41));
    assert_true(!(found & CPU_AVX512) || (found & CPU_AVX2));
    assert_true(!(found & CPU_AVX512VNNI) || (found & CPU_AVX512));
    assert_true(!(found & CPU_AMX) || (found & CPU_AVX512VNNI));
    /* gcc's own detection asks the system too */
    assert_int_equal((found & CPU_SSE41) != 0, __builtin_cpu_supports("sse4.1") != 0);
    assert_int_equal((found & CPU_AVX2) != 0,
                     __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"));
    assert_int_equal((found & CPU_AVX512) != 0, __builtin_cpu_supports("avx512bw") &&
                                                    __builtin_cpu_supports("avx512vl") &&
                                                    __builtin_cpu_supports("avx512dq"));
    assert_int_equal((found & CPU_AVX512VNNI) != 0,
                     (found & CPU_AVX512) && __builtin_cpu_supports("avx512vnni"));
#elif defined(__aarch64__)
    assert_true(found & CPU_NEON);
    assert_int_equal(found & (CPU_SSE41 | CPU_AVX2 | CPU_AVX512 | CPU_AVX512VNNI | CPU_AMX), 0);
#endif
}

static void masks_are_lists_of_names(void **state)
{
    (void)state;
    unsigned m;
    assert_int_equal(cpu_parse_mask(NULL, &m), OK);
    assert_int_equal(m, CPU_ALL);
    assert_int_equal(cpu_parse_mask("", &m), OK);
    assert_int_equal(m, CPU_ALL);
    assert_int_equal(cpu_parse_mask("c", &m), OK);
    assert_int_equal(m, 0);
    assert_int_equal(cpu_parse_mask(" sse41, avx2 ", &m), OK);
    assert_int_equal(m, CPU_SSE41 | CPU_AVX2);
    assert_int_equal(cpu_parse_mask("avx512 avx512vnni", &m), OK);
    assert_int_equal(m, CPU_AVX512 | CPU_AVX512VNNI);
    assert_int_equal(cpu_parse_mask("neon neondot,i8mm,avx512 amx", &m), OK);
    assert_int_equal(m, CPU_NEON | CPU_NEONDOT | CPU_I8MM | CPU_AVX512 | CPU_AMX);
}

static void unknown_words_are_named(void **state)
{
    (void)state;
    unsigned m;
    assert_int_equal(cpu_parse_mask("sse41,avx", &m), ERR_ARG);
    assert_non_null(strstr(err_text(), "\"avx\""));
    assert_int_equal(cpu_parse_mask("avx22", &m), ERR_ARG);
    assert_int_equal(cpu_parse_mask("3", &m), ERR_ARG);
}

static void names_round_trip(void **state)
{
    (void)state;
    char buf[CPU_NAMES_CAP];
    assert_string_equal(cpu_names(0, buf), "c");
    assert_string_equal(cpu_names(CPU_SSE41 | CPU_NEONDOT, buf), "sse41 neondot");
    for (unsigned mask = 0; mask <= CPU_ALL; mask++) {
        unsigned back;
        assert_int_equal(cpu_parse_mask(cpu_names(mask, buf), &back), OK);
        assert_int_equal(back, mask);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(detection_is_sane),
        cmocka_unit_test(masks_are_lists_of_names),
        cmocka_unit_test(unknown_words_are_named),
        cmocka_unit_test(names_round_trip),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
