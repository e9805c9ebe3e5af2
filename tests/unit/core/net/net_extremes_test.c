/* The forward pass at its ends, as a whole: pictures, exposures, sizes and weights of which trained
 * networks and careful photographers know nothing. Whatever comes in, either all that comes out is
 * finite and depths are above 0, or the pass fails and names the stage.
 * Ends of single steps are tested with them: attention (attention_test), poses and fields of view
 * (camera_test), exponents of depths (depth_test), exposures and weights on dropped tokens
 * (appearance_test), packing (pack_test), kernels (tests/kernels/nn_range_test). */
#include "core/net/net.h"

#include "core/base/cpu.h"
#include "tests/unit/small_model.h"
#include "tests/unit/some_of.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

enum { VIEWS_MAX = 4, SIZE_MAX_PX = 210, SIZE_PX = 42 };

/* Weights that are not as they come: those whose names have this part, times a factor or set. */
static struct {
    const char *part;
    enum { AS_IT_IS, TIMES, SET } how;
    float value;

} change;

static struct {
    struct small_model model;
    struct net net;
    struct kernels kernels;
    struct arena keep, tmp;
    struct pool *pool;
    struct run r;
    uint8_t rgb[3 * VIEWS_MAX * SIZE_PX * SIZE_PX], large[3 * 2 * SIZE_MAX_PX * SIZE_MAX_PX];
    float log2t[VIEWS_MAX];
    struct views v;
    struct prediction out;
} t;

static void changed(void *ctx, const struct tensor_spec *spec, float *out)
{
    size_t n = table_count(spec);
    (void)ctx;
    hashed_fill(spec, 1, 0, n, out);
    if (!change.part || !strstr(spec->name, change.part))
        return;
    for (size_t i = 0; i < n; i++)
        out[i] = change.how == SET ? change.value : out[i] * change.value;
}

static void open_world(enum precision precision, int views, int size)
{
    size_t keep, tmp;
    memset(&t, 0, sizeof t);
    small_model_make(&t.model, &small_model_tiny, precision, changed, NULL);
    assert_int_equal(net_bind(&t.model.model, 0, &t.net), OK);
    kernels_init(&t.kernels, cpu_detect());
    struct plan plan = plan_begin(1);
    net_plan(&plan, &t.net, views, size);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    assert_int_equal(arena_init(&t.keep, "keep", keep), OK);
    assert_int_equal(arena_init(&t.tmp, "tmp", tmp), OK);
    assert_int_equal(pool_open(&t.pool, 1), OK);
    t.r = (struct run){.k = &t.kernels, .pool = t.pool, .keep = &t.keep, .tmp = &t.tmp};
    for (size_t i = 0; i < sizeof t.rgb; i++)
        t.rgb[i] = (uint8_t)(i * 2654435761u >> 24);
    for (int i = 0; i < views; i++)
        t.log2t[i] = (float)(2 * i - 1);
    t.v = (struct views){.n = views, .size = size, .rgb = t.rgb, .log2t = t.log2t};
}

static void close_world(void)
{
    pool_close(t.pool);
    arena_free(&t.keep);
    arena_free(&t.tmp);
    small_model_free(&t.model);
}

static void check_geometry(void)
{
    const struct geometry *g = &t.out.geom;
    for (int i = 0; i < g->n_views; i++) {
        const struct camera *c = g->cams + i;
        double q = 0;
        for (int k = 0; k < 4; k++)
            q += (double)c->q[k] * (double)c->q[k];
        if (!(fabs(q - 1) < 1e-5 && isfinite(c->t[0] + c->t[1] + c->t[2]) && c->fx > 0 &&
              c->fy > 0 && isfinite(c->fx + c->fy)))
            fail_msg("%s: camera %d", change.part, i);
    }
    for (int i = 0; i < t.out.n; i++)
        if (!(g->depth[i] > 0 && isfinite(g->depth[i])))
            fail_msg("%s: depth %d is %g", change.part, i, (double)g->depth[i]);
}

static void run(void)
{
    arena_reset(&t.keep, 0);
    if (net_run(&t.r, &t.net, &t.v, &t.out))
        fail_msg("%s: %s", change.part, err_text());
    check_geometry();
}

static bool all_finite(const float *x, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!isfinite(x[i]))
            return false;
    return true;
}

/* Everything is. */
static void assert_finite(const char *what)
{
    const struct prediction *p = &t.out;
    size_t n = (size_t)p->n, poses = (size_t)p->geom.n_views * NET_POSE;
    if (!all_finite(p->geom.pose, poses) || !all_finite(p->points, 3 * n) ||
        !all_finite(p->features, 87 * n) || !all_finite(p->confidence, n) ||
        !all_finite(p->theta, NET_THETA))
        fail_msg("%s: not all finite", what);
}

static const enum precision precisions[] = {PRECISION_F32, PRECISION_BF16, PRECISION_S8};

/* ---- pictures ---- */

