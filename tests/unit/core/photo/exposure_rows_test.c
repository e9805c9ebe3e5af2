/* Frames of a few exposures, patch by patch: which of their rows surely have no other exposure. */
#include "core/photo/exposure_probe.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#define CODE (1.0f / 4096)

/* A frame whose patches all have so many codes; accurate. */
static void even(float codes, struct exposure_probe *out)
{
    memset(out, 0, sizeof *out);
    out->linear = true;
    out->step = CODE;
    out->overlap = 1.0f;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        out->x[i] = fminf(codes * CODE, 1.0f);
        out->sd[i] = 0.05f * CODE;
        out->floor[i] = 8.0f * CODE;
        out->state[i] = codes >= 3900.0f ? EXPOSURE_PROBE_CLIPPED
                        : codes < 8.0f   ? EXPOSURE_PROBE_DARK
                                         : EXPOSURE_PROBE_GOOD;
    }
}

static void set_sd(struct exposure_probe *p, float codes)
{
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        p->sd[i] = codes * CODE;
}

static float moving; // share

static struct exposure_probe_rows rows_of(const struct exposure_probe *a,
                                          const struct exposure_probe *b, double log2, double other)
{
    struct exposure_probe_rows r;
    const struct exposure_probe_rivals rivals = {log2, other, moving};
    exposure_probe_refuted(a, b, &rivals, &r);
    return r;
}

/* The torn row is the only one that is neither refuted nor alike, whichever exposure is longer. */
static void test_refuted_rows(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    for (int stops = -1; stops <= 1; stops += 2) {
        even(200.0f, &a);
        even(200.0f * exp2f((float)stops), &b);
        for (int i = 5 * EXPOSURE_PROBE_EDGE; i < 6 * EXPOSURE_PROBE_EDGE; i++)
            b.x[i] = 200.0f * CODE;
        struct exposure_probe_rows r = rows_of(&a, &b, stops, 0.0);
        assert_int_equal(r.refuted, ~(1u << 5));
        assert_int_equal(r.alike, 0);
    }
}

/* Alike: black, and what clips in any case. Not: a row of 1.7 codes, one patch of many, noise. */
static void test_alike_rows(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(0.0f, &a);
    b = a;
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).refuted, 0);
    even(3686.0f, &a);
    even(5000.0f, &b);
    assert_int_equal(rows_of(&a, &b, 1.0, 0.8).alike, UINT32_MAX);
    even(1.8f, &a);
    even(1.8f * 0.0625f, &b);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
    even(0.0f, &a);
    b = a;
    a.x[40] = 40.0f * CODE;
    b.x[40] = 2.5f * CODE;
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, ~2u);
    even(1.0f, &a);
    even(0.0625f, &b);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    set_sd(&a, 3.0f);
    set_sd(&b, 3.0f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
    set_sd(&a, 1.0f);
    set_sd(&b, 1.0f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    a.overlap = 16.0f; // few pixels of their own
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
}

/* A wrong black level, few patches and patches that share pixels refute nothing. */
static void test_weak_evidence(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(-0.4f, &a);
    even(0.4f, &b);
    assert_int_equal(rows_of(&a, &b, 4.0, 3.0).refuted, 0);
    even(0.0f, &a);
    b = a;
    a.x[40] = 100.0f * CODE;
    b.x[40] = 200.0f * CODE;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, 0); // one patch may be anything
    even(20.0f, &a);
    even(40.0f, &b);
    set_sd(&a, 12.0f);
    set_sd(&b, 12.0f);
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, UINT32_MAX);
    a.overlap = 16.0f;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, 0);
}

/* What is known of one frame only bounds the light, and one patch does not outvote a row. */
static void test_mixed_evidence(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(8192.0f, &a);
    even(1.4f, &b);
    assert_int_equal(rows_of(&a, &b, -11.0, -12.5).alike, 0); // by b the light is twice that of a
    even(0.0f, &a);
    b = a;
    a.linear = b.linear = false;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        a.floor[i] = 0.5f * CODE;
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    even(100.0f, &a);
    even(200.0f, &b);
    a.linear = b.linear = false;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i += 2) { // says nothing
        a.state[i] = EXPOSURE_PROBE_DARK;
        a.floor[i] = 300.0f * CODE;
    }
    assert_int_equal(rows_of(&a, &b, 1.0, 0.001).refuted, UINT32_MAX);
    even(20.0f, &a);
    even(40.0f, &b);
    set_sd(&a, 5.0f);
    set_sd(&b, 5.0f);
    a.x[40] = b.x[40] = 1000.0f * CODE;
    a.sd[40] = b.sd[40] = 0.05f * CODE;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, UINT32_MAX);
}

/* Every patch dark, by a response that only bounds what is dark. */
static void set_bound(struct exposure_probe *p, float floor_codes)
{
    p->linear = false;
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++) {
        p->state[i] = EXPOSURE_PROBE_DARK;
        p->floor[i] = floor_codes * CODE;
    }
}

/* The light of a patch counts by the frame that knows it better; with 1 code the ratios 1 and 1/16
 * look alike, with 4 they do not. */
