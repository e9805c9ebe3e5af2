/* Positions and angles against the figures of core/net/README.md 2.1; the backbone of a tiny
 * network: memory as planned, the same bytes for any number of threads, cancellation. Its values
 * are compared in the golden tests. */
#include "core/net/backbone.h"
#include "core/net/net.h"

#include "core/net/block.h"
#include "core/net/tap.h"
#include "tests/unit/core/net/net_world.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct net_dims tiny; // small_model_tiny with layers that differ, see make_dims

/* ---- positions ---- */

/* Weights of the rows of output 0 and 1 at 32 x 32 (core/net/README.md 2.1, point 3): a grid that
 * is 1 in row j alone shows the weight of j. */
static void positions_of_448(void **state)
{
    static const float want[2][4] = {{0.88127266f, 0.15239736f, -0.03367002f, 0},
                                     {-0.02530379f, 0.78374583f, 0.29234094f, -0.05078298f}};
    static float grid[NET_POS_GRID * NET_POS_GRID * 8], out[32 * 32 * 8];
    (void)state;
    for (int i = 0; i < NET_POS_GRID * NET_POS_GRID; i++) {
        int y = i / NET_POS_GRID, x = i % NET_POS_GRID;
        if (y < 4)
            grid[8 * i + y] = 1;
        if (x < 4)
            grid[8 * i + 4 + x] = 1;
    }
    backbone_positions(grid, 8, 32, out);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 4; j++)
            for (int other = 0; other < 32; other += 31) {
                assert_float_equal(out[8 * (i * 32 + other) + j], want[i][j], 2e-7f);
                assert_float_equal(out[8 * (other * 32 + i) + 4 + j], want[i][j], 2e-7f);
            }
}

/* A grid of its own size stays as it is; a linear one stays linear inside, nearly so where the taps
 * of a coarse grid are few; one patch sees the whole grid. */
static void positions_of_other_sizes(void **state)
{
    static float grid[NET_POS_GRID * NET_POS_GRID], out[50 * 50];
    (void)state;
    for (int i = 0; i < NET_POS_GRID * NET_POS_GRID; i++)
        grid[i] = (float)(i % NET_POS_GRID) - 18 + 3 * (float)(i / NET_POS_GRID - 18);
    backbone_positions(grid, 1, NET_POS_GRID, out);
    assert_memory_equal(out, grid, sizeof grid);
    for (int n = 20; n <= 50; n += 30) {
        backbone_positions(grid, 1, n, out);
        for (int i = 5; i < n - 5; i++) {
            double y = (i + 0.5) * NET_POS_GRID / n - 0.5 - 18;
            assert_float_equal(out[i * n + i], 4 * y, n < NET_POS_GRID ? 0.1 : 1e-4);
        }
    }
    backbone_positions(grid, 1, 1, out);
    assert_float_equal(out[0], 0, 1e-5);
}

/* ---- angles ---- */

static void exact_angles(void **state)
{
    enum { N = 32, HALF = 32 };
    static float c[(NET_SPECIAL + N * N) * HALF], s[(NET_SPECIAL + N * N) * HALF];
    (void)state;
    backbone_angles(N, 2 * HALF, false, c, s);
    for (int i = 0; i < NET_SPECIAL * HALF; i++)
        assert_true(c[i] == 1 && s[i] == 0);
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++)
            for (int i = 0; i < HALF; i++) {
                int at = (NET_SPECIAL + y * N + x) * HALF + i;
                double angle = (i < 16 ? y + 1 : x + 1) * pow(100, -(i % 16) / 16.0);
                assert_float_equal(c[at], cos(angle), 5e-6);
                assert_float_equal(s[at], sin(angle), 5e-6);
            }
}

/* core/net/README.md 1.2: frequencies of bf16, and the largest error that rounding the products
 * makes. */
