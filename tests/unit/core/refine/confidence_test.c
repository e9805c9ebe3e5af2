/* A wall of splats before three cameras, one of which looks elsewhere, and a card that hides some of
 * it. */
#include "core/refine/confidence.h"

#include "core/base/cpu.h"
#include "core/base/gaussians.h"
#include "core/base/num.h"
#include "core/base/shell.h"
#include "core/sfm/pose.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 40, WALL = SIDE * SIDE, CARD = 100, SKY = WALL + CARD, N = SKY + 1, CAP = 1712 };

static struct world {
    struct arena keep, tmp;
    struct kernels k;
    struct run r;
    struct scene s;
    struct camera cams[3];
    struct confidence c;
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
    put_splat(SKY, 0, -shell.radius * 0.45f, shell.radius, shell.radius * 0.01f);
    assert_int_equal(confidence_init(&w.c, &w.keep, CAP), OK);
    assert_int_equal(confidence_run(&w.r, &w.c, &w.s), OK);
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

static double formula(int n, double degrees)
{
    return (1 - pow(2, 1 - n)) * degrees * degrees / (degrees * degrees + 4);
}

static void test_values(void **state)
{
    (void)state;
    open_world(1, (const float[3]){-1, 0, 1});
    const double turn = 180 / NUM_PI;
    /* seen by all three; their rays spread like those of two at +-a */
    const float *seen = w.c.seen;
    assert_int_equal((int)seen[wall_at(0.05f, 0.95f)], 3);
    assert_true(fabsf(confidence_of(&w.c, wall_at(0.05f, 0.95f)) - (float)formula(3, 22)) < 0.02f);
    /* the left edge of the wall is outside the right camera */
    assert_int_equal((int)seen[wall_at(-1.45f, 0.95f)], 2);
    const double a = atan(1.45 / 4.11) - atan(0.45 / 4.11);
    assert_true(fabsf(confidence_of(&w.c, wall_at(-1.45f, 0.95f)) - (float)formula(2, a * turn)) <
                0.02f);
    /* the card hides this from the middle camera */
    assert_int_equal((int)seen[wall_at(0.05f, -0.55f)], 2);
    assert_int_equal((int)seen[SKY], 3);
    assert_true(fabsf(confidence_of(&w.c, SKY) - 0.75f) < 0.01f);
    close_world();
}

/* One photograph, and cameras in one place, prove nothing. */
static void test_guesses(void **state)
{
    (void)state;
    open_world(1, (const float[3]){0, 0, 0});
    assert_int_equal((int)w.c.seen[wall_at(0.05f, 0.95f)], 3);
    assert_true(confidence_of(&w.c, wall_at(0.05f, 0.95f)) < 1e-3f);
    close_world();
    open_world(1, (const float[3]){0, 40, -40});
    assert_int_equal((int)w.c.seen[wall_at(0.05f, 0.95f)], 1);
    assert_true(confidence_of(&w.c, wall_at(0.05f, 0.95f)) == 0);
    close_world();
}

/* Drawn, it is the confidence of pixels. */
static void test_drawn(void **state)
{
    (void)state;
    static float radiance[3 * 128 * 128], alpha[128 * 128];
    struct raster rs;
    open_world(2, (const float[3]){-1, 0, 1});
    const struct raster_input in = {&w.c.g, &w.cams[1], {0, 0, 0}};
    struct render out = {0, 0, radiance, NULL, alpha};
    assert_int_equal(raster_init(&rs, &w.tmp, CAP, 128, 128, false), OK);
    assert_int_equal(raster_run(&w.r, &rs, &in, &out), OK);
    const int at = 94 * 128 + 65;
    assert_true(fabsf(radiance[at] / alpha[at] - confidence_of(&w.c, wall_at(0.05f, 0.95f))) <
                0.03f);
    close_world();
}

static void test_same_for_any_number_of_threads(void **state)
{
    (void)state;
    static float first[N];
    for (int threads = 1; threads <= 3; threads += 2) {
        open_world(threads, (const float[3]){-1, 0.3f, 1});
        if (threads == 1)
            memcpy(first, w.c.g.plane[G_SH], sizeof first);
        else
            assert_memory_equal(first, w.c.g.plane[G_SH], sizeof first);
        close_world();
    }
}

/* Cameras that leave the right of the wall to one of them, and cameras that have seen all. */
static void test_advice(void **state)
{
    (void)state;
    struct confidence_advice a;
    open_world(2, (const float[3]){-1.2f, -0.9f, -0.6f});
    assert_int_equal(confidence_advise(&w.r, &w.c, &w.s, &a), OK);
    print_message("  %d degrees to the %s of view %d: %.3f\n", CONFIDENCE_STEP,
                  a.way == CONFIDENCE_RIGHT ? "right" : "other side", a.near, (double)a.gain);
    assert_int_equal(a.way, CONFIDENCE_RIGHT);
    assert_int_equal(a.near, 2);
    assert_true(a.gain > 0.05f && a.gain < 1);
    close_world();
    /* nothing to see from anywhere */
    open_world(1, (const float[3]){-1, 0, 1});
    w.s.g.n = 0;
    assert_int_equal(confidence_run(&w.r, &w.c, &w.s), OK);
    assert_int_equal(confidence_advise(&w.r, &w.c, &w.s, &a), OK);
    assert_int_equal(a.near, -1);
    close_world();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values), cmocka_unit_test(test_guesses),
        cmocka_unit_test(test_drawn),  cmocka_unit_test(test_same_for_any_number_of_threads),
        cmocka_unit_test(test_advice),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
