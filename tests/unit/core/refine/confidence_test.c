/* A wall of splats before three cameras, one of which looks elsewhere, and a card that hides some
 * of it. */
#include "core/refine/confidence.h"

#include "core/base/cpu.h"
#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/shell.h"
#include "core/photo/tonemap.h"
#include "core/splat/raster.h"
#include "tests/unit/core/base/team_local.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum {
    SIDE = 40,
    WALL = SIDE * SIDE,
    CARD = 100,
    SKY = WALL + CARD,
    N = SKY + 1,
    CAP = 1712,
    SIZE = 128,
    PX = SIZE * SIZE
};

static _Thread_local struct world {
    struct arena keep, tmp, exact;
    struct kernels k;
    struct run r;
    struct scene s;
    struct camera cams[3];
    struct views v;
    float log2t[3];
    uint8_t rgb[3 * 3 * PX];
    struct confidence_advice advice;
} w;

static void put_splat(int i, float x, float y, float z, float size)
{
    struct gaussians *g = &w.s.g;
    const float mu[3] = {x, y, z};
    for (int k = 0; k < 3; k++) {
        g->plane[G_MU + k][i] = mu[k];
        g->plane[G_LOG_SCALE + k][i] = logf(size);
    }
    g->plane[G_QUAT][i] = 1;
    g->plane[G_LOGIT][i] = 4;
}

static void draw(const struct gaussians *g, int view, float radiance[3 * PX])
{
    static _Thread_local float alpha[PX];
    struct raster rs;
    const struct raster_input in = {g, &w.cams[view], {0, 0, 0}};
    struct render out = {0, 0, radiance, NULL, alpha};
    const size_t mark = arena_mark(&w.tmp);
    assert_int_equal(raster_init(&rs, &w.tmp, CAP, SIZE, SIZE, false), OK);
    assert_int_equal(raster_run(&w.r, &rs, &in, &out), OK);
    arena_reset(&w.tmp, mark);
}

static void photograph(int view)
{
    static _Thread_local float px[3 * PX];
    struct tonemap_table table;
    tonemap_table_init(&table, &w.s.tone);
    draw(&w.s.g, view, px);
    for (int c = 0; c < 3; c++)
        tonemap_run(&table.c[c], px + c * PX, w.log2t[view], PX, px + c * PX);
    for (int i = 0; i < 3 * PX; i++)
        w.rgb[3 * PX * view + i] = (uint8_t)(255 * px[i % 3 * PX + i / 3] + 0.5f);
}

static void find_confidence(void)
{
    struct plan p = plan_begin(pool_size(w.r.pool));
    confidence_plan(&p, CAP);
    assert_int_equal(arena_init(&w.exact, "exact", p.tmp.peak), OK);
    w.r.tmp = &w.exact;
    assert_int_equal(confidence_run(&w.r, &w.v, &w.s, &w.advice), OK);
    w.r.tmp = &w.tmp;
    arena_free(&w.exact);
}

/* x: positions of the cameras, which look straight at the wall, 4 away. */
static void open_world(int threads, const float x[3])
{
    memset(&w, 0, sizeof w);
    kernels_init(&w.k, cpu_detect());
    assert_int_equal(arena_init(&w.keep, "keep", (size_t)8 << 20), OK);
    assert_int_equal(arena_init(&w.tmp, "tmp", (size_t)8 << 20), OK);
    w.r = (struct run){.k = &w.k, .keep = &w.keep, .tmp = &w.tmp};
    assert_int_equal(pool_open(&w.r.pool, threads), OK);
    assert_int_equal(gaussians_init(&w.s.g, &w.keep, CAP, 0), OK);
    w.s.g.n = N;
    for (int i = 0; i < WALL; i++)
        put_splat(i, ((float)(i % SIDE) - 19.5f) * 0.1f, ((float)(i / SIDE) - 14.5f) * 0.1f, 4,
                  0.05f);
    for (int i = 0; i < CARD; i++) // before the middle camera's upper part of the wall
        put_splat(WALL + i, ((float)(i % 10) - 4.5f) * 0.05f, ((float)(i / 10) - 24.5f) * 0.02f, 2,
                  0.03f);
    w.s.cams = w.cams;
    w.s.n_views = 3;
    for (int i = 0; i < 3; i++) {
        w.cams[i] = (struct camera){128, 128, 128, 128, 64, 64, {1, 0, 0, 0}, {-x[i], 0, 0}};
    }
    const struct shell shell = shell_of(w.cams, 3);
    put_splat(SKY, 0, -shell.radius * 0.45f, shell.radius, shell.radius * 0.1f);
    tonemap_linear(&w.s.tone, 0.7f, -8, 8, 0);
    w.v = (struct views){.n = 3,
                         .size = SIZE,
                         .extent = squares(3, SIZE),
                         .rgb = w.rgb,
                         .log2t = w.log2t,
                         .cams = w.cams};
    for (int i = 0; i < 3; i++)
        photograph(i);
    find_confidence();
}

static void close_world(void)
{
    pool_close(w.r.pool);
    arena_free(&w.keep);
    arena_free(&w.tmp);
}

static int wall_at(float x, float y)
{
    return (int)lrintf(y / 0.1f + 14.5f) * SIDE + (int)lrintf(x / 0.1f + 19.5f);
}

static void expect_confidence(int splat, int n, double degrees)
{
    const double value = (1 - pow(2, 1 - n)) * degrees * degrees / (degrees * degrees + 4);
    print_message("  splat %d: %.4f, expected %.4f\n", splat, (double)w.s.confidence[splat], value);
    assert_true(fabs((double)w.s.confidence[splat] - value) < 0.02);
}

