/* How a picture is dealt out: ranks of any speeds end at the same time, and a slow one does not
 * make the others wait for what every rank does for itself. */
#include "core/splat/raster.h"

#include "core/base/num.h"

#include "tests/unit/expect.h"

#include <math.h>

enum { ACROSS = 20, ROWS = 20, ON_TILE = 100, N = ACROSS * ROWS * ON_TILE };

/* In the unit of raster_team.c: splats on a tile. */
static const double ROW = ACROSS * (128 + ON_TILE), SPLATS = N / 2.0;

static struct raster_span spans[N];

/* Seconds of each rank until its band is done, for a speed of 1; as many splats on every tile. */
static void deal(const int *share, int size, double *seconds, int *rows)
{
    struct team t = {.size = size};
    struct raster rs = {.spans = spans, .tiles_x = ACROSS, .tiles_y = ROWS, .team = &t};
    for (int k = 0; k < size; k++)
        t.share[k] = share[k];
    for (int i = 0; i < N; i++)
        spans[i] = (struct raster_span){(uint8_t)(i % ROWS), (uint8_t)(i % ROWS + 1), 1};
    raster_team_deal(&rs, N);
    assert_int_equal(rs.band[0], 0);
    assert_int_equal(rs.band[size], ROWS);
    for (int k = 0; k < size; k++) {
        rows[k] = rs.band[k + 1] - rs.band[k];
        const int from = num_max(rs.band[k] - 1, 0), end = num_min(rs.band[k + 1] + 1, ROWS);
        seconds[k] = (SPLATS + ROW * (rows[k] ? end - from : 0)) / share[k];
    }
}

static void test_equal(void **state)
{
    (void)state;
    static const int share[] = {8, 8, 8, 8};
    double seconds[4];
    int rows[4];
    for (int size = 1; size <= 4; size++) {
        deal(share, size, seconds, rows);
        for (int k = 0; k < size; k++)
            assert_in_range(rows[k], ROWS / size, (ROWS + size - 1) / size);
    }
}

static void test_slow(void **state)
{
    (void)state;
    static const int share[][2] = {{8, 4}, {4, 8}, {8, 2}, {2, 8}, {8, 1}, {1, 8}};
    const double alone = (SPLATS + ROW * ROWS) / 8;
    for (size_t i = 0; i < sizeof share / sizeof share[0]; i++) {
        double seconds[2];
        int rows[2];
        deal(share[i], 2, seconds, rows);
        const double most = fmax(seconds[0], seconds[1]);
        print_message("  %d and %d: %d and %d rows, %.2f of the time of the fast one alone\n",
                      share[i][0], share[i][1], rows[0], rows[1], most / alone);
        const int slow = num_min(share[i][0], share[i][1]);
        assert_true(most <= 1.05 * fmax(alone, SPLATS / slow)); // a row is a twentieth
        assert_true(slow < 4 || most < 0.9 * alone);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_equal), cmocka_unit_test(test_slow)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
