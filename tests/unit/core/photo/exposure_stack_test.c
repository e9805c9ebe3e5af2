/* Places with a known radiance, photographed under a known curve: which exposures are kept, which
 * one stands for the place, and what the one picture of all of them says. */
#include "core/photo/exposure_stack.h"

#include "core/photo/response.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { S = 64, PX = S * S, PLACES = 3, ALL = 10 };

static struct arena tmp;
static struct run run = {.tmp = &tmp};
static struct tonemap tone; // middle exposure 2^3
static struct views v;
static char names[ALL][NAME_CAP];
static uint8_t rgb[ALL * PX * 3];
static float log2t[ALL];
static int place[ALL - PLACES];

/* log2 radiance of a value: a ramp over the picture. */
static float true_log2(int k, float reach)
{
    return ((float)(k / 3) / (PX - 1) - 0.5f) * 2 * reach;
}

/* A sensor that is black and white before its curve ends. */
static void take_photo(int i, float t, float reach)
{
    for (int k = 0; k < 3 * PX; k++) {
        float z = response_display(&tone, k % 3, true_log2(k, reach) + t - tone.mid_log2t);
        rgb[i * 3 * PX + k] = (uint8_t)lrintf(255 * fminf(fmaxf(1.02f * z - 0.01f, 0), 1));
    }
    names[i][0] = (char)('a' + i);
    log2t[i] = t;
}

/* Place 0: a (all white), d, e, f, g (as e); place 1: b (all black), h, i, j; place 2: c. */
static void begin_places(float reach)
{
    static const float t[ALL] = {29, -23, 3.5f, -3, 3, 9, 3, 3, -3, 9};
    static const int of[ALL - PLACES] = {0, 0, 0, 0, 1, 1, 1};
    v = (struct views){.n = PLACES,
                       .size = S,
                       .extent = squares(ALL, S),
                       .names = names,
                       .rgb = rgb,
                       .log2t = log2t,
                       .mid_log2t = 3,
                       .n_more = ALL - PLACES,
                       .place = place};
    response_fit(NULL, 0, 3, &tone);
    for (int i = 0; i < ALL; i++)
        take_photo(i, t[i], i == 2 ? 1 : reach);
    memcpy(place, of, sizeof place);
    struct plan plan = plan_begin(3);
    exposure_stack_choose_plan(&plan, &v);
    exposure_stack_merge_plan(&plan, &v);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
}

static void assert_names(const char *want)
{
    assert_int_equal(strlen(want), v.n + v.n_more);
    for (int i = 0; i < v.n + v.n_more; i++) {
        assert_int_equal(names[i][0], want[i]);
        for (int k = v.n; i < v.n && k < v.n + v.n_more; k++)
            assert_true(v.place[k - v.n] != i || log2t[k] != log2t[i]);
    }
}

/* Photographs without new information are removed. */
static void test_choice(void **state)
{
    (void)state;
    for (int threads = 1; threads <= 3; threads += 2) {
        begin_places(7);
        assert_int_equal(pool_open(&run.pool, threads), OK);
        assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
        pool_close(run.pool);
        run.pool = NULL;
        assert_names("ehcdfij");
        assert_true(v.n == 3 && v.place[1] == 0 && v.place[2] == 1 && v.mid_log2t == 3);
        assert_int_equal(tmp.used, 0);
        arena_free(&tmp);
    }
    static uint8_t e[3 * PX]; // pixels go with their name
    memcpy(e, rgb, sizeof e);
    take_photo(0, 3, 7);
    assert_memory_equal(e, rgb, sizeof e);
}

static void test_staggered(void **state)
{
    (void)state;
    begin_places(7);
    assert_int_equal(exposure_stack_choose(&run, &tone, true, &v), OK);
    assert_names("eicdfhj");
    assert_true(fabsf(v.mid_log2t - 0.25f) < 1e-6f); // the middle of e, i, c
    arena_free(&tmp);
}

/* Nothing is seen at all: one photograph of each place stays. */
static void test_blind(void **state)
{
    (void)state;
    begin_places(7);
    memset(rgb, 0, sizeof rgb);
    assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
    assert_names("abc");
    arena_free(&tmp);
}

/* log2 radiance by the merged picture of a place. */
static float merged_log2(const struct views *m, const struct tonemap *curve, int i, int k)
{
    const float z = (float)m->rgb[i * 3 * PX + k] / 255;
    return response_radiance_log(curve, k % 3, z, m->log2t[i]) * 1.44269504f;
}

static uint8_t masked[ALL * PX];

