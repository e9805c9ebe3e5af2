/* Probes of a made-up scene, without pictures: what comparison with a known frame says. */
#include "core/photo/exposure_anchor.h"

#include "core/base/splitmix.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define TOLERANCE 0.10

static struct exposure_anchor anchor;
static struct exposure_probe frame;
static uint64_t seed;
static float noise; // relative, of every patch

static float uniform(void)
{
    return (float)(splitmix_next(&seed) >> 40) * 0x1p-24f;
}

/* A patch of the scene at an exposure: six stops in all, the same for every probe. */
static float patch(int i, double stops)
{
    return 0.02f * exp2f(6.0f * (float)(i * 389 % EXPOSURE_PROBE_PATCHES) / EXPOSURE_PROBE_PATCHES +
                         (float)stops);
}

static void set_patch(struct exposure_probe *w, int i, float x)
{
    const float sd = fmaxf(noise, 1e-4f) * x;
    x *= 1.0f + noise * 3.46f * (uniform() - 0.5f);
    w->x[i] = fminf(x, 1.0f);
    w->sd[i] = sd;
    w->floor[i] = 1.0f / 512;
    w->state[i] = x >= 1.0f         ? EXPOSURE_PROBE_CLIPPED
                  : x < w->floor[i] ? EXPOSURE_PROBE_DARK
                                    : EXPOSURE_PROBE_GOOD;
}

static void count_states(struct exposure_probe *w)
{
    w->good = w->dark = w->clipped = 0;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        w->good += w->state[i] == EXPOSURE_PROBE_GOOD;
        w->dark += w->state[i] == EXPOSURE_PROBE_DARK;
        w->clipped += w->state[i] == EXPOSURE_PROBE_CLIPPED;
    }
}

/* All patches at one exposure, those of `odd` rows or every other patch at another. */
static void make_probe(struct exposure_probe *w, double stops, uint32_t rows, double other)
{
    *w = (struct exposure_probe){.linear = true, .step = 1.0f / 4096, .overlap = 1.0f};
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        set_patch(w, i, patch(i, rows >> i / EXPOSURE_PROBE_EDGE & 1 ? other : stops));
    count_states(w);
}

static int make_anchor(void **state)
{
    (void)state;
    seed = 1;
    noise = 0;
    anchor = (struct exposure_anchor){
        .stops = 3, .recorded = 3, .held = true, .proven = true, .sure = UINT32_MAX};
    make_probe(&anchor.seen, 0, 0, 0);
    return 0;
}

static struct exposure_anchor_ratio compare(double slack)
{
    struct exposure_anchor_ratio r;
    const struct exposure_anchor_doubt doubt = {TOLERANCE, slack, 0};
    exposure_anchor_compare(&anchor, &frame, &doubt, &r);
    return r;
}

static void the_exposure_is_that_of_the_anchor_times_the_ratio(void **state)
{
    (void)state;
    make_probe(&frame, -1, 0, 0);
    struct exposure_anchor_ratio r = compare(0);
    assert_true(r.accurate && !r.changed && !r.torn);
    assert_true(fabs(r.stops - 2) < 0.01 && fabs((double)r.ratio + 1) < 0.01);
    assert_true(r.patches > EXPOSURE_PROBE_PATCHES / 2 && r.error < 0.001);
}

static void errors_of_the_anchor_count(void **state)
{
    (void)state;
    make_probe(&frame, -1, 0, 0);
    anchor.error = 0.01;
    struct exposure_anchor_ratio r = compare(0);
    assert_true(r.accurate && r.error >= 0.01 && r.error < 0.011);
    anchor.error = 0.05; // six of them are more than the tolerance
    assert_false(compare(0).accurate);
}

static void few_patches_prove_nothing(void **state)
{
    (void)state;
    make_probe(&frame, 0, 0, 0);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        if (i % 256) {
            frame.state[i] = EXPOSURE_PROBE_DARK;
            frame.floor[i] = 2;
        }
    count_states(&frame);
    assert_false(compare(0).accurate);
}

static void flicker_widens_the_bounds(void **state)
{
    (void)state;
    make_probe(&frame, 3, 0, 0); // a third is clipped
    struct exposure_anchor_ratio still = compare(0), r;
    anchor.slack = 0.3;
    r = compare(0);
    assert_true(isfinite(still.lo) && still.lo > 3);
    assert_true(fabs(r.lo - (still.lo - 0.3)) < 1e-9);
    make_probe(&frame, -5, 0, 0); // a third is dark
    r = compare(0);
    anchor.slack = 0;
    still = compare(0);
    assert_true(isfinite(still.hi) && fabs(r.hi - (still.hi + 0.3)) < 1e-9);
}