static void one_colour(void **state)
{
    static const uint8_t colour[] = {0, 1, 255};
    (void)state;
    for (int p = 0; p < 3; p++) {
        open_world(precisions[p], 2, SIZE_PX);
        for (int c = 0; c < 3; c++) {
            memset(t.rgb, colour[c], sizeof t.rgb);
            run();
            assert_finite("one colour");
        }
        memset(t.rgb + 3 * SIZE_PX * SIZE_PX, 0, 3 * SIZE_PX * SIZE_PX); // white and black
        run();
        assert_finite("white and black");
        close_world();
    }
}

static double difference(const float *a, const float *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += fabs((double)a[i] - (double)b[i]);
    return sum / (double)n;
}

/* One hot pixel in black views is seen where it is. */
static void hot_pixel(void **state)
{
    static float before[87 * 2 * SIZE_PX * SIZE_PX];
    const size_t view = SIZE_PX * SIZE_PX, n = 2 * view, at = 20 * SIZE_PX + 30;
    (void)state;
    for (int p = 0; p < 3; p++) {
        open_world(precisions[p], 2, SIZE_PX);
        memset(t.rgb, 0, sizeof t.rgb);
        run();
        memcpy(before, t.out.features, 87 * n * sizeof(float));
        memset(t.rgb + 3 * at, 255, 3);
        run();
        assert_finite("hot pixel");
        double here = 0, there = 0;
        for (size_t c = 0; c < 83; c++) {
            const float *was = before + c * n, *is = t.out.features + c * n;
            here += difference(was + at, is + at, 1);
            there += difference(was + 38 * SIZE_PX + 2, is + 38 * SIZE_PX + 2, 1);
        }
        assert_true(here > 5 * there && here > 0);
        close_world();
    }
}

/* Views after the first are the same to the network if they show the same: what it says of them is
 * the same, bit by bit. The first one is the origin of its world and has tokens of its own. */
static void one_view_repeated(void **state)
{
    const size_t view = SIZE_PX * SIZE_PX, n = VIEWS_MAX * view;
    (void)state;
    for (int p = 0; p < 3; p++) {
        open_world(precisions[p], VIEWS_MAX, SIZE_PX);
        for (size_t i = 3 * view; i < 3 * n; i++)
            t.rgb[i] = t.rgb[i - 3 * view];
        for (int i = 0; i < VIEWS_MAX; i++)
            t.log2t[i] = 0;
        run();
        assert_finite("repeated");
        const struct geometry *g = &t.out.geom;
        for (int i = 2; i < VIEWS_MAX; i++) {
            assert_memory_equal(g->pose + NET_POSE, g->pose + i * NET_POSE,
                                NET_POSE * sizeof(float));
            assert_memory_equal(g->depth + view, g->depth + (size_t)i * view, view * sizeof(float));
            for (size_t c = 0; c < 87; c++)
                assert_memory_equal(t.out.features + c * n + view,
                                    t.out.features + c * n + (size_t)i * view,
                                    view * sizeof(float));
        }
        assert_true(difference(g->depth, g->depth + view, view) > 0);
        close_world();
    }
}

/* ---- exposures ---- */

/* From the shortest that counts to as much above one; the geometry does not know of them. */
static void exposures(void **state)
{
    static const float pairs[][2] = {{-26.575f, 26}, {26, 26}, {-26.575f, -26.575f}, {0, 1e-6f}};
    static float depth[2 * SIZE_PX * SIZE_PX];
    (void)state;
    for (int p = 0; p < 3; p++) {
        open_world(precisions[p], 2, SIZE_PX);
        for (int i = 0; i < 4; i++) {
            memcpy(t.log2t, pairs[i], sizeof pairs[i]);
            t.v.mid_log2t = (pairs[i][0] + pairs[i][1]) / 2;
            run();
            assert_finite("exposures");
            if (i > 0)
                assert_memory_equal(depth, t.out.geom.depth, sizeof depth);
            memcpy(depth, t.out.geom.depth, sizeof depth);
        }
        close_world();
    }
}

/* ---- sizes ---- */

static void sizes(void **state)
{
    static const int edges[] = {14, 28, 70, 98, 126, 210};
    (void)state;
    for (int p = 0; p < 3; p += 2)
        for (int i = 0; i < 6; i++) {
            open_world(precisions[p], 2, edges[i]);
            for (size_t k = 0; k < sizeof t.large; k++)
                t.large[k] = (uint8_t)(k * 2654435761u >> 24);
            t.v.rgb = t.large;
            run();
            assert_finite("size");
            assert_int_equal(t.out.n, 2 * edges[i] * edges[i]);
            assert_true(t.tmp.peak <= t.tmp.size && t.tmp.peak > t.tmp.size * 9 / 10);
            close_world();
        }
}

/* ---- weights ---- */

/* Layer scales that make the residual stream a thousand times and a million times as large, first
 * layers that make its start so. */
static void large_activations(void **state)
{
    static const char *const parts[] = {".gamma", "patch_embed.patch_embed.proj.weight",
                                        "pos_embed", "camera_token", "norm.weight"};
    (void)state;
    for (int p = 0; p < 3; p++)
        for (int i = 0; i < 5; i++)
            for (int k = 1; k <= 2; k++) {
                change.part = parts[i];
                change.how = TIMES;
                change.value = k == 1 ? 1e3f : 1e6f;
                open_world(precisions[p], 2, SIZE_PX);
                run();
                assert_finite(parts[i]);
                close_world();
            }
    change.part = NULL;
}

