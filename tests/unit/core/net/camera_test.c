/* Decoding of poses and its extremes; the camera head of a tiny network: memory as planned, the
 * same bytes for any number of threads. Its values are compared in the golden tests. */
#include "core/net/camera.h"
#include "core/net/net.h"

#include "core/base/cpu.h"
#include "tests/unit/small_model.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---- decoding ---- */

static void assert_rotation(const struct camera *c, const float want[4])
{
    for (int i = 0; i < 4; i++)
        assert_float_equal(c->q[i], want[i], 1e-6);
}

static void ordinary_pose(void **state)
{
    const float pose[NET_POSE] = {1, -2, 3, 0, 0, 3, 4, 1.2f, 0.9f};
    const float want[4] = {0.8f, 0, 0, 0.6f};
    struct camera c;
    (void)state;
    camera_decode(pose, 448, &c);
    assert_true(c.w == 448 && c.h == 448 && c.cx == 224 && c.cy == 224);
    assert_float_equal(c.fy, 224 / (tan(0.6) + 1e-3), 1e-4);
    assert_float_equal(c.fx, 224 / (tan(0.45) + 1e-3), 1e-4);
    assert_true(c.t[0] == 1 && c.t[1] == -2 && c.t[2] == 3);
    assert_rotation(&c, want);
}

/* Length does not matter, sign turns nothing. */
static void quaternions(void **state)
{
    static const float scales[] = {1e-30f, 1e-3f, 1, 1e30f};
    const float turn[4] = {0.5f, 0.5f, 0.5f, 0.5f}, none[4] = {1, 0, 0, 0};
    struct camera c;
    (void)state;
    for (int i = 0; i < 4; i++) {
        const float s = scales[i], pose[NET_POSE] = {0, 0, 0, s, s, s, s, 1, 1};
        camera_decode(pose, 100, &c);
        assert_rotation(&c, turn);
    }
    static const float bad[] = {0, NAN, INFINITY};
    for (int i = 0; i < 3; i++) {
        const float pose[NET_POSE] = {0, 0, 0, bad[i], 0, 0, 0, 1, 1};
        camera_decode(pose, 100, &c);
        assert_rotation(&c, none);
    }
}

static float focal_of(float fov)
{
    const float pose[NET_POSE] = {0, 0, 0, 0, 0, 0, 1, fov, 1};
    struct camera c;
    camera_decode(pose, 448, &c);
    return c.fy;
}

/* At 0 the formula stands, as far as pi it falls, and beyond it stays positive. */
static void fields_of_view(void **state)
{
    const float pi = 3.14159265f;
    (void)state;
    assert_float_equal(focal_of(0), 224000, 0.1);
    assert_float_equal(focal_of(-1), 224000, 0.1);
    assert_float_equal(focal_of(NAN), 224000, 0.1);
    assert_float_equal(focal_of(3), 224 / (tan(1.5) + 1e-3), 1e-3);
    float last = FLT_MAX;
    for (float fov = 0; fov < pi - 2e-3f; fov += 1e-3f) {
        assert_true(focal_of(fov) < last && focal_of(fov) > 0);
        last = focal_of(fov);
    }
    assert_true(focal_of(pi) > 0 && focal_of(pi) < last);
    assert_true(focal_of(4) == focal_of(pi) && focal_of(INFINITY) == focal_of(pi));
}

static void translations_are_finite(void **state)
{
    const float pose[NET_POSE] = {NAN, -INFINITY, 7, 0, 0, 0, 1, 1, 1};
    struct camera c;
    (void)state;
    camera_decode(pose, 448, &c);
    assert_true(c.t[0] == 0 && c.t[1] == 0 && c.t[2] == 7);
}

/* ---- the head ---- */

enum { EMBED = 32, TOKENS = 9, VIEWS_MAX = 70 };

static const struct net_dims tiny = {
    .embed = EMBED,
    .heads = 2,
    .dino_depth = 1,
    .dino_heads = 2,
    .depth = 4,
    .keep = {0, 1, 2, 3},
    .cam_depth = 2,
    .cam_heads = 2,
    .depth_feat = 16,
    .depth_oc = {8, 8, 8, 8},
    .size = 28,
    .voxel = 0.1f,
};

static struct {
    struct small_model model;
    struct net net;
    struct kernels kernels;
    struct arena keep, tmp;
    struct pool *pool;
    atomic_bool cancel;
    struct run r;
    struct tokens tokens;
    float last[VIEWS_MAX * TOKENS * 2 * EMBED];
    struct geometry g;
} t;