static void rounded_angles(void **state)
{
    static const double want[16] = {1,
                                    .75,
                                    .5625,
                                    .421875,
                                    .31640625,
                                    .2373046875,
                                    .177734375,
                                    .1337890625,
                                    .10009765625,
                                    .0751953125,
                                    .05615234375,
                                    .042236328125,
                                    .03173828125,
                                    .023681640625,
                                    .017822265625,
                                    .0133056640625};
    enum { N = 32, HALF = 32 };
    static float c[(NET_SPECIAL + N * N) * HALF], s[(NET_SPECIAL + N * N) * HALF];
    double largest = 0;
    (void)state;
    backbone_angles(N, 2 * HALF, true, c, s);
    for (int i = 0; i < 16; i++) // the first patch: angle = frequency
        assert_float_equal(s[NET_SPECIAL * HALF + i], sin(want[i]), 1e-7);
    for (int y = 0; y < N; y++)
        for (int i = 0; i < 16; i++) {
            int at = (NET_SPECIAL + y * N) * HALF + i;
            double exact = (y + 1) * pow(100, -i / 16.0);
            double turned = c[at] * sin(exact) - s[at] * cos(exact);
            if (y < 31) // the note speaks of positions up to 31
                largest = fmax(largest, fabs(asin(turned)));
        }
    assert_float_equal(largest, 0.067, 0.0005);
}

/* ---- the whole ---- */

enum { VIEWS = 3, SIZE_PX = 56, NAMES_MAX = 64 };

static struct {
    struct tap tap;
    uint8_t rgb[VIEWS * 3 * 70 * 70];
    struct views v;
    struct tokens tokens;
    int n_taps, cancel_at;
} t;

static struct net_world world;

static void count_tap(void *ctx, const struct tap_tensor *tensor)
{
    (void)ctx;
    (void)tensor;
    t.n_taps++;
}

static void count_blocks(void *ctx, const char *stage, int done, int total, const char *note)
{
    (void)ctx;
    (void)note;
    assert_string_equal(stage, "backbone");
    assert_int_equal(total, tiny.dino_depth + 2 * tiny.depth);
    if (done == t.cancel_at)
        atomic_store(&world.cancel, true);
}

static void open_world(enum precision precision, unsigned floats, int size, int threads)
{
    memset(&t, 0, sizeof t);
    net_world_bind(&world, &tiny, precision, floats);
    struct plan plan = plan_begin(threads);
    backbone_plan(&plan, &world.net, VIEWS, size);
    net_world_reserve(&world, &plan, t.rgb, sizeof t.rgb);
    world.r.progress = count_blocks;
    t.v = (struct views){.n = VIEWS, .size = size, .rgb = t.rgb};
}

static uint64_t hash_tokens(void)
{
    size_t n = (size_t)t.tokens.n_views * (size_t)t.tokens.n_tokens * (size_t)t.tokens.embed;
    uint64_t h = 0xCBF29CE484222325u;
    for (int k = 0; k < NET_KEEP; k++)
        h = net_world_hash(t.tokens.keep[k], 2 * n * sizeof(float), h);
    h = net_world_hash(t.tokens.q, n * sizeof(float), h);
    return net_world_hash(t.tokens.k, n * sizeof(float), h);
}

static void plan_is_what_it_takes(void **state)
{
    (void)state;
    for (int size = 14; size <= 70; size += 56)
        for (unsigned floats = 0; floats <= NET_FLOAT_ALL; floats += NET_FLOAT_ALL)
            for (int threads = 1; threads <= 3; threads += 2) {
                open_world(PRECISION_S8, floats, size, threads);
                assert_int_equal(backbone_run(&world.r, &world.net, &t.v, &t.tokens), OK);
                assert_true(world.keep.peak == world.keep_plan);
                assert_true(world.tmp.peak <= world.tmp_plan &&
                            world.tmp.peak > 0.9 * (double)world.tmp_plan);
                assert_true(world.tmp.used == 0);
                net_world_close(&world);
            }
}

static void same_bytes_for_any_threads(void **state)
{
    static const enum precision precisions[] = {PRECISION_F32, PRECISION_BF16, PRECISION_S8};
    static const int threads[] = {1, 2, 7};
    (void)state;
    for (int p = 0; p < 3; p++) {
        uint64_t first = 0;
        for (int i = 0; i < 3; i++) {
            open_world(precisions[p], NET_FLOAT_SPECIAL, SIZE_PX, threads[i]);
            assert_int_equal(backbone_run(&world.r, &world.net, &t.v, &t.tokens), OK);
            uint64_t h = hash_tokens();
            first = i == 0 ? h : first;
            assert_true(h == first);
            net_world_close(&world);
        }
    }
}

enum { ROWS = VIEWS * (NET_SPECIAL + SIZE_PX * SIZE_PX / NET_PATCH / NET_PATCH) };

