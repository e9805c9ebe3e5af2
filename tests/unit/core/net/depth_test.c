/* Depth head and the trunk in it against core/net/README.md 2.5 in double; position codes; extreme
 * outputs; unprojection; the same bytes for any number of threads; memory as planned. */
#include "core/net/depth.h"

#include "core/net/dpt.h"
#include "tests/unit/core/net/heads_ref.h"

#include <float.h>

enum { PX = REF_SIZE * REF_SIZE };

/* ---- position code and blending ---- */

static void check_values_of_the_code(void **state)
{
    static float code[448 * 64];
    (void)state;
    dpt_code(32, 128, code);
    assert_float_equal(code[0], 0.1 * sin(-0.6850097), 1e-8); // core/net/README.md 2.5
    assert_float_equal(code[31 * 64], 0.1 * sin(0.6850097), 1e-8);
    dpt_code(448, 128, code);
    assert_float_equal(code[0], 0.1 * sin(-0.7055284), 1e-8);
    assert_float_equal(code[32], 0.1 * cos(-0.7055284), 1e-8);
    dpt_code(1, 8, code); // a single pixel lies in the middle
    assert_true(code[0] == 0 && code[2] == 0.1f);
}

/* Both kinds of resizing, up and down, odd sizes, plus a map and the code. */
static void blends(void **state)
{
    static const int sizes[][2] = {{3, 10}, {10, 3}, {7, 7}, {1, 5}, {5, 1}, {28, 42}};
    enum { C = 8, MAX = 42 };
    static float in[MAX * MAX * C], plus[MAX * MAX * C], code[MAX * C / 2], got[MAX * MAX * C];
    (void)state;
    ref_open(&ref_dims, PRECISION_F32, 2);
    for (int i = 0; i < MAX * MAX * C; i++) {
        in[i] = ref_uniform();
        plus[i] = ref_uniform();
    }
    for (int k = 0; k < 12; k++) {
        int from = sizes[k / 2][0], to = sizes[k / 2][1];
        struct dpt_blend b = {{in, from, from, C, to, to, k % 2}, plus, code};
        struct ref_map m = ref_floats(in, from, from, C), p = ref_floats(plus, to, to, C);
        m = ref_resize(&m, to, k % 2);
        ref_add(&m, &p, 1);
        ref_add_code(&m);
        dpt_code(to, C, code);
        assert_int_equal(dpt_blend_run(&ref.r, &b, false, got), OK);
        assert_true(ref_apart(got, m.px, (size_t)(to * to * C)) < 1e-6);
        assert_int_equal(dpt_blend_run(&ref.r, &b, true, got), OK);
        ref_relu(m);
        assert_true(ref_apart(got, m.px, (size_t)(to * to * C)) < 1e-6);
    }
    ref_close();
}

/* ---- the head ---- */

static float depths[REF_VIEWS * PX], again[REF_VIEWS * PX];

static void run(enum precision precision, int threads, float *out)
{
    size_t keep, tmp;
    struct geometry g = {.n_views = REF_VIEWS, .size = REF_SIZE};
    ref_open(&ref_dims, precision, threads);
    struct plan plan = plan_begin(threads);
    depth_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
    assert_int_equal(depth_run(&ref.r, &ref.net, &ref.tokens, &g), OK);
    assert_int_equal(ref.keep.used, keep);
    assert_int_equal(ref.tmp.used, 0);
    memcpy(out, g.depth, REF_VIEWS * PX * sizeof *out);
}

static void want_depth(int view, double *out)
{
    const char *head = "depth_head";
    struct ref_map x = ref_trunk(head, view);
    x = ref_resize(&x, REF_SIZE, true);
    ref_add_code(&x);
    x = ref_relu(ref_conv(&x, head, ".scratch.output_conv2.0", 1, 1));
    x = ref_conv(&x, head, ".scratch.output_conv2.2", 1, 0);
    for (int i = 0; i < PX; i++)
        out[i] = exp(x.px[2 * i]);
}

static void as_specified(void **state)
{
    static const double bounds[] = {
        [PRECISION_F32] = 3e-6, [PRECISION_BF16] = 1e-2, [PRECISION_S8] = 3e-2};
    static double want[REF_VIEWS * PX];
    (void)state;
    for (int p = PRECISION_F32; p <= PRECISION_S8; p++) {
        run((enum precision)p, 2, depths);
        for (int v = 0; v < REF_VIEWS; v++)
            want_depth(v, want + v * PX);
        double apart = ref_apart(depths, want, REF_VIEWS * PX);
        assert_true(apart < bounds[p]);
        ref_close();
    }
}

