/* Pictures for training: planes in and out as they are laid out in Python, gradients against
 * differences of the picture, refusals. The rasteriser itself is raster_test's. */
#include "sim/train/redraw.h"

#include "core/base/gaussians.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

enum { N = 3, S = 24, PX = S * S, PLANES = G_SH + 3 };

static float planes[PLANES * N], grad[PLANES * N];
static float radiance[3 * PX], depth[PX], alpha[PX];
static float up_radiance[3 * PX], up_depth[PX], up_alpha[PX];

/* Three splats side by side, the last behind the camera. */
static struct redraw scene(void)
{
    memset(planes, 0, sizeof planes);
    for (int i = 0; i < N; i++) {
        planes[0 * N + i] = 0.3f * (float)(i - 1);
        planes[1 * N + i] = 0.1f * (float)i;
        planes[2 * N + i] = i < 2 ? 2.0f + 0.5f * (float)i : -1.0f;
        for (int k = 0; k < 3; k++) {
            planes[(G_LOG_SCALE + k) * N + i] =
                0.1f - 0.2f * (float)k; // no edge of a splat in the picture
            planes[(G_SH + k) * N + i] = 0.5f * (float)(k - i);
        }
        planes[G_QUAT * N + i] = 1;
        planes[(G_QUAT + 2) * N + i] = 0.2f;
        planes[G_LOGIT * N + i] = 0.5f;
    }
    for (int i = 0; i < 3 * PX; i++)
        up_radiance[i] = sinf(0.37f * (float)i);
    for (int i = 0; i < PX; i++) {
        up_depth[i] = cosf(0.11f * (float)i);
        up_alpha[i] = sinf(0.05f * (float)i);
    }
    return (struct redraw){.n = N,
                           .w = S,
                           .h = S,
                           .threads = 1,
                           .background = {1, 0.5f, 0.2f},
                           .camera = {20, 20, 12, 12, 1, 0, 0, 0, 0, 0, 0},
                           .planes = planes,
                           .radiance = radiance,
                           .depth = depth,
                           .alpha = alpha};
}

static double loss(const struct redraw *q)
{
    double sum = 0;
    assert_int_equal(redraw_run(q), OK);
    for (int i = 0; i < 3 * PX; i++)
        sum += (double)radiance[i] * (double)up_radiance[i];
    for (int i = 0; i < PX; i++)
        sum += (double)depth[i] * (double)up_depth[i] + (double)alpha[i] * (double)up_alpha[i];
    return sum;
}

static void gradient_is_that_of_the_picture(void **state)
{
    (void)state;
    struct redraw q = scene(), with = q;
    with.up_radiance = up_radiance;
    with.up_depth = up_depth;
    with.up_alpha = up_alpha;
    with.grad = grad;
    assert_int_equal(redraw_run(&with), OK);
    for (int at = 0; at < PLANES * N; at++) {
        const float was = planes[at], step = 2e-3f;
        planes[at] = was + step;
        double above = loss(&q);
        planes[at] = was - step;
        double slope = (above - loss(&q)) / (2 * (double)step);
        planes[at] = was;
        if (fabs((double)grad[at] - slope) > 0.02 + 0.02 * fabs(slope))
            fail_msg("plane %d, splat %d: %g, by differences %g", at / N, at % N, (double)grad[at],
                     slope);
        if (at % N == 2) // behind the camera
            assert_true(grad[at] == 0);
    }
}

static void threads_and_maps_do_not_matter(void **state)
{
    (void)state;
    static float first[3 * PX];
    struct redraw q = scene();
    assert_int_equal(redraw_run(&q), OK);
    memcpy(first, radiance, sizeof first);
    assert_true(alpha[12 * S + 12] > 0.3f && first[12 * S + 12] != 1.0f);
    q.threads = 2;
    q.depth = NULL;
    assert_int_equal(redraw_run(&q), OK);
    assert_memory_equal(first, radiance, sizeof first);
}

static void refusals_name_the_bound(void **state)
{
    (void)state;
    struct redraw q = scene();
    q.degree = 5;
    assert_int_equal(redraw_run(&q), ERR_ARG);
    assert_string_equal(err_text(),
                        "redraw: 3 splats of degree 5, allowed are 1 to 16777216, 0 to 4");
    q = scene();
    q.n = 0;
    assert_int_equal(redraw_run(&q), ERR_ARG);
    q = scene();
    q.h = 0;
    assert_int_equal(redraw_run(&q), ERR_ARG);
    assert_string_equal(err_text(), "redraw: a picture of 24 x 0 px, allowed are 1 to 4080");
    q = scene();
    q.up_radiance = up_radiance;
    assert_int_equal(redraw_run(&q), ERR_ARG);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(gradient_is_that_of_the_picture),
        cmocka_unit_test(threads_and_maps_do_not_matter),
        cmocka_unit_test(refusals_name_the_bound),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