/* Kept layers of a run. */
struct kept {
    float x[NET_KEEP][ROWS * 128];
};

static void keep_run(enum precision precision, unsigned floats, struct kept *out)
{
    open_world(precision, floats, SIZE_PX, 1);
    assert_int_equal(backbone_run(&world.r, &world.net, &t.v, &t.tokens), OK);
    assert_true(2 * tiny.embed == 128 && t.tokens.n_tokens * VIEWS == ROWS);
    for (int k = 0; k < NET_KEEP; k++)
        memcpy(out->x[k], t.tokens.keep[k], sizeof out->x[k]);
    net_world_close(&world);
}

/* Relative difference of layer k of two runs, over all tokens or the special ones. */
static double deviation(const struct kept *a, const struct kept *b, int k, bool special)
{
    double error = 0, all = 0;
    for (int i = 0; i < ROWS * 128; i++) {
        double x = a->x[k][i], y = b->x[k][i];
        if (special && i / 128 % (ROWS / VIEWS) >= NET_SPECIAL)
            continue;
        error += (x - y) * (x - y);
        all += x * x;
    }
    return sqrt(error / all);
}

/* Effect of keeping parts of an I8 network in floats. */
static void floats_help(void **state)
{
    static struct kept want, plain, special, attention, blocks, both;
    const int last = NET_KEEP - 1;
    (void)state;
    keep_run(PRECISION_F32, 0, &want);
    keep_run(PRECISION_S8, 0, &plain);
    keep_run(PRECISION_S8, NET_FLOAT_SPECIAL, &special);
    keep_run(PRECISION_S8, NET_FLOAT_ATTENTION, &attention);
    keep_run(PRECISION_S8, NET_FLOAT_BLOCKS, &blocks);
    keep_run(PRECISION_S8, NET_FLOAT_BLOCKS | NET_FLOAT_ATTENTION, &both);
    double worst = deviation(&want, &plain, last, false);
    assert_true(worst > 0.005 && worst < 0.05);
    assert_true(deviation(&want, &blocks, last, false) < 0.8 * worst);
    assert_true(deviation(&want, &both, last, false) < 0.6 * worst);
    assert_true(deviation(&want, &attention, last, false) < 1.1 * worst);
    assert_true(deviation(&plain, &attention, 0, false) > 1e-4);
    assert_true(deviation(&blocks, &special, last, false) > 1e-3);
    assert_true(deviation(&want, &special, 0, true) < 0.95 * deviation(&want, &plain, 0, true));
}

static void cancelled(void **state)
{
    (void)state;
    for (int at = 0; at < 8; at += 3) {
        open_world(PRECISION_S8, 0, SIZE_PX, 2);
        t.cancel_at = at;
        atomic_store(&world.cancel, at == 0);
        assert_int_equal(backbone_run(&world.r, &world.net, &t.v, &t.tokens), ERR_CANCELLED);
        assert_true(world.tmp.used == 0);
        net_world_close(&world);
    }
}

static void every_tensor_is_tapped(void **state)
{
    (void)state;
    open_world(PRECISION_F32, 0, SIZE_PX, 1);
    t.tap.put = count_tap;
    world.r.tap = &t.tap;
    assert_int_equal(backbone_run(&world.r, &world.net, &t.v, &t.tokens), OK);
    assert_int_equal(t.n_taps, 3 + tiny.dino_depth + 2 * tiny.depth + NET_KEEP + 2);
    net_world_close(&world);
}

static int make_dims(void **state)
{
    (void)state;
    tiny = small_model_tiny;
    tiny.embed = 64;
    tiny.heads = 4;
    tiny.dino_depth = 2;
    tiny.depth = 5;
    tiny.keep[3] = 4;
    tiny.qk_layer = 3;
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(positions_of_448),
        cmocka_unit_test(positions_of_other_sizes),
        cmocka_unit_test(exact_angles),
        cmocka_unit_test(rounded_angles),
        cmocka_unit_test(plan_is_what_it_takes),
        cmocka_unit_test(same_bytes_for_any_threads),
        cmocka_unit_test(floats_help),
        cmocka_unit_test(cancelled),
        cmocka_unit_test(every_tensor_is_tapped),
    };
    return cmocka_run_group_tests(tests, make_dims, NULL);
}
