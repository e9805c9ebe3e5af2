/* Products and convolutions against naive loops in double, in every precision; the same bytes for
 * any number of threads; memory as planned. */
#include "core/net/layer.h"
#include "core/net/pack.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W_MAX = 1 << 17, X_MAX = 1 << 17, ROOM = 64 << 20 };

static struct {
    struct kernels kernels;
    struct arena keep, tmp;
    struct run r;
    uint32_t rng;
    float w[W_MAX], x[X_MAX], bias[512], scale[512];
    unsigned char panels[4 * W_MAX];
    float got[X_MAX], again[X_MAX];
    double want[X_MAX];
} t;

static float uniform(void)
{
    t.rng = t.rng * 1664525u + 1013904223u;
    return (float)(t.rng >> 8) * 0x1p-23f - 1;
}

static void open_world(void)
{
    memset(&t, 0, sizeof t);
    kernels_init(&t.kernels, 0);
    assert_int_equal(arena_init(&t.tmp, "tmp", ROOM), OK);
    t.r = (struct run){.k = &t.kernels, .keep = &t.keep, .tmp = &t.tmp};
    for (int i = 0; i < X_MAX; i++)
        t.x[i] = uniform();
    for (int i = 0; i < W_MAX; i++)
        t.w[i] = uniform();
    for (int i = 0; i < 512; i++)
        t.bias[i] = uniform();
}

static struct weight pack(const struct tensor_spec *s, enum precision type)
{
    static float row[W_MAX];
    struct product_shape p = table_product(s);
    for (int i = 0; i < pack_panels(s); i++)
        pack_panel(s, type, i, t.w,
                   &(struct pack){row, t.panels + (size_t)i * pack_panel_bytes(s, type),
                                  t.scale + i * PANEL});
    return (struct weight){.type = type,
                           .n = p.n,
                           .segs = p.segs,
                           .seg = p.seg,
                           .panels = t.panels,
                           .scale = type == PRECISION_S8 ? t.scale : NULL,
                           .bias = t.bias};
}

static double rms(size_t n)
{
    double error = 0, size = 0;
    for (size_t i = 0; i < n; i++) {
        error += (t.got[i] - t.want[i]) * (t.got[i] - t.want[i]);
        size += t.want[i] * t.want[i];
    }
    return sqrt(error / size);
}

static const double bounds[] = {
    [PRECISION_F32] = 4e-6, [PRECISION_BF16] = 4e-3, [PRECISION_S8] = 1e-2};

/* ---- rows ---- */

static void naive_rows(int m, int n, int k)
{
    for (int i = 0; i < m; i++)
        for (int o = 0; o < n; o++) {
            double sum = t.bias[o];
            for (int j = 0; j < k; j++)
                sum += (double)t.x[i * k + j] * t.w[o * k + j];
            t.want[i * n + o] = sum;
        }
}

static void rows_case(int m, int n, int k, enum precision type)
{
    struct tensor_spec s = {.role = ROLE_LINEAR, .rank = 2, .shape = {n, k}};
    struct weight w = pack(&s, type);
    struct layer_in in = {.x = t.x, .ldx = (size_t)k, .m = m};
    struct layer_out out = {.out = t.got, .ldo = (size_t)n};
    naive_rows(m, n, k);
    assert_int_equal(layer_run(&t.r, &w, &in, &out), OK);
    assert_true(rms((size_t)m * (size_t)n) < bounds[type]);
    in.floats = true; // only the weights are rounded
    assert_int_equal(layer_run(&t.r, &w, &in, &out), OK);
    assert_true(rms((size_t)m * (size_t)n) < bounds[type] / 1.2);
    assert_int_equal(t.tmp.used, 0);
}

static void test_rows(void **state)
{
    (void)state;
    open_world();
    for (int type = PRECISION_F32; type <= PRECISION_S8; type++) {
        rows_case(7, 33, 16, (enum precision)type);
        rows_case(67, 81, 260, (enum precision)type);
        rows_case(99, 16, 1028, (enum precision)type);
        rows_case(3, 40, 2056, (enum precision)type);
    }
    arena_free(&t.tmp);
}

/* Weights and rows turned by the same rotation give the same product. */
static void test_rotation(void **state)
{
    (void)state;
    open_world();
    enum { M = 21, N = 48, K = 256 };
    struct tensor_spec s = {.role = ROLE_LINEAR, .rank = 2, .shape = {N, K}};
    for (int i = 0; i < M; i++)
        t.x[i * K + 7] = 1000; // an outlier, the case for rotation
    naive_rows(M, N, K);
    struct layer_in in = {.x = t.x, .ldx = K, .m = M};
    struct layer_out out = {.out = t.got, .ldo = N};
    struct weight w = pack(&s, PRECISION_S8);
    assert_int_equal(layer_run(&t.r, &w, &in, &out), OK);
    for (int o = 0; o < N; o++)
        t.kernels.net.hadamard(t.w + o * K, K, 64);
    w = pack(&s, PRECISION_S8);
    w.rotate = 64;
    for (int floats = 0; floats < 2; floats++) {
        in.floats = floats;
        assert_int_equal(layer_run(&t.r, &w, &in, &out), OK);
        assert_true(rms((size_t)M * N) < 1.2e-2);
    }
    arena_free(&t.tmp);
}

