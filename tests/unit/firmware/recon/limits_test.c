/* How shares are made of turns; the loops themselves are only run. */
#include "firmware/recon/limits.h"

#include "core/base/cpu.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static void turns_have_a_median_and_quartiles(void **state)
{
    (void)state;
    struct limits_turns t = {.n = 0};
    assert_true(limits_sum_up(&t).limit == 0);
    for (int i = 0; i < 8; i++) // 7, 4, 1, 6, 3, 0, 5, 2
        limits_add(&t, 10 + (7 + 5 * i) % 8,
                   (10 + (7 + 5 * i) % 8) * 0.5 * (double)((7 + 5 * i) % 8));
    struct limits_share s = limits_sum_up(&t);
    assert_true(s.limit == 14 && s.share == 2 && s.low == 1 && s.high == 3);
    s = limits_share_of(&t, 28); // over 10 .. 17
    assert_true(s.limit == 14 && s.share == 28.0 / 13 && s.low == 28.0 / 15 && s.high == 28.0 / 11);
    t.n = 0;
    limits_add(&t, 0, 5); // no limit is known
    assert_true(limits_sum_up(&t).share == 0);
    for (int i = 0; i < LIMITS_TURNS + 9; i++)
        limits_add(&t, 1, 1);
    assert_int_equal(t.n, LIMITS_TURNS);
}

static void every_level_of_this_machine_has_loops(void **state)
{
    static const struct {
        const char *isa;
        unsigned cpu;
    } s8[] = {{"c", 0},
              {"sse41", CPU_SSE41},
              {"avx2", CPU_AVX2},
              {"avx512", CPU_AVX512},
              {"avx512vnni", CPU_AVX512VNNI},
              {"neon", CPU_NEON},
              {"neondot", CPU_NEONDOT},
              {"i8mm", CPU_I8MM}};
    struct pool *pool;
    (void)state;
    assert_int_equal(pool_open(&pool, 2), OK);
    for (size_t i = 0; i < sizeof s8 / sizeof s8[0]; i++) {
        if ((cpu_detect() & s8[i].cpu) != s8[i].cpu)
            continue;
        const struct limits_loop loop = limits_s8(s8[i].isa);
        assert_true(limits_now(pool, &loop) > 0);
    }
    const struct limits_loop flops = limits_flops(cpu_detect()), none = limits_f32("none");
    assert_true(limits_now(pool, &flops) > 0);
    assert_true(limits_now(pool, &none) == 0);
    pool_close(pool);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(turns_have_a_median_and_quartiles),
        cmocka_unit_test(every_level_of_this_machine_has_loops),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
