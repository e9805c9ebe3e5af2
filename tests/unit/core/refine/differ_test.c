/* Made-up predictions whose distance is known. */
#include "core/base/arena.h"
#include "core/base/rotation.h"
#include "core/photo/metrics.h"
#include "core/photo/tonemap.h"
#include "core/refine/differ.h"
#include "core/sfm/similarity.h"
#include "core/splat/voxel.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 4, SIDE = 14, PIXELS = VIEWS * SIDE * SIDE };

static const double BASIS0 = 0.2820947917738781, DEGREE = 3.14159265358979323846 / 180;
static const float log2t[VIEWS] = {-2, 0, 2, 0};

struct made {
    struct camera cams[VIEWS];
    float depth[PIXELS], features[VOXEL_FEATURES * PIXELS];
    struct prediction p;
};

static float *dc(struct made *m, int colour)
{
    return m->features + (VOXEL_SH + colour * SH_COEFS_MAX) * PIXELS;
}

/* Rotation by an angle around an axis of length 1. */
static void set_turn(float q[4], double degrees, double x, double y, double z)
{
    double s = sin(degrees * DEGREE / 2);
    q[0] = (float)cos(degrees * DEGREE / 2);
    q[1] = (float)(s * x);
    q[2] = (float)(s * y);
    q[3] = (float)(s * z);
}

/* Cameras on a line, 0, 1, 2 and 4 units from the first, the last with another rotation. */
static void make(struct made *m)
{
    static const float at[VIEWS] = {0, 1, 2, 4};
    memset(m, 0, sizeof *m);
    for (int i = 0; i < VIEWS; i++)
        m->cams[i] = (struct camera){SIDE, SIDE, 20, 21, 7, 7, {1, 0, 0, 0}, {-at[i], 0, 0}};
    for (int i = 0; i < PIXELS; i++) {
        m->depth[i] = 1 + 0.01f * (float)(i % 97);
        m->features[VOXEL_LOGIT * PIXELS + i] = 0.1f * (float)(i % 13) - 0.5f;
        for (int c = 0; c < 3; c++)
            dc(m, c)[i] = (float)(log(2) / BASIS0 * (i % 7 - 3 + 0.25 * c));
    }
    m->p = (struct prediction){
        .geom = {VIEWS, SIDE, NULL, m->cams, m->depth}, .n = PIXELS, .features = m->features};
    tonemap_linear(&m->p.tone, 0.7f, -10, 10, 0.5f);
}

static struct made ref, other;

/* Distance of `other` from `ref`, which is looked at and then destroyed. */
static void measure(double out[DIFFER_FIGURES])
{
    struct arena a;
    struct differ_look r = differ_look(&ref.p), o = differ_look(&other.p);
    struct arena count = arena_counter();
    differ_keep_plan(&count, VIEWS, SIDE);
    differ_measure_plan(&count, VIEWS, SIDE);
    assert_int_equal(arena_init(&a, "test", count.peak), OK);
    assert_int_equal(differ_keep(&a, &r), OK);
    memset(ref.cams, 0xff, sizeof ref.cams);
    memset(ref.depth, 0xff, sizeof ref.depth);
    memset(ref.features, 0xff, sizeof ref.features);
    size_t mark = arena_mark(&a);
    assert_int_equal(differ_measure(&r, &o, log2t, &a, out), OK);
    assert_int_equal(arena_mark(&a), mark);
    arena_free(&a);
}

static void near(double got, double want, double bound)
{
    if (!(fabs(got - want) <= bound))
        fail_msg("%.9g is not within %g of %.9g", got, bound, want);
}

static int both(void **state)
{
    (void)state;
    make(&ref);
    make(&other);
    return 0;
}

static void nothing_apart(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    measure(d);
    for (int i = 0; i < DIFFER_FIGURES; i++)
        near(d[i], i == DIFFER_PSNR ? METRICS_PSNR_MAX : 0, 0);
}

/* Where the world lies is no error. */
static void moved_as_a_whole(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    float q[4];
    set_turn(q, 70, 0.6, 0, 0.8);
    struct similarity w = {1, {(double)q[0], (double)q[1], (double)q[2], (double)q[3]}, {3, -2, 1}};
    for (int i = 0; i < VIEWS; i++)
        other.cams[i] = similarity_apply(&w, &ref.cams[i]);
    for (int i = 4; i < 4 * VIEWS; i++)
        other.cams[i / 4].q[i % 4] *= -1; // the same rotation
    measure(d);
    near(d[DIFFER_ROTATION], 0, 1e-4);
    near(d[DIFFER_TRANSLATION], 0, 1e-4);
}

/* Turned by 1, 2 and 5 degrees around the places where they stand. */
static void cameras_turned(void **state)
{
    (void)state;
    static const double angle[VIEWS] = {0, 5, 1, 2};
    double d[DIFFER_FIGURES], x[3];
    for (int i = 1; i < VIEWS; i++) {
        struct camera *c = &other.cams[i];
        rotation_centre(c, x);
        set_turn(c->q, angle[i], 0, 1, 0);
        double s = sin(angle[i] * DEGREE), k = cos(angle[i] * DEGREE);
        c->t[0] = (float)-(k * x[0] + s * x[2]); // t = -R x
        c->t[2] = (float)(s * x[0] - k * x[2]);
    }
    measure(d);
    near(d[DIFFER_ROTATION], 2, 1e-4);
    near(d[DIFFER_TRANSLATION], 0, 1e-4);
    near(d[DIFFER_DEPTH], 0, 0);
}