static void test_row_of_zeros_is_bias(void **state)
{
    (void)state;
    open_world();
    struct tensor_spec s = {.role = ROLE_LINEAR, .rank = 2, .shape = {20, 32}};
    struct weight w = pack(&s, PRECISION_S8);
    memset(t.x, 0, 64 * sizeof *t.x);
    t.x[40] = 1e-42f; // below what has an inverse
    struct layer_in in = {.x = t.x, .ldx = 32, .m = 2};
    struct layer_out out = {.out = t.got, .ldo = 20};
    assert_int_equal(layer_run(&t.r, &w, &in, &out), OK);
    for (int i = 0; i < 40; i++)
        assert_true(t.got[i] == t.bias[i % 20]);
    arena_free(&t.tmp);
}

/* ---- convolutions ---- */

struct shape {
    int h, w, c, n, k, stride, pad;
};

static void naive_conv(const struct shape *s)
{
    int oh = conv_size(s->h, s->k, s->stride, s->pad);
    int ow = conv_size(s->w, s->k, s->stride, s->pad);
    for (int i = 0; i < oh * ow * s->n; i++) {
        int o = i % s->n, y = i / s->n / ow * s->stride - s->pad;
        int x = i / s->n % ow * s->stride - s->pad;
        double sum = t.bias[o];
        for (int j = 0; j < s->k * s->k * s->c; j++) {
            int c = j / (s->k * s->k), ky = y + j / s->k % s->k, kx = x + j % s->k;
            if (ky >= 0 && ky < s->h && kx >= 0 && kx < s->w)
                sum += (double)t.x[(ky * s->w + kx) * s->c + c] * t.w[o * s->c * s->k * s->k + j];
        }
        t.want[i] = sum > 0 ? sum : 0;
    }
}

static void conv_case(const struct shape *s, enum precision type)
{
    struct tensor_spec spec = {.role = ROLE_CONV, .rank = 4, .shape = {s->n, s->c, s->k, s->k}};
    struct weight w = pack(&spec, type);
    struct layer_map map = {.px = t.x, .w = s->w, .c = s->c};
    struct layer_conv c = {.w = &w,
                           .kh = s->k,
                           .kw = s->k,
                           .stride = s->stride,
                           .pad = s->pad,
                           .channels = s->c,
                           .h = s->h,
                           .w_px = s->w,
                           .fetch = layer_map_fetch,
                           .ctx = &map};
    struct layer_out out = {.out = t.got, .ldo = (size_t)s->n, .act = ACT_RELU};
    size_t n = (size_t)conv_size(s->h, s->k, s->stride, s->pad) *
               (size_t)conv_size(s->w, s->k, s->stride, s->pad) * (size_t)s->n;
    naive_conv(s);
    t.tmp.peak = 0;
    assert_int_equal(layer_conv_run(&t.r, &c, &out), OK);
    assert_true(rms(n) < bounds[type] * 1.3);
    struct plan plan = plan_begin(1);
    layer_conv_plan(&plan, &c);
    assert_true(t.tmp.peak <= plan.tmp.peak);
    assert_int_equal(t.tmp.used, 0);
    struct pool *pool;
    assert_int_equal(pool_open(&pool, 3), OK);
    t.r.pool = pool;
    out.out = t.again;
    assert_int_equal(layer_conv_run(&t.r, &c, &out), OK);
    assert_memory_equal(t.got, t.again, n * sizeof *t.got);
    pool_close(pool);
    t.r.pool = NULL;
}

static void test_conv(void **state)
{
    (void)state;
    static const struct shape shapes[] = {
        {5, 7, 4, 3, 1, 1, 0},    {19, 70, 4, 20, 3, 1, 1},  {9, 9, 12, 17, 3, 2, 1},
        {33, 18, 8, 65, 7, 1, 3}, {23, 31, 16, 32, 7, 1, 3}, {28, 42, 4, 5, 14, 14, 0},
        {1, 1, 16, 8, 3, 1, 1},
    };
    open_world();
    for (int direct = 0; direct < 2; direct++)
        for (size_t i = 0; i < 3 * sizeof shapes / sizeof *shapes; i++) {
            t.kernels.net.s8_beats_fft = direct;
            conv_case(shapes + i / 3, (enum precision)(i % 3));
        }
    arena_free(&t.tmp);
}

/* ---- resizes ---- */

static void test_resize(void **state)
{
    (void)state;
    float px[4] = {0, 10, 20, 40}, out[4]; // 2 x 2, one channel
    struct layer_resize m = {.px = px, .h = 2, .w = 2, .c = 1, .out_h = 3, .out_w = 4};
    m.align = true;
    layer_resize_fetch(&m, 1, 0, 4, out);
    const float aligned[] = {10, 15, 20, 25};
    for (int i = 0; i < 4; i++)
        assert_true(fabsf(out[i] - aligned[i]) < 1e-5f);
    m.align = false; // x at -0.25, 0.25, 0.75, 1.25; y at 1/2
    layer_resize_fetch(&m, 1, 0, 4, out);
    const float even[] = {10, 13.75f, 21.25f, 25};
    for (int i = 0; i < 4; i++)
        assert_true(fabsf(out[i] - even[i]) < 1e-5f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rows),   cmocka_unit_test(test_rotation),
        cmocka_unit_test(test_conv),   cmocka_unit_test(test_row_of_zeros_is_bias),
        cmocka_unit_test(test_resize),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