/* What is masked in a photograph says nothing, and comes from the others. */
static void test_masked(void **state)
{
    (void)state;
    enum { EIGHTH = 3 * PX / 8 };
    struct views m;
    struct tonemap curve;
    begin_places(7);
    v.masked = memset(masked, 0, sizeof masked);
    memset(masked + 4 * PX, 1, PX); // all of e
    memset(rgb + 3 * 4 * PX, 77, 3 * PX);
    memset(masked + 3 * PX + PX / 4, 1, PX / 4); // of d, a half of that of f and g
    memset(rgb + 3 * (3 * PX + PX / 4), 77, 3 * PX / 4);
    memset(masked + 5 * PX + EIGHTH, 1, PX / 8);
    memset(masked + 6 * PX + EIGHTH, 1, PX / 8);
    assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
    assert_names("ghcdfij"); // g in place of e
    assert_true(masked[3 * PX + PX / 4] && !masked[3 * PX] && !masked[EIGHTH - 1]);
    assert_int_equal(exposure_stack_merge(&run, &v, &tone, &m, &curve), OK);
    for (int k = 0; k < PX; k++)
        assert_int_equal(m.masked[k], k >= EIGHTH && k < PX / 2); // by all three
    for (int k = 0; k < 3 * PX; k++) {
        float x = true_log2(k, 7);
        assert_true(fabsf(x) > 6 || m.masked[k / 3] ||
                    fabsf(merged_log2(&m, &curve, 0, k) - x) < 0.2f);
    }
    v.masked = NULL;
    arena_reset(&tmp, 0);
    arena_free(&tmp);
}

static void test_drop(void **state)
{
    (void)state;
    static struct camera cams[PLACES] = {{.w = 1}, {.w = 2}, {.w = 3}};
    bool keep[ALL];
    begin_places(7);
    v.cams = cams;
    for (int i = 0; i < ALL; i++)
        keep[i] = i != 0 && i != 8;
    exposure_stack_drop(&v, keep);
    assert_names("bchj");
    assert_true(v.n == 2 && v.place[0] == 0 && v.place[1] == 0);
    assert_true(cams[0].w == 2 && cams[1].w == 3 && log2t[3] == 9);
    arena_free(&tmp);
}

static void test_picture(void **state)
{
    (void)state;
    struct views m;
    struct tonemap curve;
    begin_places(7);
    assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
    assert_int_equal(exposure_stack_merge(&run, &v, &tone, &m, &curve), OK);
    assert_true(m.n == 3 && m.n_more == 0 && tmp.used > 0);
    for (int k = 0; k < 3 * PX; k++) {
        float x = true_log2(k, 7);
        for (int i = 0; i < 2 && fabsf(x) < 6; i++)
            assert_true(fabsf(merged_log2(&m, &curve, i, k) - x) < 0.2f);
        assert_true(fabsf(merged_log2(&m, &curve, 2, k) - true_log2(k, 1)) < 0.15f);
    }
    arena_reset(&tmp, 0);
    arena_free(&tmp);
}

/* Values beyond all exposures get the bound of the nearest one. */
static void test_beyond(void **state)
{
    (void)state;
    struct views m;
    struct tonemap curve;
    begin_places(13);
    assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
    assert_int_equal(exposure_stack_merge(&run, &v, &tone, &m, &curve), OK);
    assert_true(merged_log2(&m, &curve, 0, 0) < -10 &&
                merged_log2(&m, &curve, 0, 3 * PX - 1) > 6.5f);
    for (int k = 3; k < 3 * PX; k++)
        assert_true(m.rgb[k] + 1 >= m.rgb[k - 3]);
    arena_reset(&tmp, 0);
    arena_free(&tmp);
}

/* Black in the shorter photographs, white in the longest: between what the nearest two tell. */
static void test_gap(void **state)
{
    (void)state;
    struct views m;
    struct tonemap curve;
    int between = 0;
    begin_places(13);
    memset(place, 0, sizeof place);
    v.n = 1;
    v.n_more = 2;
    take_photo(0, 3 - 12, 13);
    take_photo(1, 3 + 12, 13);
    take_photo(2, 3 - 10, 13);
    assert_int_equal(exposure_stack_merge(&run, &v, &tone, &m, &curve), OK);
    for (int k = 3; k < 3 * PX; k++) {
        const float x = merged_log2(&m, &curve, 0, k);
        assert_true(m.rgb[k] + 1 >= m.rgb[k - 3]);
        if (rgb[k] > 0 || rgb[2 * 3 * PX + k] > 0 || rgb[3 * PX + k] < 255)
            continue;
        assert_true(x > -9.5f && x < 3.5f);
        between++;
    }
    assert_true(between > PX / 2);
    arena_reset(&tmp, 0);
    arena_free(&tmp);
}

static void test_single(void **state)
{
    (void)state;
    struct views m;
    struct tonemap curve;
    begin_places(7);
    v.n_more = 0;
    assert_int_equal(exposure_stack_choose(&run, &tone, false, &v), OK);
    assert_names("abc");
    assert_int_equal(exposure_stack_merge(&run, &v, &tone, &m, &curve), OK);
    assert_true(m.rgb == rgb && m.log2t == log2t && tmp.used == 0);
    assert_memory_equal(&curve, &tone, sizeof tone);
    arena_free(&tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_choice), cmocka_unit_test(test_staggered),
        cmocka_unit_test(test_blind),  cmocka_unit_test(test_drop),
        cmocka_unit_test(test_masked), cmocka_unit_test(test_picture),
        cmocka_unit_test(test_beyond), cmocka_unit_test(test_gap),
        cmocka_unit_test(test_single)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