static void test_values(void **state)
{
    (void)state;
    open_world(1, (const float[3]){-1, 0, 1});
    const double turn = 180 / NUM_PI;
    /* seen by all three, whose rays spread like those of two 22 degrees apart */
    expect_confidence(wall_at(0.05f, 0.95f), 3, 22);
    /* the left edge of the wall is outside the right camera */
    expect_confidence(wall_at(-1.45f, 0.95f), 2, (atan(1.45 / 4.11) - atan(0.45 / 4.11)) * turn);
    /* the card hides this from the middle camera */
    expect_confidence(wall_at(0.05f, -0.55f), 2, 2 * atan(1 / 4.04) * turn);
    expect_confidence(SKY, 3, 1e6);
    close_world();
}

/* A photograph that shows something else says nothing. */
static void test_photographs_that_disagree(void **state)
{
    (void)state;
    open_world(1, (const float[3]){-1, 0, 1});
    memset(w.rgb + 3 * PX, 0, 3 * PX); // the middle one
    find_confidence();
    expect_confidence(wall_at(0.05f, 0.95f), 2, 2 * atan(1 / 4.11) * 180 / NUM_PI);
    memset(w.rgb, 0, 3 * PX);
    find_confidence();
    assert_true(w.s.confidence[wall_at(0.05f, 0.95f)] < 0.01f);
    close_world();
}

/* One photograph, and cameras in one place, prove nothing. */
static void test_guesses(void **state)
{
    (void)state;
    open_world(1, (const float[3]){0, 0, 0});
    assert_true(w.s.confidence[wall_at(0.05f, 0.95f)] < 1e-3f);
    close_world();
    open_world(1, (const float[3]){0, 40, -40});
    assert_true(w.s.confidence[wall_at(0.05f, 0.95f)] == 0);
    close_world();
}

/* Drawn, it is the confidence of pixels. */
static void test_drawn(void **state)
{
    (void)state;
    static float colour[CAP], radiance[3 * PX];
    struct gaussians g;
    open_world(2, (const float[3]){-1, 0, 1});
    confidence_splats(&w.s, colour, &g);
    draw(&g, 1, radiance);
    assert_true(fabsf(radiance[94 * SIZE + 65] - w.s.confidence[wall_at(0.05f, 0.95f)]) < 0.05f);
    close_world();
}

static void test_same_for_any_number_of_threads(void **state)
{
    (void)state;
    static float first[N];
    for (int threads = 1; threads <= 3; threads += 2) {
        open_world(threads, (const float[3]){-1, 0.3f, 1});
        if (threads == 1)
            memcpy(first, w.s.confidence, sizeof first);
        else
            assert_memory_equal(first, w.s.confidence, sizeof first);
        close_world();
    }
}

/* Cameras that leave the right of the wall to one of them, and a scene without splats. */
/* A rank tries some places, and must end with the best of all. */
static err_t advise_on_rank(void *ctx, struct team *t)
{
    const struct confidence_advice *alone = ctx;
    const float x[3] = {0, 0.4f, 0.8f};
    open_world(1, x);
    w.r.team = t;
    find_confidence();
    const bool same = memcmp(&w.advice, alone, sizeof *alone) == 0;
    close_world();
    return same ? OK : err_fail(ERR_ARG, "rank %d has other advice", team_rank(t));
}

static void test_same_for_any_number_of_ranks(void **state)
{
    const float x[3] = {0, 0.4f, 0.8f};
    (void)state;
    open_world(2, x);
    find_confidence();
    const struct confidence_advice alone = w.advice;
    close_world();
    assert_true(alone.near >= 0);
    for (int size = 2; size <= 5; size++)
        if (team_local_run(size, NULL, advise_on_rank, (void *)&alone, NULL))
            fail_msg("%s", err_text());
}

static void test_advice(void **state)
{
    (void)state;
    open_world(2, (const float[3]){-1.6f, -0.9f, -0.2f});
    print_message("  way %d of view %d: %.3f\n", w.advice.way, w.advice.near,
                  (double)w.advice.gain);
    assert_int_equal(w.advice.way, CONFIDENCE_RIGHT);
    assert_int_equal(w.advice.near, 2);
    assert_true(w.advice.gain > 0.05f && w.advice.gain < 1);
    double before[3], after[3];
    rotation_centre(&w.cams[2], before);
    rotation_centre(&w.advice.cam, after);
    assert_true(after[0] > before[0] + 1 && fabs(after[1] - before[1]) < 0.01);
    /* a photograph from there that shows something else is not asked for again */
    w.cams[0] = w.advice.cam;
    memset(w.rgb, 0, 3 * PX);
    find_confidence();
    rotation_centre(&w.advice.cam, before);
    print_message("  way %d of view %d: %.3f\n", w.advice.way, w.advice.near,
                  (double)w.advice.gain);
    assert_true(hypot(after[0] - before[0], after[2] - before[2]) > 0.5);
    w.s.g.n = 0;
    find_confidence();
    assert_int_equal(w.advice.near, -1);
    close_world();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values),
        cmocka_unit_test(test_photographs_that_disagree),
        cmocka_unit_test(test_guesses),
        cmocka_unit_test(test_drawn),
        cmocka_unit_test(test_same_for_any_number_of_threads),
        cmocka_unit_test(test_same_for_any_number_of_ranks),
        cmocka_unit_test(test_advice),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
