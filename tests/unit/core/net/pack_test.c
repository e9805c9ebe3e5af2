/* Packed products against table_source, and integers against rounding in double. */
#include "core/net/pack.h"

#include "core/kernels/gemm.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static const struct tensor_spec specs[] = {
    {.role = ROLE_LINEAR, .rank = 2, .shape = {37, 12, 1, 1}},
    {.role = ROLE_LINEAR, .rank = 2, .shape = {16, 4, 1, 1}},
    {.role = ROLE_LINEAR, .rank = 2, .shape = {1, 8, 1, 1}},
    {.role = ROLE_CONV, .rank = 4, .shape = {17, 4, 3, 5}},
    {.role = ROLE_CONV_T, .rank = 4, .shape = {8, 6, 2, 2}},
};

struct packed {
    struct product_shape p;
    int k, panels;
    float *in;
    void *out;
    float *scale, *row;
};

static struct packed pack(const struct tensor_spec *t, enum precision type)
{
    struct packed x = {.p = table_product(t), .panels = pack_panels(t)};
    size_t n = table_count(t);
    x.k = x.p.segs * x.p.seg;
    x.in = malloc(n * sizeof *x.in);
    x.row = malloc((size_t)x.k * sizeof *x.row);
    x.out = malloc((size_t)x.panels * pack_panel_bytes(t, type));
    x.scale = malloc((size_t)x.p.n * sizeof *x.scale);
    memset(x.out, 0x55, (size_t)x.panels * pack_panel_bytes(t, type));
    for (size_t i = 0; i < n; i++)
        x.in[i] = (float)sin((double)i * 1.7) * expf((float)(i % 7) - 3);
    for (int i = 0; i < x.k; i++) // a row of zeros and one below FLT_MIN
        x.in[table_source(t, 0, i)] = 0;
    if (x.p.n > 2)
        for (int i = 0; i < x.k; i++)
            x.in[table_source(t, 2, i)] = 1e-39f;
    for (int p = 0; p < x.panels; p++) {
        const struct pack to = {x.row, (char *)x.out + (size_t)p * pack_panel_bytes(t, type),
                                x.scale + (size_t)p * PANEL};
        pack_panel(t, type, p, x.in, &to);
    }
    return x;
}

static void release(struct packed *x)
{
    free(x->in);
    free(x->row);
    free(x->out);
    free(x->scale);
}

static float reference_weight(const struct packed *x, const struct tensor_spec *t, int o, int i)
{
    return o < x->p.n ? x->in[table_source(t, o, i)] : 0;
}

static void floats_lie_in_panels(void **state)
{
    (void)state;
    for (size_t s = 0; s < sizeof specs / sizeof specs[0]; s++) {
        struct packed x = pack(&specs[s], PRECISION_F32), h = pack(&specs[s], PRECISION_BF16);
        for (int o = 0; o < x.panels * PANEL; o++)
            for (int i = 0; i < x.k; i++) {
                size_t at =
                    ((size_t)(o / PANEL) * (size_t)x.k + (size_t)i) * PANEL + (size_t)(o % PANEL);
                float v = reference_weight(&x, &specs[s], o, i), near;
                uint32_t u = (uint32_t)((uint16_t *)h.out)[at] << 16;
                memcpy(&near, &u, sizeof near);
                assert_true(((float *)x.out)[at] == v);
                assert_true(fabsf(near - v) <= ldexpf(fabsf(v), -8) + 0x1p-134f);
            }
        release(&x);
        release(&h);
    }
}

static void bf16_rounds_to_even_and_saturates(void **state)
{
    (void)state;
    const struct tensor_spec t = {.role = ROLE_LINEAR, .rank = 2, .shape = {1, 6, 1, 1}};
    const float in[6] = {0x1.01p0f, 0x1.03p0f, 0x1.010002p0f, 3.4028235e38f, -3.4028235e38f, -0.f};
    const uint16_t out[6] = {0x3f80, 0x3f82, 0x3f81, 0x7f7f, 0xff7f, 0x8000};
    float row[6];
    uint16_t panel[6 * PANEL];
    pack_panel(&t, PRECISION_BF16, 0, in, &(struct pack){row, panel, NULL});
    for (int i = 0; i < 6; i++)
        assert_int_equal(panel[i * PANEL], out[i]);
}

static int packed_integer(const struct packed *x, int o, int i)
{
    return ((int8_t *)x->out)[(size_t)(o / PANEL) * (size_t)x->k * PANEL + (size_t)(i / 4) * 64 +
                              (size_t)(o % PANEL) * 4 + (size_t)(i % 4)];
}

