/* Depth by vote of views before a wall at 4: guesses, most of them right, and sure maps. */
#include "core/stereo/consensus.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 5, SIZE = 40, MAP = SIZE / 2, PX = SIZE * SIZE, MPX = MAP * MAP };

static struct world {
    struct arena tmp;
    struct run r;
    struct depthmaps maps;
    struct camera cams[VIEWS];
    float z[VIEWS * MPX], conf[VIEWS * MPX], depth[VIEWS * PX];
} w;

static int setup(void **state)
{
    (void)state;
    memset(&w, 0, sizeof w);
    w.maps = (struct depthmaps){VIEWS, 2, squares(VIEWS, MAP), w.z, w.conf, NULL};
    for (int i = 0; i < VIEWS; i++) { // half a pixel to the side each
        w.cams[i] = (struct camera){
            .w = SIZE, .h = SIZE, .fx = 40, .fy = 40, .cx = 20, .cy = 20, .q = {1, 0, 0, 0}};
        w.cams[i].t[0] = -0.05f * (float)i;
    }
    for (int k = 0; k < VIEWS * PX; k++)
        w.depth[k] = 4;
    for (int k = 0; k < VIEWS * MPX; k++)
        w.z[k] = 1;
    w.r = (struct run){.tmp = &w.tmp};
    struct arena need = arena_counter();
    struct visibility s;
    if (visibility_layout(&s, &need, VIEWS) != OK)
        return -1;
    arena_step(&need, consensus_plan(VIEWS, SIZE, 3));
    return pool_open(&w.r.pool, 3) == OK && arena_init(&w.tmp, "tmp", need.peak) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    pool_close(w.r.pool);
    arena_free(&w.tmp);
    return 0;
}

static void vote(int views)
{
    struct visibility s;
    w.maps.n = views;
    assert_int_equal(visibility_layout(&s, w.r.tmp, w.maps.n), OK);
    visibility_set(&s, &w.maps, w.cams);
    assert_int_equal(consensus_run(&w.r, &s, w.depth), OK);
    arena_reset(&w.tmp, 0);
}

static bool inner(int k)
{
    const int x = k % SIZE, y = k % PX / SIZE;
    return x >= 4 && y >= 4 && x < SIZE - 4 && y < SIZE - 4;
}

static void one_view_that_errs_is_outvoted(void **state)
{
    (void)state;
    for (int k = 0; k < PX; k++)
        w.depth[2 * PX + k] = k % SIZE < SIZE / 2 ? 7 : 4.4f;
    vote(VIEWS);
    for (int k = 0; k < VIEWS * PX; k++)
        assert_true(!inner(k) || w.depth[k] == 4);
}

/* View 4 alone is sure, of its left half, and all others guess alike. */
static void who_is_sure_decides_against_any_number(void **state)
{
    (void)state;
    int moved = 0;
    for (int k = 0; k < MPX; k++) {
        w.z[4 * MPX + k] = 5;
        w.conf[4 * MPX + k] = k % MAP < MAP / 2 ? 0.6f : 0.5f;
    }
    vote(VIEWS);
    for (int k = 0; k < VIEWS * PX; k++) {
        const int x = k % SIZE;
        if (k >= 4 * PX)
            assert_true(w.depth[k] == (x < SIZE / 2 ? 5 : 4));
        else if (inner(k) && fabsf((float)(x - SIZE / 2)) > 4) // but where none of its pixels lands
            assert_true(w.depth[k] == 4 || (x < SIZE / 2 && fabsf(w.depth[k] - 5) < 1e-5f));
        moved += k < 4 * PX && w.depth[k] > 4.5f;
    }
    print_message("  %d of %d moved\n", moved, 2 * PX);
    assert_true(moved > PX);
}

/* Views 1 and 2 see the same with twice the focal length: four pixels of theirs land on one. */
static void the_nearest_point_of_a_view_is_its_vote(void **state)
{
    (void)state;
    for (int i = 1; i < 3; i++) {
        w.cams[i] = w.cams[0];
        w.cams[i].fx = w.cams[i].fy = 80;
        for (int k = 0; k < PX; k++)
            w.depth[i * PX + k] = k % 2 == i % 2 ? 3 : 5;
    }
    vote(3);
    for (int k = 0; k < PX; k++) {
        const int x = k % SIZE, y = k / SIZE;
        const bool shared = x >= 10 && x < 30 && y >= 10 && y < 30;
        assert_true(w.depth[k] == (shared ? 3 : 4));
    }
}

static void what_is_no_depth_is_no_vote_and_stays(void **state)
{
    (void)state;
    const float bad[] = {NAN, INFINITY, 0, -3};
    for (int k = 0; k < 4; k++) {
        w.depth[k * PX + 20 * SIZE + 20] = bad[k];
        for (int i = 0; i < PX; i++)
            if (k != 3 && i % 3 == 0)
                w.depth[4 * PX + i] = bad[k];
    }
    vote(VIEWS);
    for (int k = 0; k < 4; k++) {
        const float z = w.depth[k * PX + 20 * SIZE + 20];
        assert_true(isnan(bad[k]) ? isnan(z) : z == bad[k]);
    }
    for (int k = 0; k < 4 * PX; k++)
        assert_true(k % PX == 20 * SIZE + 20 || w.depth[k] == 4);
}

static void one_view_keeps_its_guess_and_its_map(void **state)
{
    (void)state;
    for (int k = 0; k < MPX / 2; k++)
        w.conf[k] = 1;
    vote(1);
    for (int k = 0; k < PX; k++)
        assert_true(w.depth[k] == (k < PX / 2 ? 1 : 4));
}

static void the_number_of_threads_changes_nothing(void **state)
{
    (void)state;
    static float start[VIEWS * PX], many[VIEWS * PX];
    for (int k = 0; k < VIEWS * PX; k++)
        start[k] = 4 + sinf((float)k * 0.7f);
    memcpy(w.depth, start, sizeof start);
    vote(VIEWS);
    memcpy(many, w.depth, sizeof many);
    memcpy(w.depth, start, sizeof start);
    struct pool *pool = w.r.pool;
    w.r.pool = NULL;
    vote(VIEWS);
    w.r.pool = pool;
    assert_memory_equal(w.depth, many, sizeof many);
}

static void too_little_memory_is_said(void **state)
{
    (void)state;
    struct visibility s;
    struct arena small = {0};
    struct run r = w.r;
    assert_int_equal(visibility_layout(&s, w.r.tmp, w.maps.n), OK);
    visibility_set(&s, &w.maps, w.cams);
    assert_int_equal(arena_init(&small, "tmp", consensus_plan(VIEWS, SIZE, 3) / 2), OK);
    r.tmp = &small;
    assert_int_equal(consensus_run(&r, &s, w.depth), ERR_NOMEM);
    assert_int_equal(arena_mark(&small), 0);
    arena_free(&small);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(one_view_that_errs_is_outvoted, setup, teardown),
        cmocka_unit_test_setup_teardown(who_is_sure_decides_against_any_number, setup, teardown),
        cmocka_unit_test_setup_teardown(what_is_no_depth_is_no_vote_and_stays, setup, teardown),
        cmocka_unit_test_setup_teardown(one_view_keeps_its_guess_and_its_map, setup, teardown),
        cmocka_unit_test_setup_teardown(the_nearest_point_of_a_view_is_its_vote, setup, teardown),
        cmocka_unit_test_setup_teardown(the_number_of_threads_changes_nothing, setup, teardown),
        cmocka_unit_test_setup_teardown(too_little_memory_is_said, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
