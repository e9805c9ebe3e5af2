/* The whole network at a tiny size: what it refuses, memory as planned, the same bytes for any
 * number of threads, models without some of the heads. Its values are compared in the golden
 * tests. */
#include "core/net/net.h"

#include "tests/unit/core/net/net_world.h"

#include <limits.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 2, SIZE_PX = 42, PIXELS = VIEWS * SIZE_PX * SIZE_PX };

static struct {
    int until; // calls of progress until cancel
    struct tap tap;
    int n_taps;
    uint8_t rgb[3 * PIXELS];
    float log2t[VIEWS];
    struct views v;
    struct prediction out;
} t;

static struct net_world world;

static void count_tap(void *ctx, const struct tap_tensor *tensor)
{
    (void)ctx;
    (void)tensor;
    t.n_taps++;
}

static void stop_later(void *ctx, const char *stage, int done, int total, const char *note)
{
    (void)ctx;
    (void)stage;
    (void)note;
    assert_true(done <= total);
    if (--t.until == 0)
        atomic_store(&world.cancel, true);
}

static void open_world(const struct net_dims *d, enum precision precision, int threads)
{
    memset(&t, 0, sizeof t);
    net_world_bind(&world, d, precision, 0);
    struct plan plan = plan_begin(threads);
    net_plan(&plan, &world.net, VIEWS, SIZE_PX);
    net_world_reserve(&world, &plan, t.rgb, sizeof t.rgb);
    world.r.progress = stop_later;
    t.log2t[0] = -2;
    t.log2t[1] = 2;
    t.v = (struct views){.n = VIEWS, .size = SIZE_PX, .rgb = t.rgb, .log2t = t.log2t};
    t.tap.put = count_tap;
}

static uint64_t hash_prediction(void)
{
    const struct prediction *p = &t.out;
    uint64_t h = net_world_hash(p->geom.pose, VIEWS * NET_POSE * sizeof(float), 1);
    h = net_world_hash(p->geom.depth, PIXELS * sizeof(float), h);
    h = net_world_hash(p->points, 3 * PIXELS * sizeof(float), h);
    h = net_world_hash(p->features, 87 * PIXELS * sizeof(float), h);
    h = net_world_hash(p->confidence, PIXELS * sizeof(float), h);
    return net_world_hash(p->theta, sizeof p->theta, h);
}

static void same_bytes_and_planned_memory(void **state)
{
    static const int threads[] = {1, 2, 7};
    (void)state;
    for (int precision = 0; precision < 3; precision++) {
        uint64_t first = 0;
        for (int i = 0; i < 3; i++) {
            open_world(&small_model_tiny, (enum precision)precision, threads[i]);
            assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
            assert_true(world.keep.peak <= world.keep_plan &&
                        world.keep.peak > 0.99 * (double)world.keep_plan);
            assert_true(world.tmp.peak <= world.tmp_plan &&
                        world.tmp.peak > 0.9 * (double)world.tmp_plan);
            assert_true(world.tmp.used == 0 && t.out.n == PIXELS && !t.out.linear);
            uint64_t h = hash_prediction();
            first = i == 0 ? h : first;
            assert_true(h == first);
            net_world_close(&world);
        }
    }
}

/* A tap changes nothing, and fits the same memory. */
static void tapped(void **state)
{
    (void)state;
    open_world(&small_model_tiny, PRECISION_S8, 2);
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
    memset(t.out.theta + TONE_PARAMS, 0, sizeof t.out.theta - TONE_PARAMS * sizeof(float));
    uint64_t h = hash_prediction();
    arena_reset(&world.keep, 0);
    world.r.tap = &t.tap;
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
    memset(t.out.theta + TONE_PARAMS, 0, sizeof t.out.theta - TONE_PARAMS * sizeof(float));
    assert_true(hash_prediction() == h && t.n_taps > 60);
    net_world_close(&world);
}

