#include "core/base/pool.h"

#include <limits.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

enum { THREADS_MAX = 8, CHUNKS = 500 };

struct job {
    struct pool *pool;
    int n_workers;
    // Without atomics: TSan sees a chunk run twice, or two threads with one worker number.
    int count[CHUNKS], scratch[THREADS_MAX];
    atomic_int done;
    int fail_from, fail_step; // chunks fail_from, fail_from + fail_step, ... fail; step 0 = none
};

static err_t count_chunk(void *ctx, int chunk, int worker)
{
    struct job *j = ctx;
    if (worker < 0 || worker >= j->n_workers)
        return err_fail(ERR_ARG, "worker %d", worker);
    j->count[chunk]++;
    j->scratch[worker]++;
    atomic_fetch_add(&j->done, 1);
    if (j->fail_step && chunk >= j->fail_from && (chunk - j->fail_from) % j->fail_step == 0)
        return err_fail(ERR_IO, "chunk %d is broken", chunk);
    return OK;
}

static struct job *new_job(int threads)
{
    static struct job j;
    memset(&j, 0, sizeof j);
    assert_int_equal(pool_open(&j.pool, threads), OK);
    j.n_workers = pool_size(j.pool);
    return &j;
}

static void every_chunk_runs_once(void **state)
{
    (void)state;
    for (int threads = 1; threads <= THREADS_MAX; threads++) {
        struct job *j = new_job(threads);
        assert_int_equal(pool_size(j->pool), threads);
        for (int n = 0; n <= CHUNKS; n += n < 20 ? 1 : 60) {
            memset(j->count, 0, sizeof j->count);
            assert_int_equal(pool_for(j->pool, n, count_chunk, j), OK);
            for (int c = 0; c < CHUNKS; c++)
                assert_int_equal(j->count[c], c < n);
        }
        pool_close(j->pool);
    }
}

static void many_tiny_jobs(void **state)
{
    (void)state;
    for (int threads = 2; threads <= THREADS_MAX; threads += 3) {
        struct job *j = new_job(threads);
        for (int i = 0; i < 3000; i++) {
            assert_int_equal(pool_for(j->pool, 3, count_chunk, j), OK);
            if (i % 500 == 0)
                usleep(3000); // long enough for the workers to fall asleep
        }
        assert_int_equal(atomic_load(&j->done), 9000);
        int sum = 0;
        for (int w = 0; w < THREADS_MAX; w++)
            sum += j->scratch[w];
        assert_int_equal(sum, 9000);
        pool_close(j->pool);
    }
}

static void lowest_failure_wins(void **state)
{
    (void)state;
    for (int threads = 1; threads <= THREADS_MAX; threads++) {
        struct job *j = new_job(threads);
        for (int i = 0; i < 200; i++) {
            char want[64];
            j->fail_from = i;
            j->fail_step = 1 + i % 5;
            atomic_store(&j->done, 0);
            assert_int_equal(pool_for(j->pool, CHUNKS, count_chunk, j), ERR_IO);
            snprintf(want, sizeof want, "chunk %d is broken", i);
            assert_string_equal(err_text(), want);
            assert_true(atomic_load(&j->done) > i); // all below the failed one have run
        }
        j->fail_step = 0;
        assert_int_equal(pool_for(j->pool, CHUNKS, count_chunk, j), OK); // nothing stays behind
        pool_close(j->pool);
    }
}

static err_t fail_first(void *ctx, int chunk, int worker)
{
    (void)worker;
    atomic_fetch_add((atomic_int *)ctx, 1);
    return chunk == 0 ? err_fail(ERR_CANCELLED, "stop") : OK;
}

static void failure_stops_a_huge_job(void **state)
{
    (void)state;
    struct pool *p;
    atomic_int started = 0;
    assert_int_equal(pool_open(&p, 4), OK);
    assert_int_equal(pool_for(p, INT_MAX, fail_first, &started), ERR_CANCELLED);
    assert_true(atomic_load(&started) < INT_MAX / 2);
    pool_close(p);
}

struct nested {
    struct pool *pool;
    int outer_worker[CHUNKS], inner_sum[CHUNKS];
    int scratch[THREADS_MAX];
};

struct inner {
    struct nested *n;
    int outer_chunk;
};

static err_t inner_chunk(void *ctx, int chunk, int worker)
{
    struct inner *in = ctx;
    in->n->inner_sum[in->outer_chunk] += chunk;
    in->n->scratch[worker]++;
    if (worker != in->n->outer_worker[in->outer_chunk])
        return err_fail(ERR_ARG, "inner worker %d", worker);
    return in->outer_chunk == 400 && chunk == 7 ? err_fail(ERR_FORMAT, "deep inside") : OK;
}

static err_t outer_chunk(void *ctx, int chunk, int worker)
{
    struct nested *n = ctx;
    struct inner in = {n, chunk};
    n->outer_worker[chunk] = worker;
    return pool_for(n->pool, 10, inner_chunk, &in);
}

static void nested_call_runs_inline_as_the_same_worker(void **state)
{
    (void)state;
    static struct nested n;
    for (int threads = 1; threads <= THREADS_MAX; threads++) {
        memset(&n, 0, sizeof n);
        assert_int_equal(pool_open(&n.pool, threads), OK);
        assert_int_equal(pool_for(n.pool, 400, outer_chunk, &n), OK);
        for (int c = 0; c < 400; c++)
            assert_int_equal(n.inner_sum[c], 45);
        assert_int_equal(pool_for(n.pool, 401, outer_chunk, &n), ERR_FORMAT);
        assert_string_equal(err_text(), "deep inside");
        pool_close(n.pool);
    }
}

static void no_pool_is_one_thread(void **state)
{
    (void)state;
    static struct job j = {.n_workers = 1, .fail_from = 3, .fail_step = 100};
    assert_int_equal(pool_size(NULL), 1);
    assert_int_equal(pool_for(NULL, 10, count_chunk, &j), ERR_IO);
    assert_int_equal(atomic_load(&j.done), 4);
    pool_close(NULL);
}

static void size_is_checked(void **state)
{
    (void)state;
    struct pool *p;
    assert_int_equal(pool_open(&p, -1), ERR_ARG);
    assert_null(p);
    assert_int_equal(pool_open(&p, 65), ERR_ARG);
    assert_non_null(strstr(err_text(), "65"));
    assert_int_equal(pool_open(&p, 64), OK);
    assert_int_equal(pool_size(p), 64);
    pool_close(p);
    assert_int_equal(pool_open(&p, 0), OK);
    assert_true(pool_size(p) >= 1);
    pool_close(p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_chunk_runs_once),
        cmocka_unit_test(many_tiny_jobs),
        cmocka_unit_test(lowest_failure_wins),
        cmocka_unit_test(failure_stops_a_huge_job),
        cmocka_unit_test(nested_call_runs_inline_as_the_same_worker),
        cmocka_unit_test(no_pool_is_one_thread),
        cmocka_unit_test(size_is_checked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
