/* Equal columns before a wall, photographed from places side by side. A photograph that is placed
 * one column too far has its columns right and its wall wrong. */
#include "core/stereo/contradict.h"

#include "core/base/pool.h"
#include "core/photo/response.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 5, SIZE = 96, PX = SIZE * SIZE };

#define APART 0.1f  // between cameras
#define PERIOD 0.6f // of the columns
#define NEAR 2.0f   // of the columns, depth
#define WALL 5.0f

static struct place {
    struct arena tmp;
    struct run run;
    struct views views;
    struct tonemap tone;
    struct depthmaps maps;
    struct contradict found;
    struct camera cams[VIEWS];
    float log2t[VIEWS], depth[VIEWS * PX], conf[VIEWS * PX];
    uint8_t rgb[3 * VIEWS * PX], masked[VIEWS * PX];
} w;

/* -1..1, another for each lattice point. */
static float lattice(int x, int y)
{
    uint32_t h = (uint32_t)x * 374761393u + (uint32_t)y * 668265263u;
    h = (h ^ (h >> 13)) * 1274126177u;
    return (float)((h ^ (h >> 16)) & 0xffff) / 32767.5f - 1;
}

/* Stops at a place of a surface, whose lattice has an edge of 1. */
static float texture(float x, float y)
{
    const int ix = (int)floorf(x), iy = (int)floorf(y);
    const float fx = x - (float)ix, fy = y - (float)iy;
    const float a = lattice(ix, iy) + fx * (lattice(ix + 1, iy) - lattice(ix, iy));
    const float b = lattice(ix, iy + 1) + fx * (lattice(ix + 1, iy + 1) - lattice(ix, iy + 1));
    return a + fy * (b - a);
}

/* Of the light that a camera at x gets in px (u, v); *z: its depth. */
static float stops_at(float x, float u, float v, float *z)
{
    const float right = (u - SIZE / 2) / SIZE, down = (v - SIZE / 2) / SIZE;
    float along = fmodf(x + NEAR * right + 100 * PERIOD, PERIOD);
    *z = along < 0.3f * PERIOD ? NEAR : WALL;
    return *z < WALL ? texture(20 * along, 15 * NEAR * down)
                     : texture(5 * (x + WALL * right) + 70, 5 * WALL * down);
}

/* Photograph and depth of a view whose camera stands at x. */
static void photograph(int view, float x)
{
    for (int i = 0; i < PX; i++) {
        float *z = &w.depth[view * PX + i];
        const float stops =
            stops_at(x, (float)(i % SIZE) + 0.5f, (float)(i / SIZE) + 0.5f, z) + w.log2t[view];
        for (int c = 0; c < 3; c++)
            w.rgb[3 * (view * PX + i) + c] =
                (uint8_t)(255 * response_display(&w.tone, c, stops) + 0.5f);
    }
}

static int setup(void **state)
{
    (void)state;
    memset(&w, 0, sizeof w);
    w.run.tmp = &w.tmp;
    w.maps = (struct depthmaps){VIEWS, 1, squares(VIEWS, SIZE), w.depth, w.conf, NULL};
    w.views = (struct views){.n = VIEWS,
                             .size = SIZE,
                             .extent = squares(VIEWS, SIZE),
                             .rgb = w.rgb,
                             .log2t = w.log2t,
                             .cams = w.cams};
    response_srgb(0, &w.tone);
    for (int i = 0; i < VIEWS; i++) {
        w.log2t[i] = i % 2 ? 0.5f : -0.5f;
        w.cams[i] = (struct camera){.w = SIZE,
                                    .h = SIZE,
                                    .fx = SIZE,
                                    .fy = SIZE,
                                    .cx = SIZE / 2,
                                    .cy = SIZE / 2,
                                    .q = {1, 0, 0, 0},
                                    .t = {-APART * (float)i, 0, 0}};
        photograph(i, APART * (float)i);
    }
    for (int k = 0; k < VIEWS * PX; k++)
        w.conf[k] = 1;
    return arena_init(&w.tmp, "tmp", 4 << 20);
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&w.tmp);
    return 0;
}

static void judge(void)
{
    assert_int_equal(contradict_run(&w.run, &w.views, &w.tone, &w.maps, &w.found), OK);
}

/* The photograph of a view comes from one column farther than its camera; stereo confirms the
 * columns only, and guesses the rest. */
static void misplace(int view)
{
    photograph(view, APART * (float)view + PERIOD);
    for (int k = view * PX; k < (view + 1) * PX; k++)
        if (w.depth[k] >= WALL) {
            w.depth[k] = 1.5f * NEAR;
            w.conf[k] = 0.1f;
        }
}

/* Something else covers columns of the photograph, and stereo knows nothing there. */
static void pass_by(int view, int first, int end)
{
    for (int i = 0; i < PX; i++) {
        const int at = view * PX + i, x = i % SIZE, y = i / SIZE;
        if (x < first || x >= end)
            continue;
        for (int c = 0; c < 3; c++)
            w.rgb[3 * at + c] = (uint8_t)(128 + 90 * lattice(x / 3 + 99, y / 3 + view));
        w.depth[at] = 0.7f * NEAR;
        w.conf[at] = 0.1f;
    }
}

static void assert_wrong(int view)
{
    for (int i = 0; i < VIEWS; i++)
        assert_int_equal(w.found.wrong[i], i == view);
    assert_int_equal(w.found.n_wrong, view >= 0);
}

static void test_right_places_do_not_contradict(void **state)
{
    (void)state;
    judge();
    assert_wrong(-1);
    assert_true(w.found.median == 0);
}

