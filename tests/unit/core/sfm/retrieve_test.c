/* Views of some places, each with features of its own among many that all places have: the views
 * of a place come first; views without features harm nobody; threads change nothing. */
#include "core/sfm/retrieve.h"

#include "core/base/cpu.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 40, PLACES = 8, OWN = 60, COMMON = 100, CAP = OWN + COMMON, MOST = 4 };

struct world {
    struct pair_views m;
    struct corner_view view[VIEWS];
    int8_t descriptor[VIEWS][CAP * CORNER_DESCRIPTOR];
    struct kernels k;
    struct arena tmp;
    struct pool *pool;
    struct run run;
};

static struct world w;

/* The feature of a number, with noise of another. */
static void make_feature(uint32_t number, uint32_t noise, int8_t *out)
{
    uint32_t s = number * 2654435761u + 1, t = noise * 2246822519u + 7;
    for (int i = 0; i < CORNER_DESCRIPTOR; i++) {
        s = s * 1664525u + 1013904223u;
        t = t * 1664525u + 1013904223u;
        out[i] = (int8_t)((s >> 28 ? 0 : s >> 22 & 63) + (t >> 30)); // few parts are large
    }
}

/* View i shows place i modulo PLACES; views without features from `empty` on. */
static void open_world(int threads, int empty)
{
    memset(&w, 0, sizeof w);
    kernels_init(&w.k, cpu_detect());
    w.m = (struct pair_views){.k = &w.k, .n = VIEWS, .cap = CAP, .view = w.view};
    for (int i = 0; i < VIEWS; i++) {
        w.view[i].descriptor[0] = w.descriptor[i];
        w.view[i].n = i < empty ? CAP : 0;
        for (int k = 0; k < CAP; k++) {
            const int number = k < OWN ? 1000 * (i % PLACES + 1) + (k * 7 + i) % OWN : k % 20;
            make_feature((uint32_t)number, (uint32_t)(i * CAP + k),
                         w.descriptor[i] + k * CORNER_DESCRIPTOR);
        }
    }
    struct plan plan = plan_begin(threads);
    retrieve_plan(&plan, &w.m);
    assert_int_equal(arena_init(&w.tmp, "tmp", plan.tmp.peak), OK);
    if (threads > 1)
        assert_int_equal(pool_open(&w.pool, threads), OK);
    w.run = (struct run){.k = &w.k, .pool = w.pool, .tmp = &w.tmp};
}

static void close_world(void)
{
    assert_int_equal(w.tmp.used, 0);
    pool_close(w.pool);
    arena_free(&w.tmp);
}

static void views_of_a_place_come_first(void **state)
{
    int near[3][VIEWS * MOST];
    (void)state;
    for (int threads = 1; threads <= 3; threads++) {
        open_world(threads, VIEWS);
        assert_int_equal(retrieve_run(&w.run, &w.m, MOST, near[threads - 1]), OK);
        assert_in_range(w.tmp.size - w.tmp.peak, 0, ARENA_ALIGN); // sanitizers add a gap
        close_world();
        assert_memory_equal(near[0], near[threads - 1], sizeof near[0]);
    }
    for (int i = 0; i < VIEWS; i++)
        for (int k = 0; k < MOST; k++) {
            const int j = near[0][i * MOST + k];
            assert_true(j != i && j % PLACES == i % PLACES);
            for (int q = 0; q < k; q++)
                assert_int_not_equal(near[0][i * MOST + q], j);
        }
}

static void views_without_features(void **state)
{
    int near[VIEWS * MOST];
    (void)state;
    for (int empty = 0; empty <= VIEWS - PLACES; empty += VIEWS - PLACES) {
        open_world(1, empty);
        assert_int_equal(retrieve_run(&w.run, &w.m, MOST, near), OK);
        for (int i = 0; i < VIEWS * MOST; i++)
            assert_true(near[i] >= 0 && near[i] < VIEWS && near[i] != i / MOST);
        for (int i = 0; i < empty; i++)
            assert_int_equal(near[i * MOST + empty / PLACES - 2] % PLACES, i % PLACES);
        close_world();
    }
}

static void no_memory_and_stop(void **state)
{
    int near[VIEWS * MOST];
    (void)state;
    open_world(1, VIEWS);
    const size_t all = w.tmp.size;
    for (w.tmp.size = 0; w.tmp.size < all - all / 8; w.tmp.size += all / 7)
        assert_int_equal(retrieve_run(&w.run, &w.m, MOST, near), ERR_NOMEM);
    w.tmp.size = all;
    atomic_bool stop = true;
    w.run.cancel = &stop;
    assert_int_equal(retrieve_run(&w.run, &w.m, MOST, near), ERR_CANCELLED);
    close_world();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(views_of_a_place_come_first),
        cmocka_unit_test(views_without_features),
        cmocka_unit_test(no_memory_and_stop),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
