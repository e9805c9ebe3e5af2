/* The best tokens of every patch in every view, and their shares, against sums in double; a patch
 * whose attention is all elsewhere; memory as planned; the same bytes for any number of threads. */
#include "core/net/shared_attention.h"

#include "tests/unit/core/net/heads_ref.h"

enum {
    M = REF_GRID * REF_GRID,
    P = M + NET_SPECIAL,
    KEYS = REF_VIEWS * P,
    PAIRS = REF_VIEWS * M * REF_VIEWS * CORRESPONDENCE_BEST
};

static struct correspondence found;

static void search(int threads)
{
    size_t keep, tmp;
    ref_open(&ref_dims, PRECISION_F32, threads);
    struct plan plan = plan_begin(threads);
    shared_attention_plan(&plan, &ref.net.d, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
}

/* Mean over the heads of the softmax of `row`, over all keys. */
static void attention_of(int row, double out[KEYS])
{
    const int width = ref.net.d.embed / ref.net.d.heads;
    memset(out, 0, KEYS * sizeof *out);
    for (int h = 0; h < ref.net.d.heads; h++) {
        double e[KEYS], top = -INFINITY, sum = 0;
        for (int k = 0; k < KEYS; k++) {
            e[k] = 0;
            for (int i = 0; i < width; i++)
                e[k] += (double)ref.tokens.q[(h * KEYS + row) * width + i] *
                        (double)ref.tokens.k[(h * KEYS + k) * width + i] / 8;
            top = fmax(top, e[k]);
        }
        for (int k = 0; k < KEYS; k++)
            sum += exp(e[k] - top);
        for (int k = 0; k < KEYS; k++)
            out[k] += exp(e[k] - top) / sum / ref.net.d.heads;
    }
}

static void check_pair(const double *weight, const int16_t *token, const float *share)
{
    double all = 0, last = INFINITY;
    for (int i = 0; i < M; i++)
        all += weight[i];
    for (int k = 0; k < CORRESPONDENCE_BEST; k++) {
        int larger = 0;
        assert_in_range(token[k], 0, M - 1);
        for (int i = 0; i < M; i++)
            larger += weight[i] > weight[token[k]] * (1 + 1e-5);
        assert_true(larger <= k);
        assert_true(weight[token[k]] <= last * (1 + 1e-5));
        last = weight[token[k]];
        assert_float_equal(share[k], last / all, 1e-5);
    }
}

static void equals_sums_in_double(void **state)
{
    double weight[KEYS];
    (void)state;
    search(2);
    assert_int_equal(shared_attention_run(&ref.r, &ref.net.d, &ref.tokens, &found), OK);
    assert_true(found.n_views == REF_VIEWS && found.grid == REF_GRID);
    for (int query = 0; query < REF_VIEWS * M; query++) {
        attention_of(query / M * P + NET_SPECIAL + query % M, weight);
        for (int v = 0; v < REF_VIEWS; v++) {
            const int at = (query * REF_VIEWS + v) * CORRESPONDENCE_BEST;
            check_pair(weight + v * P + NET_SPECIAL, found.token + at, found.share + at);
        }
    }
    assert_true(ref.tmp.used == 0);
    ref_close();
}

/* All attention to the first special token of view 0: shares are finite, none is above 1. */
static void attention_elsewhere(void **state)
{
    (void)state;
    search(1);
    for (int h = 0; h < ref.net.d.heads; h++)
        for (int i = 0; i < 16; i++) {
            for (int row = 0; row < KEYS; row++)
                ref.tokens.q[(h * KEYS + row) * 16 + i] = 1000;
            for (int row = 0; row < KEYS; row++)
                ref.tokens.k[(h * KEYS + row) * 16 + i] = row == 0 ? 1000 : -1000;
        }
    assert_int_equal(shared_attention_run(&ref.r, &ref.net.d, &ref.tokens, &found), OK);
    for (int i = 0; i < PAIRS; i++)
        assert_true(found.token[i] < M && found.share[i] >= 0 && found.share[i] <= 1);
    ref_close();
}

static void any_number_of_threads(void **state)
{
    static int16_t token[PAIRS];
    static float share[PAIRS];
    static const int threads[] = {1, 2, 7};
    (void)state;
    for (int i = 0; i < 3; i++) {
        search(threads[i]);
        assert_int_equal(shared_attention_run(&ref.r, &ref.net.d, &ref.tokens, &found), OK);
        if (i > 0) {
            assert_memory_equal(token, found.token, sizeof token);
            assert_memory_equal(share, found.share, sizeof share);
        }
        memcpy(token, found.token, sizeof token);
        memcpy(share, found.share, sizeof share);
        ref_close();
    }
}

static void cancelled(void **state)
{
    (void)state;
    search(2);
    atomic_store(&ref.cancel, true);
    assert_int_equal(shared_attention_run(&ref.r, &ref.net.d, &ref.tokens, &found), ERR_CANCELLED);
    assert_true(!found.token && ref.keep.used == 0 && ref.tmp.used == 0);
    ref_close();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(equals_sums_in_double), cmocka_unit_test(attention_elsewhere),
        cmocka_unit_test(any_number_of_threads), cmocka_unit_test(cancelled)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
