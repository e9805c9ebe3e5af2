#include "drivers/format/dotsplat.h"

#include "core/base/bytes.h"
#include "core/splat/display.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define C0 0.28209479177387814

static struct arena arena;

/* As its viewer's converter writes them. */
static void put_splat(uint8_t *p, float x, float sigma, const uint8_t rgba[4], const uint8_t q[4])
{
    for (int k = 0; k < 3; k++)
        p = bytes_put_f32(p, x + (float)k);
    for (int k = 0; k < 3; k++)
        p = bytes_put_f32(p, sigma * (float)(k + 1));
    memcpy(p, rgba, 4);
    memcpy(p + 4, q, 4);
}

static void splats_are_read(void **state)
{
    (void)state;
    uint8_t file[64];
    struct gaussians g;
    struct gaussians_report report;
    struct splats_info info;
    float want[3], dc[3];
    put_splat(file, 1, 0.5f, (uint8_t[]){0, 128, 255, 255}, (uint8_t[]){255, 128, 128, 128});
    put_splat(file + 32, -4, 0, (uint8_t[]){9, 9, 9, 0}, (uint8_t[]){64, 192, 0, 128});
    struct splats_bytes b = {"f.splat", file, sizeof file};
    assert_int_equal(dotsplat_format.peek(&b, &info), OK);
    assert_true(info.n == 2 && info.degree == 0 && !info.has_hdr && dotsplat_format.headroom == 0);
    assert_int_equal(dotsplat_format.parse(&b, 2, &arena, &g, &report), OK);
    assert_true(g.n == 2 && g.degree == 0 && report.dropped == 0);
    assert_true(g.plane[G_MU][0] == 1 && g.plane[G_MU + 2][0] == 3 && g.plane[G_MU][1] == -4);
    for (int k = 0; k < 3; k++) {
        assert_true(fabs((double)g.plane[G_LOG_SCALE + k][0] - log(0.5 * (k + 1))) < 1e-6);
        assert_true(g.plane[G_LOG_SCALE + k][1] == GAUSSIANS_LOG_SCALE_MIN);
        dc[k] = (float)(((const double[]){0, 128, 255}[k] / 255 - 0.5) / C0);
    }
    display_to_radiance(dc, 0, 2, want);
    for (int c = 0; c < 3; c++)
        assert_true(fabsf(g.plane[G_SH + c][0] - want[c]) < 1e-4f);
    assert_true(g.plane[G_LOGIT][0] > 6 && g.plane[G_LOGIT][1] < -6);
    assert_true(g.plane[G_QUAT][0] > 0.99f && g.plane[G_QUAT + 1][0] == 0);
    assert_true(g.plane[G_QUAT][1] == -0.5f && g.plane[G_QUAT + 1][1] == 0.5f &&
                g.plane[G_QUAT + 2][1] == -1 && g.plane[G_QUAT + 3][1] == 0);
}

static void other_sizes_are_refused(void **state)
{
    (void)state;
    static const uint8_t file[96];
    for (size_t n = 0; n <= sizeof file; n++) {
        struct gaussians g;
        struct gaussians_report report;
        struct splats_bytes b = {"f.splat", file, n};
        assert_int_equal(dotsplat_format.parse(&b, 0, &arena, &g, &report),
                         n % 32 == 0 ? OK : ERR_FORMAT);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(splats_are_read),
        cmocka_unit_test(other_sizes_are_refused),
    };
    if (arena_init(&arena, "test", 1 << 20) != OK)
        return 1;
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    arena_free(&arena);
    return failed;
}