/* Points are where cameras and depths put them: back in front of their pixels. */
static void points_project_back(void **state)
{
    (void)state;
    open_world(&small_model_tiny, PRECISION_F32, 1);
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
    for (int v = 0; v < VIEWS; v++) {
        const struct camera *c = t.out.geom.cams + v;
        const float w = c->q[0], x = c->q[1], y = c->q[2], z = c->q[3];
        const float row[3][3] = {
            {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
            {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
            {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
        for (int i = 0; i < SIZE_PX * SIZE_PX; i += 41) {
            int at = v * SIZE_PX * SIZE_PX + i;
            const float *p = t.out.points + 3 * at;
            float q[3];
            for (int k = 0; k < 3; k++)
                q[k] = row[k][0] * p[0] + row[k][1] * p[1] + row[k][2] * p[2] + c->t[k];
            assert_float_equal(q[2], t.out.geom.depth[at], 1e-4 * (1 + (double)q[2]));
            assert_float_equal(c->fx * q[0] / q[2] + c->cx, (i % SIZE_PX), 1e-2);
            assert_float_equal(c->fy * q[1] / q[2] + c->cy, (i / SIZE_PX), 1e-2);
        }
    }
    net_world_close(&world);
}

static void without_appearance(void **state)
{
    struct net_dims d = small_model_tiny;
    (void)state;
    d.appearance = false;
    for (int precision = 0; precision < 3; precision++) {
        open_world(&d, (enum precision)precision, 2);
        t.v.log2t = NULL;
        assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
        assert_true(t.out.linear && t.out.features && t.out.confidence && t.out.points);
        for (int i = 83 * PIXELS; i < 87 * PIXELS; i++)
            assert_true(t.out.features[i] == 0);
        for (int i = 0; i < NET_THETA; i++)
            assert_true(t.out.theta[i] == 0);
        net_world_close(&world);
    }
}

static void without_gaussians(void **state)
{
    struct net_dims d = small_model_tiny;
    (void)state;
    d.appearance = d.gauss = false;
    d.gs_feat = d.hdr = 0;
    memset(d.gs_oc, 0, sizeof d.gs_oc);
    open_world(&d, PRECISION_S8, 2);
    t.v.log2t = NULL;
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
    assert_true(!t.out.features && !t.out.confidence && !t.out.points && t.out.geom.depth);
    net_world_close(&world);
}

static void assert_refused(err_t want)
{
    memset(&t.out, 1, sizeof t.out);
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), want);
    assert_true(!t.out.points && !t.out.geom.cams && t.out.n == 0);
    assert_true(world.keep.used == 0 && world.tmp.used == 0);
}

static void refused(void **state)
{
    (void)state;
    open_world(&small_model_tiny, PRECISION_S8, 1);
    const struct views good = t.v;
    t.v.n = 1;
    assert_refused(ERR_ARG);
    assert_non_null(strstr(err_text(), "2 views"));
    t.v = good;
    t.v.size = 43;
    assert_refused(ERR_ARG);
    t.v.size = 0;
    assert_refused(ERR_ARG);
    t.v = good;
    t.v.n = INT_MAX / SIZE_PX / SIZE_PX + 1;
    assert_refused(ERR_ARG);
    size_t keep, tmp;
    struct plan plan = plan_begin(1);
    net_plan(&plan, &world.net, t.v.n, SIZE_PX);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    assert_true(keep == SIZE_MAX && tmp == SIZE_MAX);
    t.v = good;
    size_t room = world.tmp.size;
    world.tmp.size = world.tmp_plan / 2;
    assert_refused(ERR_NOMEM);
    world.tmp.size = room;
    net_world_close(&world);
}

/* Cancelled in each stage: no call of progress after the next. */
static void cancelled(void **state)
{
    (void)state;
    open_world(&small_model_tiny, PRECISION_S8, 2);
    t.until = INT_MAX;
    assert_int_equal(net_run(&world.r, &world.net, &t.v, &t.out), OK);
    int all = INT_MAX - t.until;
    assert_true(all >= 9 + VIEWS + 1 + VIEWS);
    for (int at = 1; at < all; at++) {
        arena_reset(&world.keep, 0);
        atomic_store(&world.cancel, false);
        t.until = at;
        assert_refused(ERR_CANCELLED);
        assert_true(t.until >= -1);
    }
    net_world_close(&world);
}

/* Each tensor is needed; its name is in the sentence. */
static void missing_tensors(void **state)
{
    struct net net;
    (void)state;
    open_world(&small_model_tiny, PRECISION_F32, 1);
    for (int i = 0; i < world.model.model.n; i++) {
        struct tensor_spec *spec = &world.model.tensors[i].spec;
        char name[NET_NAME_CAP];
        memcpy(name, spec->name, sizeof name);
        spec->name[0] = 'X';
        err_t e = net_bind(&world.model.model, 0, &net);
        if (spec->role == ROLE_PLAIN && strstr(name, ".bias") && e == OK)
            assert_true(i > 0 && world.model.tensors[i - 1].spec.role != ROLE_PLAIN);
        else
            assert_true(e == ERR_FORMAT && strstr(err_text(), name));
        memcpy(spec->name, name, sizeof name);
    }
    net_world_close(&world);
}

static void float_bits(void **state)
{
    struct net net;
    (void)state;
    open_world(&small_model_tiny, PRECISION_S8, 1);
    assert_int_equal(net_bind(&world.model.model, NET_FLOAT_SPECIAL | 64, &net), OK);
    assert_int_equal(net.floats, NET_FLOAT_SPECIAL);
    net_world_close(&world);
    open_world(&small_model_tiny, PRECISION_BF16, 1);
    assert_int_equal(world.net.floats, NET_FLOAT_ALL);
    net_world_close(&world);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(same_bytes_and_planned_memory),
        cmocka_unit_test(tapped),
        cmocka_unit_test(points_project_back),
        cmocka_unit_test(without_appearance),
        cmocka_unit_test(without_gaussians),
        cmocka_unit_test(refused),
        cmocka_unit_test(cancelled),
        cmocka_unit_test(missing_tensors),
        cmocka_unit_test(float_bits),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
