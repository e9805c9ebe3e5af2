/* Every block of keys belongs to one rank, the one of its first token; a rank borrows what its last
 * block lacks, and exactly these rows arrive. */
#include "core/net/deal.h"

#include "core/net/attention.h"
#include "tests/unit/core/base/team_local.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { RANKS = 6 };

static const int shares[][RANKS] = {{1, 1, 1, 1, 1, 1}, {8, 1, 1, 3, 1, 8}, {1, 8, 1, 1, 8, 1}};

static struct team member(int rank, int size, const int *share)
{
    struct team t = {.rank = rank, .size = size};
    memcpy(t.share, share, (size_t)size * sizeof *share);
    return t;
}

static void check_rank(const struct team *t, int n_views, int view_tokens)
{
    const struct deal d = deal_of(t, n_views, view_tokens);
    const int first = d.token[t->rank], end = d.token[t->rank + 1], all = n_views * view_tokens;
    int last = end; // after its last block
    assert_int_equal(first, team_first(t, n_views, t->rank) * view_tokens);
    assert_int_equal(deal_own(&d), end - first);
    for (int i = d.block[t->rank]; i < d.block[t->rank + 1]; i++) {
        assert_in_range(i * ATTENTION_KEYS, first, end - 1);
        last = (i + 1) * ATTENTION_KEYS < all ? (i + 1) * ATTENTION_KEYS : all;
    }
    assert_int_equal(deal_borrowed(&d), last > end ? last - end : 0);
}

static void blocks_belong_to_one_rank(void **state)
{
    static const int tokens[] = {6, 14, 64, 128, 200, 1029};
    (void)state;
    for (int i = 0; i < 6 * 3 * RANKS * 8; i++) {
        const int view_tokens = tokens[i % 6], *share = shares[i / 6 % 3];
        const int size = i / 18 % RANKS + 1, n_views = i / 18 / RANKS + 1;
        for (int rank = 0; rank < size; rank++) {
            const struct team t = member(rank, size, share);
            check_rank(&t, n_views, view_tokens);
        }
    }
    const struct deal alone = deal_of(NULL, 3, 100);
    assert_int_equal(alone.block[1], 3);
    assert_int_equal(deal_own(&alone), 300);
    assert_int_equal(deal_borrowed(&alone), 0);
}

/* ---- borrowing ---- */

struct rows {
    int n_views, view_tokens;
};

/* A row holds the number of its token, twice. */
static err_t borrow(void *ctx, struct team *t)
{
    const struct rows *w = ctx;
    const struct deal d = deal_of(t, w->n_views, w->view_tokens);
    const int own = deal_own(&d), n = own + deal_borrowed(&d), first = d.token[d.rank];
    int *x = calloc(2 * (size_t)n + 2, sizeof *x), wrong = 0;
    if (!x)
        return err_fail(ERR_NOMEM, "no memory");
    for (int i = 0; i < 2 * own; i++)
        x[i] = first + i / 2;
    x[2 * n] = -1;
    err_t e = deal_borrow(&d, t, x, 2 * sizeof *x);
    for (int i = 0; i < 2 * n; i++)
        wrong += x[i] != first + i / 2;
    wrong += x[2 * n] != -1;
    free(x);
    return e || !wrong ? e : err_fail(ERR_FORMAT, "rank %d: %d wrong numbers", d.rank, wrong);
}

static void borrowed_rows_arrive(void **state)
{
    static const struct rows worlds[] = {{6, 14}, {5, 54}, {4, 200}, {3, 1029}, {1, 300}};
    (void)state;
    for (int i = 0; i < 5; i++)
        for (int s = 0; s < 3; s++)
            for (int size = 2; size <= RANKS; size++) {
                struct rows w = worlds[i];
                assert_int_equal(team_local_run(size, shares[s], borrow, &w, NULL), OK);
            }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_belong_to_one_rank),
        cmocka_unit_test(borrowed_rows_arrive),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
