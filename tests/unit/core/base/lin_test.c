/* The Cholesky factor by panels of columns is the one by rows, bit for bit: of small and large
 * systems, full ones and such that are mostly zero; what is not positive definite has none. */
#include "core/base/lin.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

enum { MOST = 230 };

static double plain[MOST * MOST], panels[MOST * MOST];

static bool factor_by_rows(double *a, int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = a[i * n + j];
            for (int k = 0; k < j; k++)
                sum -= a[i * n + k] * a[j * n + k];
            if (i == j && !(sum > 0 && isfinite(sum)))
                return false;
            a[i * n + j] = i == j ? sqrt(sum) : sum / a[j * n + j];
        }
    return true;
}

/* Entries within `band` of the diagonal, and the last rows. */
static void make_system(int n, int band, uint32_t seed)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            seed = seed * 1664525u + 1013904223u;
            const double x = (seed >> 8) * 0x1p-23 - 1;
            plain[i * n + j] = i == j ? n + x : i - j < band || i > n - 5 ? x : 0;
        }
}

static void check(int n, bool want)
{
    memcpy(panels, plain, (size_t)n * (size_t)n * sizeof *plain);
    assert_int_equal(factor_by_rows(plain, n), want);
    assert_int_equal(lin_cholesky(panels, n), want);
    for (int i = 0; i < n && want; i++)
        assert_memory_equal(panels + i * n, plain + i * n, (size_t)(i + 1) * sizeof *plain);
}

static void same_as_by_rows(void **state)
{
    static const int size[] = {1, 2, 6, 15, 63, 64, 65, 80, 81, 127, 128, 129, 200, MOST};
    (void)state;
    for (size_t k = 0; k < sizeof size / sizeof *size; k++)
        for (int band = 1; band < 2 * size[k]; band += 1 + size[k] / 2) {
            make_system(size[k], band, 7u + (uint32_t)band);
            check(size[k], true);
        }
}

static void not_positive_definite(void **state)
{
    static const double bad[] = {0, -1, NAN, INFINITY};
    (void)state;
    for (int at = 3; at < MOST; at += 50)
        for (int k = 0; k < 4; k++) {
            make_system(MOST, MOST, 11);
            plain[at * MOST + at] = bad[k];
            check(MOST, false);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(same_as_by_rows),
        cmocka_unit_test(not_positive_definite),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