static void test_the_misplaced_photograph_is_told(void **state)
{
    (void)state;
    misplace(3);
    judge();
    assert_wrong(3);
    assert_true(w.found.of_view[3] > CONTRADICT_VIEW);
    assert_true(w.found.median == 0);
}

/* A part of the picture of four of five is another one, here on the left and there on the right. */
static void test_contradictions_in_most_views_are_told(void **state)
{
    (void)state;
    for (int i = 0; i < VIEWS - 1; i++)
        pass_by(i, i % 2 ? 3 * SIZE / 4 : 0, i % 2 ? SIZE : SIZE / 4);
    judge();
    assert_wrong(-1);
    assert_true(w.found.median > CONTRADICT_MEDIAN);
}

static void test_who_passes_by_does_not(void **state)
{
    (void)state;
    pass_by(1, 0, SIZE / 3);
    pass_by(4, 0, SIZE / 3);
    judge();
    assert_wrong(-1);
    assert_true(w.found.of_view[1] > 0.1f);
    assert_true(w.found.median < CONTRADICT_MEDIAN);
}

static void test_a_surface_that_is_seen_through_contradicts(void **state)
{
    (void)state;
    photograph(2, 40.5f * PERIOD);
    for (int k = 2 * PX; k < 3 * PX; k++)
        w.depth[k] = 2 * WALL;
    judge();
    assert_wrong(2);
}

/* A wrong match where pictures look the same is stereo's mistake, and none of the place. */
static void test_a_wrong_depth_alone_does_not(void **state)
{
    (void)state;
    for (int k = 2 * PX; k < 3 * PX; k++)
        w.depth[k] *= k % SIZE < SIZE / 2 ? 1.3f : 1;
    judge();
    assert_wrong(-1);
    assert_true(w.found.of_view[2] < 0.02f && w.found.median == 0);
}

/* Stereo knows nothing; a photograph is placed where another one was taken. */
static void test_views_in_one_place_need_no_depth(void **state)
{
    (void)state;
    for (int k = 0; k < VIEWS * PX; k++)
        w.conf[k] = 0.1f;
    w.cams[3].t[0] = w.cams[2].t[0];
    photograph(3, APART * 2);
    judge();
    assert_wrong(-1);
    assert_true(w.found.of_view[3] == 0);
    photograph(3, 40.5f * PERIOD);
    judge();
    assert_int_equal(w.found.n_wrong, 1);
    assert_true(w.found.wrong[2] || w.found.wrong[3]);
}

static void test_what_is_masked_proves_nothing(void **state)
{
    (void)state;
    misplace(3);
    w.views.masked = w.masked;
    for (int i = 0; i < VIEWS; i++)
        memset(w.masked + i * PX, i != 3, PX);
    judge();
    assert_wrong(-1);
    assert_true(w.found.of_view[3] == 0);
}

static void test_who_passes_by_can_be_masked(void **state)
{
    (void)state;
    pass_by(1, 0, SIZE / 3);
    w.views.masked = w.masked;
    for (int k = 0; k < PX; k++)
        w.masked[PX + k] = k % SIZE < SIZE / 3;
    judge();
    assert_wrong(-1);
    assert_true(w.found.of_view[1] < 0.02f);
}

/* All but a small part of what the others show is masked. */
static void test_few_samples_may_be_chance(void **state)
{
    (void)state;
    misplace(3);
    w.views.masked = w.masked;
    for (int k = 0; k < VIEWS * PX; k++)
        w.masked[k] =
            k / PX != 3 && (abs(k % PX / SIZE - SIZE / 2) >= 5 || k % SIZE > 3 * SIZE / 8);
    judge();
    assert_true(w.found.of_view[3] > CONTRADICT_VIEW);
    assert_wrong(-1);
}

static void test_threads_do_not_matter(void **state)
{
    (void)state;
    struct place alone;
    misplace(3);
    judge();
    alone = w;
    assert_int_equal(pool_open(&w.run.pool, 3), OK);
    judge();
    pool_close(w.run.pool);
    assert_true(w.found.of_view[3] > 0 && w.found.median == alone.found.median);
    assert_memory_equal(w.found.of_view, alone.found.of_view, VIEWS * sizeof(float));
}

static void test_the_plan_is_what_it_takes(void **state)
{
    (void)state;
    struct plan p = plan_begin(1);
    contradict_plan(&p, w.maps.extent, VIEWS);
    judge();
    assert_int_equal(p.tmp.peak, w.tmp.peak);
    arena_free(&w.tmp);
    assert_int_equal(arena_init(&w.tmp, "tmp", p.tmp.peak / 2), OK);
    assert_int_equal(contradict_run(&w.run, &w.views, &w.tone, &w.maps, &w.found), ERR_NOMEM);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_right_places_do_not_contradict, setup, teardown),
        cmocka_unit_test_setup_teardown(test_the_misplaced_photograph_is_told, setup, teardown),
        cmocka_unit_test_setup_teardown(test_contradictions_in_most_views_are_told, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(test_who_passes_by_does_not, setup, teardown),
        cmocka_unit_test_setup_teardown(test_a_surface_that_is_seen_through_contradicts, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(test_a_wrong_depth_alone_does_not, setup, teardown),
        cmocka_unit_test_setup_teardown(test_views_in_one_place_need_no_depth, setup, teardown),
        cmocka_unit_test_setup_teardown(test_what_is_masked_proves_nothing, setup, teardown),
        cmocka_unit_test_setup_teardown(test_who_passes_by_can_be_masked, setup, teardown),
        cmocka_unit_test_setup_teardown(test_few_samples_may_be_chance, setup, teardown),
        cmocka_unit_test_setup_teardown(test_threads_do_not_matter, setup, teardown),
        cmocka_unit_test_setup_teardown(test_the_plan_is_what_it_takes, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
