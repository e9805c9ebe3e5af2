#include "core/base/share.h"

#include "tests/unit/core/base/team_local.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

enum { ITEMS = 103 };

static void items_are_dealt_once_and_by_share(void **state)
{
    static const int shares[][4] = {{1, 1, 1, 1}, {8, 8, 8, 2}, {1, 8, 8, 8}};
    (void)state;
    for (int s = 0; s < 3; s++) {
        struct team t = {.size = 4};
        int all = 0;
        for (int i = 0; i < 4; i++)
            all += t.share[i] = shares[s][i];
        for (int n = 0; n <= ITEMS; n++) {
            assert_int_equal(team_first(&t, n, 0), 0);
            assert_int_equal(team_first(&t, n, 4), n);
            for (int i = 0; i < 4; i++) {
                const int dealt = team_first(&t, n, i + 1) - team_first(&t, n, i);
                assert_in_range(dealt + 1, n * t.share[i] / all, n * t.share[i] / all + 2);
            }
        }
    }
    assert_int_equal(team_first(NULL, 7, 0), 0);
    assert_int_equal(team_first(NULL, 7, 1), 7);
}

/* Every rank fills in its own part of everything, and must find what the others have filled in. */
static err_t move_everything(void *ctx, struct team *t)
{
    const int size = team_size(t), rank = team_rank(t);
    uint16_t item[ITEMS], own = rank == 0 ? 77 : 0, out[TEAM_MAX * 2] = {0}, in[TEAM_MAX * 2] = {0};
    size_t at[TEAM_MAX + 1];
    int wrong = 0, each[TEAM_MAX] = {0};
    (void)ctx;
    memset(item, 0, sizeof item);
    for (int i = team_first(t, ITEMS, rank); i < team_first(t, ITEMS, rank + 1); i++)
        item[i] = (uint16_t)(3 * i + 1);
    err_t e = team_gather(t, item, sizeof *item, ITEMS);
    if (!e)
        e = team_copy(t, &own, sizeof own);
    each[rank] = rank + 5;
    if (!e)
        e = team_collect(t, each, sizeof *each);
    for (int i = 0; i < 2 * size; i++)
        out[i] = (uint16_t)(100 * rank + i);
    for (int i = 0; i <= size; i++)
        at[i] = 2 * sizeof *out * (size_t)i;
    if (!e)
        e = team_exchange(t, out, at, in, at);
    for (int i = 0; i < ITEMS; i++)
        wrong += item[i] != 3 * i + 1;
    for (int i = 0; i < size; i++)
        wrong += each[i] != i + 5;
    for (int i = 0; i < 2 * size; i++)
        wrong += in[i] != 100 * (i / 2) + 2 * rank + i % 2;
    if (!e && (wrong || own != 77))
        e = err_fail(ERR_ARG, "rank %d: %d wrong items, %d", rank, wrong, own);
    return e;
}

static void parts_come_to_all(void **state)
{
    const int uneven[8] = {1, 8, 2, 8, 8, 4, 8, 1};
    (void)state;
    for (int size = 1; size <= 8; size++) {
        assert_int_equal(team_local_run(size, NULL, move_everything, NULL, NULL), OK);
        assert_int_equal(team_local_run(size, uneven, move_everything, NULL, NULL), OK);
    }
}

static err_t count_bytes(void *ctx, struct team *t)
{
    char data[64] = {0};
    (void)ctx;
    err_t e = team_gather(t, data, 4, 16);
    if (!e && (t->sent != 3 * 16 || t->received != 48))
        e = err_fail(ERR_ARG, "%d sent, %d received", (int)t->sent, (int)t->received);
    return e;
}

static void bytes_are_counted(void **state)
{
    (void)state;
    assert_int_equal(team_local_run(4, NULL, count_bytes, NULL, NULL), OK);
}

/* ---- chunks and views ---- */

struct views_job {
    struct extent px[5];
    uint16_t plane[5][12];
    int runs;
};

static err_t fill_view(void *ctx, int i, int worker)
{
    struct views_job *j = ctx;
    (void)worker;
    j->runs++;
    for (int k = 0; k < 10 + i % 2; k++)
        (&j->plane[0][0])[j->px[i].at + (size_t)k] = (uint16_t)(100 * i + k);
    return OK;
}

static err_t share_views(void *ctx, struct team *t)
{
    struct views_job j = {.runs = 0};
    struct run r = {.team = t};
    int wrong = 0;
    (void)ctx;
    for (int i = 0; i < 5; i++)
        j.px[i] = (struct extent){10 + i % 2, 1, extent_total(j.px, i)};
    err_t e = share_for(&r, 5, fill_view, &j);
    const int own = team_first(t, 5, team_rank(t) + 1) - team_first(t, 5, team_rank(t));
    if (!e)
        e = share_gather(&r, j.plane, sizeof **j.plane, j.px, 5);
    for (int i = 0; i < 5; i++)
        for (int k = 0; k < 10 + i % 2; k++)
            wrong += (&j.plane[0][0])[j.px[i].at + (size_t)k] != 100 * i + k;
    return e || (!wrong && j.runs == own) ? e : err_fail(ERR_ARG, "%d wrong", wrong);
}

static void views_are_computed_once_and_come_to_all(void **state)
{
    (void)state;
    for (int size = 1; size <= 8; size++)
        assert_int_equal(team_local_run(size, NULL, share_views, NULL, NULL), OK);
}

static err_t fail_on_rank_2(void *ctx, struct team *t)
{
    int item[4] = {0};
    (void)ctx;
    if (t->rank == 2)
        return err_fail(ERR_NOMEM, "only here");
    return team_gather(t, item, sizeof *item, 4);
}

static void others_do_not_wait_for_a_rank_that_failed(void **state)
{
    err_t result[4];
    (void)state;
    assert_int_equal(team_local_run(4, NULL, fail_on_rank_2, NULL, result), ERR_LOST);
    for (int i = 0; i < 4; i++)
        assert_int_equal(result[i], i == 2 ? ERR_NOMEM : ERR_LOST);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(items_are_dealt_once_and_by_share),
        cmocka_unit_test(parts_come_to_all),
        cmocka_unit_test(bytes_are_counted),
        cmocka_unit_test(views_are_computed_once_and_come_to_all),
        cmocka_unit_test(others_do_not_wait_for_a_rank_that_failed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