/* Partial sums of a kernel's integers for one input channel equal those of its weights within half
 * a step (a whole one next to the largest, which cannot grow). */
static void rounding_of_kernels_keeps_their_sums(void **state)
{
    (void)state;
    const struct tensor_spec *t = &specs[3];
    struct packed x = pack(t, PRECISION_S8);
    int channels = t->shape[1], halves = 0;
    for (int o = 0; o < x.p.n; o++)
        for (int c = 0; c < channels && x.scale[o] > 0; c++) {
            double sum = 0;
            for (int i = c; i < x.k; i += channels) {
                sum += (double)reference_weight(&x, t, o, i) / (double)x.scale[o] -
                       packed_integer(&x, o, i);
                assert_true(fabs(sum) < 1);
                halves += fabs(sum) < 0.501;
            }
        }
    assert_in_range(halves, (x.p.n - 2) * x.k * 9 / 10, x.p.n * x.k);
    release(&x);
}

static void integers_have_a_scale_per_output(void **state)
{
    (void)state;
    for (size_t s = 0; s < sizeof specs / sizeof specs[0]; s++) {
        struct packed x = pack(&specs[s], PRECISION_S8);
        for (int o = 0; o < x.panels * PANEL; o++) {
            double top = 0;
            for (int i = 0; i < x.k; i++)
                top = fmax(top, fabs((double)reference_weight(&x, &specs[s], o, i)));
            if (o < x.p.n)
                assert_true(x.scale[o] == (top < 0x1p-126 ? 0 : (float)top / 127.0f));
            for (int i = 0; i < x.k && specs[s].role != ROLE_CONV; i++) {
                float inv = top < 0x1p-126 ? 0 : 127.0f / (float)top;
                assert_int_equal(packed_integer(&x, o, i),
                                 (int)nearbyintf(reference_weight(&x, &specs[s], o, i) * inv));
            }
        }
        release(&x);
    }
}

/* The rule of the kernels also where its numbers end. */
static void extreme_integers(void **state)
{
    (void)state;
    static const struct {
        float in[8];
        int8_t out[8];
        float scale;
    } cases[] = {
        {{0, 1e-44f, -1e-38f}, {0}, 0},                                    // below FLT_MIN
        {{0, 2e-38f, -3e-38f, 1e-38f}, {0, 127, -127, 127}, 3e-38f / 127}, // 127 / 3e-38 = inf
        {{FLT_MAX, -FLT_MAX, 1, 0}, {127, -127, 0, 0}, FLT_MAX / 127},
    };
    const struct tensor_spec t = {.role = ROLE_LINEAR, .rank = 2, .shape = {1, 8, 1, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        float row[8], scale[PANEL];
        int8_t panel[8 * PANEL];
        pack_panel(&t, PRECISION_S8, 0, cases[k].in, &(struct pack){row, panel, scale});
        assert_true(scale[0] == cases[k].scale);
        for (int i = 0; i < 8; i++)
            assert_int_equal(panel[i / 4 * 4 * PANEL + i % 4], cases[k].out[i]);
    }
}

/* Rotated sums that are infinite count as the largest number. */
static void extreme_rotation(void **state)
{
    (void)state;
    const struct tensor_spec t = {.name = "encoder.aggregator.frame_blocks.0.mlp.fc2.weight",
                                  .role = ROLE_LINEAR,
                                  .rank = 2,
                                  .shape = {1, 16, 1, 1}};
    float in[16], row[16], scale[PANEL];
    int8_t panel[16 * PANEL];
    assert_true(model_rotation(&t, PRECISION_S8) > 0);
    for (int i = 0; i < 16; i++)
        in[i] = i % 3 ? FLT_MAX : -FLT_MAX;
    pack_panel(&t, PRECISION_S8, 0, in, &(struct pack){row, panel, scale});
    assert_true(isfinite(scale[0]) && scale[0] > 0);
    for (int i = 0; i < 16; i++)
        assert_true(panel[i / 4 * 4 * PANEL + i % 4] >= -127);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(floats_lie_in_panels),
        cmocka_unit_test(bf16_rounds_to_even_and_saturates),
        cmocka_unit_test(integers_have_a_scale_per_output),
        cmocka_unit_test(rounding_of_kernels_keeps_their_sums),
        cmocka_unit_test(extreme_integers),
        cmocka_unit_test(extreme_rotation),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