/* Everything a tenth larger: errors of 0.1, 0.2 and 0.4 units, the longest baseline has 4. */
static void scaled(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    for (int i = 0; i < VIEWS; i++)
        other.cams[i].t[0] *= 1.1f;
    for (int i = 0; i < PIXELS; i++)
        other.depth[i] *= 1.1f;
    measure(d);
    near(d[DIFFER_ROTATION], 0, 0);
    near(d[DIFFER_TRANSLATION], 5, 1e-4);
    near(d[DIFFER_DEPTH], 10, 1e-4);
    near(d[DIFFER_ALIGNED], 0, 1e-4);
    near(d[DIFFER_FOCAL], 0, 0);
}

/* A third of the depths 10 % less, a third 4 % more. */
static void depths_uneven(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    for (int i = 0; i < PIXELS; i++)
        other.depth[i] *= i % 3 == 0 ? 0.9f : i % 3 == 1 ? 1.04f : 1.02f;
    measure(d);
    near(d[DIFFER_DEPTH], 4, 1e-3);
    near(d[DIFFER_ALIGNED], 100 * (1.04 / 1.02 - 1), 1e-3);
}

static void focal_lengths(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    for (int i = 0; i < VIEWS; i++) {
        other.cams[i].fx *= i < 2 ? 0.97f : 1.03f;
        other.cams[i].fy *= 1.03f;
    }
    measure(d);
    near(d[DIFFER_FOCAL], 3, 1e-3);
    near(d[DIFFER_ROTATION], 0, 0);
}

static double display(double log2_radiance, int view)
{
    double x = log2(exp2(log2_radiance) + 1e-6) + (double)log2t[view] - 0.5;
    return 1 / (1 + exp(-0.7 * fmax(x, -10)));
}

/* Half a stop more in green; display values by the formula of the curve. */
static void brighter(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES], sum = 0;
    for (int i = 0; i < PIXELS; i++) {
        double stops = i % 7 - 3 + 0.25;
        dc(&other, 1)[i] += (float)(0.5 * log(2) / BASIS0);
        int view = i / (SIDE * SIDE);
        sum += pow(display(stops + 0.5, view) - display(stops, view), 2);
    }
    measure(d);
    near(d[DIFFER_RADIANCE], 0.5 / sqrt(3), 1e-6);
    near(d[DIFFER_PSNR], -10 * log10(sum / (3 * PIXELS)), 1e-3);
    near(d[DIFFER_OPACITY], 0, 0);
}

/* A stop more, and a curve that expects half of it and is half a stop darker: the same picture. */
static void brighter_with_its_own_curve(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < PIXELS; i++)
            dc(&other, c)[i] += (float)(log(2) / BASIS0);
    tonemap_linear(&other.p.tone, 0.7f, -10, 10, 1);
    for (int c = 0; c < 3; c++)
        other.p.tone.p[(c + 1) * TONE_PER_COLOUR - 1] -= 0.7f * 0.5f;
    measure(d);
    near(d[DIFFER_RADIANCE], 1, 1e-6);
    assert_true(d[DIFFER_PSNR] > 90);
}

/* Opacities 1/2 and 3/4 for every second pixel. */
static void opacities(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    for (int i = 0; i < PIXELS; i++) {
        ref.features[VOXEL_LOGIT * PIXELS + i] = 0;
        other.features[VOXEL_LOGIT * PIXELS + i] = i % 2 ? logf(3) : 0;
    }
    measure(d);
    near(d[DIFFER_OPACITY], 0.25 / sqrt(2), 1e-7);
    near(d[DIFFER_RADIANCE], 0, 0);
}

/* Plain AnySplat: colours 0.5 and 0.6 of the display, those below 0 are black. */
static void display_colours(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    ref.p.linear = other.p.linear = true;
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < PIXELS; i++) {
            dc(&ref, c)[i] = i % 2 ? 0 : -10;
            dc(&other, c)[i] = i % 2 ? (float)(0.1 / BASIS0) : -5;
        }
    measure(d);
    near(d[DIFFER_PSNR], 20 + 10 * log10(2), 1e-4);
    assert_true(isnan(d[DIFFER_RADIANCE]));
}

static void what_cannot_be_said(void **state)
{
    (void)state;
    double d[DIFFER_FIGURES];
    other.depth[100] = NAN;
    dc(&other, 2)[5] = NAN;
    for (int i = 0; i < VIEWS; i++)
        ref.cams[i].t[0] = 0;
    measure(d);
    assert_true(isnan(d[DIFFER_TRANSLATION]) && isnan(d[DIFFER_DEPTH]));
    assert_true(isnan(d[DIFFER_ALIGNED]) && isnan(d[DIFFER_RADIANCE]) && isnan(d[DIFFER_PSNR]));
    near(d[DIFFER_ROTATION], 0, 0);
    near(d[DIFFER_OPACITY], 0, 0);
    make(&ref);
    make(&other);
    ref.p.features = NULL;
    measure(d);
    assert_true(isnan(d[DIFFER_RADIANCE]) && isnan(d[DIFFER_PSNR]) && isnan(d[DIFFER_OPACITY]));
    near(d[DIFFER_DEPTH], 0, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(nothing_apart, both),
        cmocka_unit_test_setup(moved_as_a_whole, both),
        cmocka_unit_test_setup(cameras_turned, both),
        cmocka_unit_test_setup(scaled, both),
        cmocka_unit_test_setup(depths_uneven, both),
        cmocka_unit_test_setup(focal_lengths, both),
        cmocka_unit_test_setup(brighter, both),
        cmocka_unit_test_setup(brighter_with_its_own_curve, both),
        cmocka_unit_test_setup(opacities, both),
        cmocka_unit_test_setup(display_colours, both),
        cmocka_unit_test_setup(what_cannot_be_said, both),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
