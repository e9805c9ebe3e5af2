/* Which steps see which pictures, and how many of them fit into a time. */
#include "core/refine/pace.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

static void every_level_has_its_share(void **state)
{
    (void)state;
    for (int levels = 1; levels <= PACE_LEVELS; levels++) {
        int count[PACE_LEVELS] = {0}, before = levels - 1;
        for (int i = 0; i < 1200; i++) {
            int level = pace_level(i, 1200, levels);
            assert_in_range(level, 0, before);
            before = level;
            count[level]++;
        }
        assert_int_equal(before, 0);
        for (int k = 0; k < levels && levels > 1; k++)
            assert_in_range(count[k], k == levels - 1 ? 400 : 799 / (levels - 1),
                            k == levels - 1 ? 400 : 801 / (levels - 1));
    }
}

static const struct pace paces[] = {
    {1, {0.5}}, {2, {1, 0.25}}, {3, {2, 0.5, 0.125}}, {5, {4, 1, 0.3, 0.1, 0.05}}};

/* At most 2 % of the steps fewer than the most that fit. */
static void as_many_as_fit(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof paces / sizeof *paces; i++)
        for (int from = 0; from <= 300; from += 50)
            for (double seconds = 1; seconds < 2000; seconds *= 1.7) {
                int n = pace_fit(&paces[i], from, 1000, seconds), more = n + 1 + (n - from) / 32;
                assert_in_range(n, from, 1000);
                assert_true(pace_seconds(&paces[i], from, n) <= seconds);
                assert_true(n == 1000 || n + 1 >= 1000 || more > 1000 ||
                            pace_seconds(&paces[i], from, more) > seconds);
            }
}

static void no_time_no_step(void **state)
{
    (void)state;
    assert_int_equal(pace_fit(&paces[1], 40, 1000, 0), 40);
    assert_int_equal(pace_fit(&paces[1], 40, 1000, -5), 40);
    assert_int_equal(pace_fit(&paces[1], 0, 0, 5), 0);
    assert_int_equal(pace_fit(&paces[1], 0, 1000, (double)INFINITY), 1000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_level_has_its_share),
                                       cmocka_unit_test(as_many_as_fit),
                                       cmocka_unit_test(no_time_no_step)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