static void any_number_of_threads(void **state)
{
    static const int threads[] = {2, 7};
    (void)state;
    for (int p = PRECISION_F32; p <= PRECISION_S8; p += PRECISION_S8) {
        run((enum precision)p, 1, depths);
        ref_close();
        for (int i = 0; i < 2; i++) {
            run((enum precision)p, threads[i], again);
            ref_close();
            assert_memory_equal(depths, again, sizeof depths);
        }
    }
}

static void cancelled(void **state)
{
    size_t keep, tmp;
    struct geometry g = {.n_views = REF_VIEWS, .size = REF_SIZE};
    (void)state;
    ref_open(&ref_dims, PRECISION_F32, 2);
    struct plan plan = plan_begin(2);
    depth_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
    atomic_store(&ref.cancel, true);
    assert_int_equal(depth_run(&ref.r, &ref.net, &ref.tokens, &g), ERR_CANCELLED);
    assert_int_equal(ref.tmp.used, 0);
    ref_close();
}

/* Logarithms of what floats cannot hold give the nearest depths that are numbers; what is no
 * logarithm is refused. */
static void extreme_outputs(void **state)
{
    static const float biases[] = {1e4f, -1e4f, NAN, INFINITY};
    (void)state;
    for (int i = 0; i < 4; i++) {
        size_t keep, tmp;
        struct geometry g = {.n_views = REF_VIEWS, .size = REF_SIZE};
        const float bias[2] = {biases[i], 0};
        ref_open(&ref_dims, PRECISION_F32, 2);
        ref.net.depth_out.b.bias = bias;
        struct plan plan = plan_begin(2);
        depth_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
        keep = plan.keep.peak;
        tmp = plan.tmp.peak;
        ref_arenas(keep, tmp);
        assert_int_equal(depth_run(&ref.r, &ref.net, &ref.tokens, &g), i < 2 ? OK : ERR_FORMAT);
        if (i >= 2)
            assert_non_null(
                strstr(err_text(), "the network overflows: element 0 of its depth.raw"));
        for (int k = 0; k < REF_VIEWS * PX && i < 2; k++)
            assert_true(g.depth[k] > FLT_MIN && g.depth[k] < FLT_MAX);
        assert_true(i >= 2 || (i == 0 ? g.depth[0] > 1e34f : g.depth[0] < 1e-34f));
        ref_close();
    }
}

/* ---- points ---- */

/* Every point projects to its pixel, half a pixel left and above its centre. */
static void points_project_back(void **state)
{
    enum { SIZE = 5, VIEWS = 2 };
    static float points[SIZE * SIZE * 3];
    float depth[VIEWS * SIZE * SIZE];
    struct camera cams[VIEWS] = {
        {SIZE, SIZE, 4, 5, 2.5f, 2.5f, {1, 0, 0, 0}, {0, 0, 0}},
        {SIZE, SIZE, 6, 3, 2.5f, 2.5f, {0.5f, -0.1f, 0.7f, 0.5f}, {1, -2, 3}},
    };
    const struct geometry g = {.n_views = VIEWS, .size = SIZE, .cams = cams, .depth = depth};
    (void)state;
    for (int i = 0; i < VIEWS * SIZE * SIZE; i++)
        depth[i] = 1 + 0.1f * (float)i;
    depth_unproject(&g, 0, points);
    assert_float_equal(points[0], -2.5 / 4 * 1, 1e-6);
    assert_float_equal(points[1], -2.5 / 5 * 1, 1e-6);
    assert_float_equal(points[2], 1, 1e-6);
    depth_unproject(&g, 1, points);
    for (int i = 0; i < SIZE * SIZE; i++) {
        const float *q = cams[1].q, *x = points + 3 * i;
        double w = q[0], a = q[1], b = q[2], c = q[3], p[3];
        double cross[3] = {b * x[2] - c * x[1], c * x[0] - a * x[2], a * x[1] - b * x[0]};
        p[0] = x[0] + 2 * (w * cross[0] + b * cross[2] - c * cross[1]) + cams[1].t[0];
        p[1] = x[1] + 2 * (w * cross[1] + c * cross[0] - a * cross[2]) + cams[1].t[1];
        p[2] = x[2] + 2 * (w * cross[2] + a * cross[1] - b * cross[0]) + cams[1].t[2];
        assert_float_equal(p[2], depth[SIZE * SIZE + i], 1e-5);
        assert_float_equal(6 * p[0] / p[2] + 2.5, (double)(i % SIZE), 1e-5);
        assert_float_equal(3 * p[1] / p[2] + 2.5, (double)(i / SIZE), 1e-5);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(check_values_of_the_code),
        cmocka_unit_test(blends),
        cmocka_unit_test(as_specified),
        cmocka_unit_test(any_number_of_threads),
        cmocka_unit_test(cancelled),
        cmocka_unit_test(extreme_outputs),
        cmocka_unit_test(points_project_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