static err_t run(enum precision precision, int views, int threads)
{
    size_t keep, tmp;
    memset(&t, 0, sizeof t);
    small_model_init(&t.model, &tiny, precision);
    assert_int_equal(net_bind(&t.model.model, 0, &t.net), OK);
    kernels_init(&t.kernels, cpu_detect());
    struct plan plan = plan_begin(threads);
    camera_plan(&plan, &t.net, views);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    assert_int_equal(arena_init(&t.keep, "keep", keep), OK);
    assert_int_equal(arena_init(&t.tmp, "tmp", tmp), OK);
    assert_int_equal(pool_open(&t.pool, threads), OK);
    t.r = (struct run){.k = &t.kernels, .pool = t.pool, .keep = &t.keep, .tmp = &t.tmp};
    t.tokens = (struct tokens){
        .n_views = views, .grid = 2, .n_tokens = TOKENS, .embed = EMBED, .n_own = views};
    t.tokens.keep[NET_KEEP - 1] = t.last;
    for (size_t i = 0; i < sizeof t.last / sizeof *t.last; i++)
        t.last[i] = (float)(i * 2654435761u % 65536) / 32768 - 1;
    err_t e = camera_run(&t.r, &t.net, &t.tokens, 28, &t.g);
    assert_true(e || (t.keep.peak == keep && t.tmp.peak == tmp));
    assert_true(t.tmp.used == 0);
    return e;
}

static void finish(void)
{
    pool_close(t.pool);
    arena_free(&t.keep);
    arena_free(&t.tmp);
    small_model_free(&t.model);
}

/* Also with more views than a product takes at a time. */
static void same_poses(enum precision precision, int views)
{
    static const int threads[] = {1, 2, 7};
    float pose[VIEWS_MAX * NET_POSE] = {0};
    size_t bytes = (size_t)views * NET_POSE * sizeof *pose;
    for (int i = 0; i < 3; i++) {
        assert_int_equal(run(precision, views, threads[i]), OK);
        assert_true(t.g.n_views == views && t.g.size == 28 && !t.g.depth);
        if (i == 0)
            memcpy(pose, t.g.pose, bytes);
        assert_memory_equal(pose, t.g.pose, bytes);
        finish();
    }
}

static void same_bytes_for_any_threads(void **state)
{
    (void)state;
    for (int p = 0; p < 3; p++) {
        same_poses((enum precision)p, 1);
        same_poses((enum precision)p, 2);
        same_poses((enum precision)p, VIEWS_MAX);
    }
}

/* All views see the same token: they get the same camera, alone or with others. */
static void equal_views(void **state)
{
    float first[NET_POSE];
    (void)state;
    for (int views = 1; views <= 5; views += 4) {
        assert_int_equal(run(PRECISION_F32, views, 1), OK);
        for (int v = 1; v < views; v++)
            memcpy(t.last + v * TOKENS * 2 * EMBED, t.last, 2 * EMBED * sizeof *t.last);
        arena_reset(&t.keep, 0);
        assert_int_equal(camera_run(&t.r, &t.net, &t.tokens, 28, &t.g), OK);
        if (views == 1)
            memcpy(first, t.g.pose, sizeof first);
        for (int v = 0; v < views; v++)
            for (int i = 0; i < NET_POSE; i++)
                assert_float_equal(t.g.pose[v * NET_POSE + i], first[i], 1e-5);
        finish();
    }
}

/* Fields of view stop at 0, everything else may be negative; four rounds add up. */
static void activation(void **state)
{
    float bias[NET_POSE];
    (void)state;
    assert_int_equal(run(PRECISION_F32, 2, 1), OK);
    for (int i = 0; i < NET_POSE; i++)
        bias[i] = -5;
    t.net.camera.fc2.bias = bias;
    arena_reset(&t.keep, 0);
    assert_int_equal(camera_run(&t.r, &t.net, &t.tokens, 28, &t.g), OK);
    for (int i = 0; i < 2 * NET_POSE; i++)
        if (i % NET_POSE < 7)
            assert_float_equal(t.g.pose[i], -20, 2);
        else
            assert_true(t.g.pose[i] == 0);
    finish();
}

static void cancelled(void **state)
{
    (void)state;
    assert_int_equal(run(PRECISION_S8, 2, 2), OK);
    atomic_store(&t.cancel, true);
    t.r.cancel = &t.cancel;
    arena_reset(&t.keep, 0);
    assert_int_equal(camera_run(&t.r, &t.net, &t.tokens, 28, &t.g), ERR_CANCELLED);
    assert_true(t.tmp.used == 0);
    finish();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ordinary_pose),
        cmocka_unit_test(quaternions),
        cmocka_unit_test(fields_of_view),
        cmocka_unit_test(translations_are_finite),
        cmocka_unit_test(same_bytes_for_any_threads),
        cmocka_unit_test(equal_views),
        cmocka_unit_test(activation),
        cmocka_unit_test(cancelled),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