struct names {
    int n;
    char name[SMALL_TENSORS_MAX][NET_NAME_CAP];
    bool products; // or plain tensors
};

static err_t collect_tensor(void *ctx, const struct tensor_spec *spec)
{
    struct names *x = ctx;
    if (spec->used && (spec->role != ROLE_PLAIN) == x->products)
        memcpy(x->name[x->n++], spec->name, NET_NAME_CAP);
    return OK;
}

/* Either all is finite, or the pass fails and says where; whether it fails. */
static bool run_or_refuse(void)
{
    arena_reset(&t.keep, 0);
    err_t e = net_run(&t.r, &t.net, &t.v, &t.out);
    if (e) {
        assert_int_equal(e, ERR_FORMAT);
        if (!strstr(err_text(), "the network overflows: element "))
            fail_msg("%s: %s", change.part, err_text());
        assert_int_equal(t.keep.used, 0);
        assert_null(t.out.geom.depth);
        return true;
    }
    check_geometry();
    assert_finite(change.part);
    return false;
}

/* Each product, or each plain tensor, set to one value in turn. Returns how many of them fail;
 * sanitizers see every fourth, which is taken for four. */
static int count_failures(bool products, enum precision precision, float value)
{
    static struct names x;
    int refused = 0;
    x.n = 0;
    x.products = products;
    assert_int_equal(table_walk(&small_model_tiny, collect_tensor, &x), OK);
    assert_true(x.n > 100);
    change.how = SET;
    change.value = value;
    for (int i = 0; i < x.n; i += some_of(4)) {
        change.part = x.name[i];
        open_world(precision, 2, 28);
        refused += run_or_refuse() ? some_of(4) : 0;
        close_world();
    }
    change.part = NULL;
    print_message("  %g: %d of %d fail\n", (double)value, refused, x.n);
    return refused;
}

static void zero_products(void **state)
{
    (void)state;
    assert_int_equal(count_failures(true, PRECISION_F32, 0), 0);
    assert_int_equal(count_failures(true, PRECISION_S8, 0), 0); // their scales are 0
}

static void tiny_weights(void **state)
{
    (void)state;
    assert_int_equal(count_failures(true, PRECISION_S8, 2e-38f), 0); // 127 over it is infinite
    assert_int_equal(count_failures(false, PRECISION_F32, 1e-42f), 0);
}

/* Infinities and NaN appear inside, and do not get lost on their way to the end of a stage, except
 * where they cannot matter: before a norm of one channel's share, behind a 0. */
static void huge_weights(void **state)
{
    (void)state;
    for (int p = 0; p < 3; p++) {
        assert_true(count_failures(true, precisions[p], FLT_MAX) > 90);
        assert_true(count_failures(false, precisions[p], -FLT_MAX) > 60);
    }
}

/* One NaN in the weights of a stage, which no conversion lets through, is seen by that stage. */
static void stages_are_named(void **state)
{
    static const struct {
        const char *part, *stage;
    } places[] = {
        {"aggregator.patch_embed.patch_embed.proj.weight", "dino.patch_embed"},
        {"aggregator.patch_embed.blocks.0.mlp.fc2.bias", "dino.block00"},
        {"aggregator.patch_embed.norm.bias", "dino.patch_tokens"},
        {"aggregator.frame_blocks.2.attn.proj.bias", "agg.frame02"},
        {"aggregator.global_blocks.1.attn.qkv.bias", "agg.global01"},
        {"camera_head.trunk.0.norm1.bias", "camera head"},
        {"camera_head.pose_branch.fc2.bias", "camera head"},
        {"depth_head.scratch.refinenet1.resConfUnit2.conv1.bias", "depth.raw"},
        {"hdr_head.regression.v_var_proj.bias", "hdr.weighted_var"},
        {"hdr_head.regression.var_out.3.bias", "hdr.sensitivity_tokens"},
        {"gaussian_param_head.scratch.refinenet4.out_conv.bias", "gs.raw88"},
        {"hdr_head.hdr_upsample.proj_guide.0.bias", "gs.raw88"},
        {"generate_tonemapper.enc.0.bias", "tone.params"},
    };
    (void)state;
    change.how = SET;
    change.value = NAN;
    for (int p = 0; p < 3; p++)
        for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
            char text[64];
            change.part = places[i].part;
            open_world(precisions[p], 2, 28);
            snprintf(text, sizeof text, "of its %s is ", places[i].stage);
            if (!run_or_refuse() || !strstr(err_text(), text))
                fail_msg("%s: %s", change.part, err_text());
            close_world();
        }
    change.part = NULL;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_colour),
        cmocka_unit_test(hot_pixel),
        cmocka_unit_test(one_view_repeated),
        cmocka_unit_test(exposures),
        cmocka_unit_test(sizes),
        cmocka_unit_test(large_activations),
        cmocka_unit_test(zero_products),
        cmocka_unit_test(tiny_weights),
        cmocka_unit_test(huge_weights),
        cmocka_unit_test(stages_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