static void test_light_by_both_frames(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(1.0f, &a);
    even(0.25f, &b);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    even(4.0f, &a);
    set_sd(&a, 4.0f);
    even(0.0625f, &b);
    set_sd(&b, 0.003f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    set_bound(&a, 8.0f); // b alone knows
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    even(0.25f, &b);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
    even(1.0f, &a); // a alone knows
    even(0.0f, &b);
    set_sd(&b, 4.0f);
    set_bound(&b, 8.0f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    even(4.0f, &a);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
}

/* Where both frames but bound the light, any within the bounds may make the ratios differ. */
static void test_light_that_is_bounded(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(0.0f, &a); // at most 1 code, by either
    b = a;
    set_sd(&a, 4.0f);
    set_sd(&b, 4.0f);
    set_bound(&a, 1.0f);
    set_bound(&b, 8.0f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    set_bound(&a, 8.0f);
    set_bound(&b, 0.0625f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, UINT32_MAX);
    set_bound(&b, 0.25f);
    assert_int_equal(rows_of(&a, &b, 0.0, -4.0).alike, 0);
    even(5000.0f, &a); // so bright that both ratios saturate
    even(5000.0f, &b);
    assert_int_equal(rows_of(&a, &b, 1.0, 0.5).alike, UINT32_MAX);
    assert_int_equal(rows_of(&a, &b, -0.2, -1.0).alike, UINT32_MAX);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        a.x[i] = b.x[i] = 0.125f; // a few pixels of the patch are
    assert_int_equal(rows_of(&a, &b, 1.0, 0.5).alike, 0);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        a.x[i] = 1.0f;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.5).alike, UINT32_MAX);
    even(5000.0f, &b);
    even(0.0f, &a); // 64 to 256 codes: the shorter one may not saturate
    set_bound(&a, 256.0f);
    assert_int_equal(rows_of(&a, &b, 5.0, 6.0).alike, 0);
    assert_int_equal(rows_of(&a, &b, 7.0, 6.0).alike, UINT32_MAX);
    set_bound(&a, 32.0f); // too little for the other ratio
    assert_int_equal(rows_of(&a, &b, 5.0, 6.0).alike, 0);
    even(5000.0f, &a); // 1 to 16: not alike, though the least is
    even(0.0f, &b);
    set_bound(&b, 8.0f);
    assert_int_equal(rows_of(&a, &b, -12.0, -13.0).alike, 0);
    set_bound(&b, 0.5f);
    assert_int_equal(rows_of(&a, &b, -12.0, -13.0).alike, UINT32_MAX);
}

/* Patches that are dark or clipped bound a ratio; two of one exposure are so in both. */
static void test_refuted_by_bounds(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(0.0f, &a);
    even(40.0f, &b); // 5 codes in a, cut off at black
    assert_int_equal(rows_of(&a, &b, 4.0, 3.0).refuted, UINT32_MAX);
    a.linear = b.linear = false;
    assert_int_equal(rows_of(&a, &b, 4.0, 3.0).refuted, 0);
    even(2.0f, &a);
    even(7.0f, &b);
    a.linear = b.linear = false;
    assert_int_equal(rows_of(&a, &b, 2.0, 0.0).refuted, UINT32_MAX);
    assert_int_equal(rows_of(&a, &b, 2.0, 0.01).refuted, 0);
    even(8192.0f, &a);
    even(2048.0f, &b);
    assert_int_equal(rows_of(&a, &b, -1.0, -2.0).refuted, 0);
    assert_int_equal(rows_of(&a, &b, -1.0, 0.0).refuted, UINT32_MAX);
    for (int i = 0; i < EXPOSURE_PROBE_PATCHES; i++)
        b.state[i] = EXPOSURE_PROBE_CLIPPED;
    assert_int_equal(rows_of(&a, &b, -1.0, 0.0).refuted, UINT32_MAX);
    assert_int_equal(rows_of(&a, &b, -1.0, -0.01).refuted, 0);
}

/* A row of the other exposure with somebody in it, who covers an eighth of the picture and no more
 * than half of a row. */
static void test_rows_that_move(void **state)
{
    struct exposure_probe a, b;
    (void)state;
    even(200.0f, &a);
    even(400.0f, &b);
    for (int i = 5 * EXPOSURE_PROBE_EDGE; i < 6 * EXPOSURE_PROBE_EDGE; i++)
        b.x[i] = (i % 2 ? 200.0f : 800.0f) * CODE;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, UINT32_MAX);
    moving = 0.125f;
    assert_int_equal(rows_of(&a, &b, 1.0, 0.0).refuted, ~(1u << 5));
    moving = 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_refuted_rows),          cmocka_unit_test(test_alike_rows),
        cmocka_unit_test(test_weak_evidence),         cmocka_unit_test(test_refuted_by_bounds),
        cmocka_unit_test(test_mixed_evidence),        cmocka_unit_test(test_light_by_both_frames),
        cmocka_unit_test(test_light_that_is_bounded), cmocka_unit_test(test_rows_that_move),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
