/* Hashed weights against numbers of another program: tests/data/net/mini.txt has per tensor name,
 * shape and, for seeds 1 and 123456789012345, the fourth value and the sum of all values, both of
 * their bits. */
#include "core/net/hashed.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static float *values; // room for the largest tensor

static uint32_t bits(float v)
{
    uint32_t u;
    memcpy(&u, &v, sizeof u);
    return u;
}

static err_t compare(void *ctx, const struct tensor_spec *t)
{
    static const uint64_t seeds[2] = {1, 123456789012345};
    unsigned fourth[2];
    unsigned long long sum[2];
    char line[512], name[128];
    assert_non_null(fgets(line, sizeof line, ctx));
    if (sscanf(line, "%127s %*s %x %llx %x %llx", name, &fourth[0], &sum[0], &fourth[1], &sum[1]) <
        5)
        return OK; // div_term is not of these rules
    assert_string_equal(t->name, name);
    size_t n = table_count(t);
    for (int s = 0; s < 2; s++) {
        uint64_t total = 0;
        hashed_fill(t, seeds[s], 0, n, values);
        for (size_t i = 0; i < n; i++)
            total += bits(values[i]);
        if (total != sum[s] || (n >= 4 && bits(values[3]) != fourth[s]))
            fail_msg("%s, seed %d: sum %llx, not %llx", name, s, (unsigned long long)total, sum[s]);
    }
    return OK;
}

static void every_bit_is_as_elsewhere(void **state)
{
    (void)state;
    FILE *f = fopen("tests/data/net/mini.txt", "r");
    assert_non_null(f);
    assert_int_equal(table_walk(&table_mini, compare, f), OK);
    fclose(f);
}

/* Rules that change within a tensor must not depend on where a piece begins. */
static err_t piecewise(void *ctx, const struct tensor_spec *t)
{
    static float piece[2000];
    size_t n = table_count(t);
    if (n > 200000 || !t->used)
        return OK;
    hashed_fill(t, 7, 0, n, values);
    for (size_t at = 0, take = 1; at < n; at += take, take = take * 3 % 1999 + 1) {
        take = at + take > n ? n - at : take;
        hashed_fill(t, 7, at, take, piece);
        assert_memory_equal(piece, values + at, take * sizeof *piece);
    }
    ++*(int *)ctx;
    return OK;
}

static void pieces_are_the_whole(void **state)
{
    (void)state;
    int n = 0;
    assert_int_equal(table_walk(&table_mini, piecewise, &n), OK);
    assert_true(n > 350);
}

static err_t largest(void *ctx, const struct tensor_spec *t)
{
    size_t n = table_count(t);
    if (n > *(size_t *)ctx)
        *(size_t *)ctx = n;
    return OK;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_bit_is_as_elsewhere),
        cmocka_unit_test(pieces_are_the_whole),
    };
    size_t n = 0;
    if (table_walk(&table_mini, largest, &n) != OK || !(values = malloc(n * sizeof *values)))
        return 1;
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    free(values);
    return failed;
}