static bool looks_alike(double slack)
{
    float moved;
    const struct exposure_anchor_doubt doubt = {TOLERANCE, slack, 0};
    return exposure_anchor_alike(&anchor, &frame, &doubt, &moved);
}

static void rows_of_another_exposure_are_torn_unless_the_lamp_may_do_it(void **state)
{
    (void)state;
    make_probe(&frame, -1, 0xff, -0.7);
    assert_true(compare(0).torn && !compare(0.2).torn);
    anchor.slack = 0.2;
    assert_false(compare(0).torn);
    assert_false(looks_alike(0));
}

static void parts_change_if_noise_is_no_reason(void **state)
{
    (void)state;
    make_probe(&frame, -1, 0x55555555, 0); // every other row
    assert_true(compare(0).changed && !compare(0.5).changed);
    noise = 0.5f;
    make_probe(&anchor.seen, 0, 0, 0);
    make_probe(&frame, -1, 0, 0);
    assert_false(compare(0).changed);
    noise = 0;
}

static void the_same_exposure_looks_alike(void **state)
{
    (void)state;
    make_probe(&frame, 0, 0, 0);
    assert_true(looks_alike(0));
    make_probe(&frame, 0.08, 0, 0);
    assert_false(looks_alike(0));
    assert_true(looks_alike(0.05));
}

static struct exposure_probe_rows refute(double stops, double other, double slack)
{
    const struct exposure_anchor_pair pair = {stops, other};
    const struct exposure_anchor_doubt doubt = {TOLERANCE, slack, 0};
    struct exposure_probe_rows rows = {0};
    exposure_anchor_refute(&anchor, &frame, &pair, &doubt, &rows);
    return rows;
}

static void rows_refute_the_other_exposure_beyond_flicker(void **state)
{
    (void)state;
    make_probe(&frame, -1, 0, 0);
    assert_true(refute(2, 2.3, 0).refuted == UINT32_MAX);
    assert_true(refute(2, 2.3, 0.35).refuted == 0);
    anchor.slack = 0.35;
    assert_true(refute(2, 2.3, 0).refuted == 0);
    anchor.slack = 0;
    anchor.sure = 0xf0; // rows that may be torn themselves are no evidence
    assert_true(refute(2, 2.3, 0).refuted == 0xf0);
    make_probe(&frame, -1, 1 << 6, -0.7);
    assert_true(refute(2, 2.3, 0).refuted == 0xb0);
}

/* Every patch is dark, by a response that says nothing there. */
static void make_dark(struct exposure_probe *w, double stops)
{
    make_probe(w, stops, 0, 0);
    w->linear = false;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        w->state[i] = EXPOSURE_PROBE_DARK;
        w->floor[i] = 0.05f;
    }
    count_states(w);
}

/* If the other exposure is the recorded one of the anchor, a row of it repeats the anchor's
 * numbers, dark and clipped ones, too, whatever its exposure was measured to be. */
static void the_recorded_exposure_repeats_the_numbers(void **state)
{
    (void)state;
    make_dark(&anchor.seen, -8);
    make_dark(&frame, -6);
    anchor.stops = 3.02;
    const uint32_t same = refute(5, 3, 0).refuted;
    anchor.recorded = 3.02;
    const uint32_t other = refute(5, 3, 0).refuted;
    assert_true(same == UINT32_MAX && other == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(the_exposure_is_that_of_the_anchor_times_the_ratio, make_anchor),
        cmocka_unit_test_setup(errors_of_the_anchor_count, make_anchor),
        cmocka_unit_test_setup(few_patches_prove_nothing, make_anchor),
        cmocka_unit_test_setup(flicker_widens_the_bounds, make_anchor),
        cmocka_unit_test_setup(rows_of_another_exposure_are_torn_unless_the_lamp_may_do_it,
                               make_anchor),
        cmocka_unit_test_setup(parts_change_if_noise_is_no_reason, make_anchor),
        cmocka_unit_test_setup(the_same_exposure_looks_alike, make_anchor),
        cmocka_unit_test_setup(rows_refute_the_other_exposure_beyond_flicker, make_anchor),
        cmocka_unit_test_setup(the_recorded_exposure_repeats_the_numbers, make_anchor),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
