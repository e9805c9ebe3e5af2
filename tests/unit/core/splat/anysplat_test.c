/* Display colours as radiance: the curve, and splats under it. */
#include "core/base/gaussians.h"
#include "core/photo/tonemap.h"
#include "core/splat/anysplat.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void radiance_is_shown_as_it_is(void **state)
{
    (void)state;
    struct tonemap tone;
    struct tonemap_table table;
    float v[1025], shown[1025], worst = 0;
    anysplat_curve(-3, &tone);
    assert_float_equal(tone.mid_log2t, -3, 0);
    tonemap_table_init(&table, &tone);
    for (int i = 0; i <= 1024; i++)
        v[i] = (float)i / 1024;
    for (int c = 0; c < 3; c++) {
        tonemap_run(&table.c[c], v, 0, 1025, shown);
        for (int i = 0; i <= 1024; i++) {
            worst = fmaxf(worst, fabsf(shown[i] - v[i]));
            assert_true(i < 2 || shown[i] > shown[i - 1]);
        }
        const float bright[2] = {5, 1000};
        tonemap_run(&table.c[c], bright, 0, 2, shown);
        assert_true(shown[0] > 0.999f && shown[1] > 0.999f);
    }
    print_message("  worst %.2e\n", (double)worst);
    assert_true(worst < 1e-3f);
}

/* A splat of display colour v becomes one of radiance v; a small slope in direction is kept. */
static void display_colours_become_radiance(void **state)
{
    (void)state;
    static const float b0 = 0.2820947917738781f, b1 = 0.48860251190292f;
    struct arena keep;
    struct gaussians g;
    assert_int_equal(arena_init(&keep, "keep", gaussians_need(3, 1)), OK);
    assert_int_equal(gaussians_init(&g, &keep, 3, 1), OK);
    g.n = 3;
    const float colour[3] = {0.8f, 0.1f, -0.2f};
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 3; c++) {
            g.plane[G_SH + c][i] = (colour[i] - 0.5f) / b0;
            g.plane[G_SH + 6 + c][i] = 0.01f; // along z
        }
    anysplat_radiance(&g);
    for (int c = 0; c < 3; c++) {
        assert_float_equal(expf(g.plane[G_SH + c][0] * b0), 0.8f, 1e-6f);
        assert_float_equal(expf(g.plane[G_SH + c][1] * b0), 0.1f, 1e-6f);
        assert_float_equal(expf(g.plane[G_SH + c][2] * b0), 1.0f / 512, 1e-6f);
        for (int i = 0; i < 2; i++)
            assert_float_equal(expf(g.plane[G_SH + c][i] * b0 + g.plane[G_SH + 6 + c][i] * b1),
                               colour[i] + 0.01f * b1, 2e-4f);
        assert_float_equal(g.plane[G_SH + 6 + c][2], 0, 0);
    }
    arena_free(&keep);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(radiance_is_shown_as_it_is),
        cmocka_unit_test(display_colours_become_radiance),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
