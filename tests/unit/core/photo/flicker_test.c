/* Lamps of known depth, frequency and phase, seen by global and rolling shutters. */
#include "core/photo/flicker.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define PI 3.14159265358979323846
#define LONG_S 0.01

static uint64_t state;

static double uniform(void)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(state >> 11) * 0x1p-53;
}

static double noise(void)
{
    double sum = -6.0;
    for (int i = 0; i < 12; i++)
        sum += uniform();
    return sum;
}

struct lamp {
    double hz, depth, phase, readout_s;
    bool dim;     // all but 26 patches, each in a row of its own
    double light; // 0: as much as 1
    double noise; // squared, relative to a good sensor's
    double walks; // by so much a person changes some rows of each short frame
    bool linear;
};

static void measure_frame(const struct lamp *l, double start_s, double time_s,
                          struct exposure_probe *w)
{
    int first = l->walks > 0.0 ? (int)(32.0 * uniform()) - 8 : 0;
    double by = l->walks > 0.0 ? l->walks * (2.0 * uniform() - 1.0) : 0.0;
    memset(w, 0, sizeof *w);
    w->overlap = 1.0f;
    w->linear = l->linear;
    w->step = 1.0f / 4096;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        double t =
            start_s + l->readout_s * (i / EXPOSURE_PROBE_EDGE) / EXPOSURE_PROBE_EDGE + 0.5 * time_s;
        double h = PI * l->hz * time_s, m = h > 0.0 ? sin(h) / h : 1.0;
        double x = 30.0 * time_s * exp2(i % 5 - 3.0) *
                   (1.0 + l->depth * m * sin(2.0 * PI * l->hz * t + l->phase));
        x *= l->dim && i % 40 != 4 ? 0.01 : 1.0;
        x *= l->light > 0.0 ? l->light : 1.0;
        bool passed = i / EXPOSURE_PROBE_EDGE >= first && i / EXPOSURE_PROBE_EDGE < first + 12;
        x *= passed && time_s < LONG_S ? 1.0 + by : 1.0;
        w->sd[i] = (float)sqrt((x * 1e-5 + 1e-8) * fmax(l->noise, 1.0));
        w->x[i] = (float)fmin(x + (double)w->sd[i] * noise(), 1.0);
        if (!l->linear && w->x[i] < 0.002f)
            w->x[i] = 0.0f; // cut off at black
        w->floor[i] = 0.002f;
        w->state[i] = x > 0.9            ? EXPOSURE_PROBE_CLIPPED
                      : w->x[i] < 0.002f ? EXPOSURE_PROBE_DARK
                                         : EXPOSURE_PROBE_GOOD;
    }
}

static struct flicker_light find_light(const struct lamp *l, double fps)
{
    struct flicker f = {0};
    struct exposure_probe w;
    struct flicker_light out;
    int k = 0;
    for (; k < 6; k++) {
        measure_frame(l, k / fps, LONG_S, &w);
        flicker_add_long(&f, &w, LONG_S);
    }
    for (; k < 6 + FLICKER_FRAMES; k++) {
        double t = LONG_S / (2 + k % 4);
        measure_frame(l, 12.0 + k / fps, t, &w);
        flicker_add_short(&f, &w, 12.0 + k / fps, t);
    }
    flicker_find(&f, 1.0 / fps, &out);
    return out;
}

static void test_lamps(void **unused)
{
    static const double fps[] = {15.0, 25.0, 29.97, 30.0, 60.0, 90.0};
    (void)unused;
    for (int k = 0; k < 240; k++) {
        double hz = k % 2 ? 100.0 : 120.0, rate = fps[k / 2 % 6];
        struct lamp l = {hz, 0.05 + 0.6 * uniform(), 2.0 * PI * uniform(), .dim = k % 5 == 0};
        bool rolls = k % 3 > 0;
        l.readout_s = rolls ? (0.3 + 0.6 * uniform()) / rate : 0.0;
        struct flicker_light found = find_light(&l, rate);
        if (found.hz != hz || fabs(found.depth / l.depth - 1.0) > 0.35)
            fail_msg("%.0f Hz %.2f at %.2f fps, readout %.4f s: found %.0f Hz, %.2f", hz, l.depth,
                     rate, l.readout_s, found.hz, found.depth);
    }
}

/* What noise hides from the eye, all rows together show; and linear numbers below the floor of a
 * patch are right but for noise. */
static void test_faint_lamps(void **unused)
{
    (void)unused;
    for (int k = 0; k < 60; k++) {
        struct lamp l = {k % 2 ? 100.0 : 120.0, 0.3 + 0.3 * uniform(), 2.0 * PI * uniform(),
                         .readout_s = k % 3 ? 0.02 : 0.0};
        l.noise = k % 4 == 0 ? 3000.0 : 1.0;
        l.linear = k % 4 >= 2;
        l.light = l.linear ? 0.008 : k % 4 == 1 ? 0.05 : 1.0;
        struct flicker_light found = find_light(&l, 30.0);
        if (found.hz != l.hz || fabs(found.depth / l.depth - 1.0) > 0.35)
            fail_msg("lamp %d, %.0f Hz %.2f: found %.0f Hz, %.2f", k, l.hz, l.depth, found.hz,
                     found.depth);
    }
}

/* Somebody walks through, in good light and in bad. */
static void test_walkers(void **unused)
{
    (void)unused;
    for (int k = 0; k < 100; k++) {
        struct lamp l = {100.0, .readout_s = k % 2 ? 0.02 : 0.0, .walks = 0.8};
        l.noise = k % 3 ? 1.0 : 30.0;
        struct flicker_light found = find_light(&l, 30.0);
        if (found.hz != 0.0)
            fail_msg("walk %d: found %.0f Hz, %.2f", k, found.hz, found.depth);
    }
}

static void test_steady(void **unused)
{
    (void)unused;
    for (int k = 0; k < 50; k++) {
        struct lamp l = {100.0, .readout_s = k % 2 ? 0.02 : 0.0, .dim = k % 5 == 0};
        l.noise = k % 3 ? 1.0 : 1000.0;
        struct flicker_light found = find_light(&l, 30.0);
        assert_true(found.hz == 0.0 && found.depth == 0.0);
    }
    struct flicker_light none = {0};
    assert_true(flicker_stops(&none, 0.001) == 0.0 && flicker_steady_s(&none, 0.012) == 0.012);
}

static void test_exposures(void **unused)
{
    struct flicker_light l = {100.0, 0.5};
    (void)unused;
    assert_true(fabs(flicker_steady_s(&l, 0.012) - 0.01) < 1e-12);
    assert_true(fabs(flicker_steady_s(&l, 0.006) - 0.01) < 1e-12);
    assert_true(fabs(flicker_steady_s(&l, 0.128) - 0.13) < 1e-12);
    assert_true(flicker_steady_s(&l, 0.004) == 0.004); // the light does not allow
    assert_true(flicker_stops(&l, 0.02) < 1e-9 && fabs(flicker_stops(&l, 1e-6) - 1.0) < 1e-3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lamps),     cmocka_unit_test(test_faint_lamps),
        cmocka_unit_test(test_walkers),   cmocka_unit_test(test_steady),
        cmocka_unit_test(test_exposures),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
