/* Brackets of a known radiance, taken brighter or darker than their exposures say. */
#include "core/photo/exposure_even.h"

#include "core/photo/response.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { S = 64, PX = S * S, PLACES = 4, EACH = 3, ALL = PLACES * EACH };

static const float STEP = 3; // stops

static struct arena tmp;
static struct run run = {.tmp = &tmp};
static struct tonemap tone;
static struct views v;
static uint8_t rgb[ALL * PX * 3], masked[ALL * PX];
static float log2t[ALL], stops[ALL], off[ALL];
static int place[ALL - PLACES];

static int place_of(int i)
{
    return i < PLACES ? i : place[i - PLACES];
}

/* Photographs 0 .. 3 are the middle ones, then the shortest and the longest of each place. */
static void take_all(void)
{
    for (int i = 0; i < ALL; i++) {
        if (i >= PLACES)
            place[i - PLACES] = (i - PLACES) / 2;
        log2t[i] = i < PLACES ? 0 : i % 2 ? STEP : -STEP;
        for (int k = 0; k < 3 * PX; k++) {
            const float ramp = ((float)(k / 3) / (PX - 1) - 0.5f) * 12 + 0.3f * (float)place_of(i);
            const float z = response_display(&tone, k % 3, ramp + log2t[i] + off[i]);
            rgb[i * 3 * PX + k] = (uint8_t)lrintf(255 * z);
        }
    }
}

static void begin(void)
{
    v = (struct views){.n = PLACES,
                       .size = S,
                       .extent = squares(ALL, S),
                       .rgb = rgb,
                       .log2t = log2t,
                       .n_more = ALL - PLACES,
                       .place = place};
    memset(off, 0, sizeof off);
    response_fit(NULL, 0, 0, &tone);
    struct plan plan = plan_begin(1);
    exposure_even_plan(&plan, &v);
    arena_free(&tmp);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
}

static void assert_found(float within)
{
    assert_int_equal(exposure_even_run(&run, &v, &tone, stops), OK);
    for (int i = 0; i < ALL; i++) {
        if (fabsf(stops[i] - off[i]) >= within)
            print_message("photograph %d: %g, truth %g\n", i, (double)stops[i], (double)off[i]);
        assert_true(fabsf(stops[i] - off[i]) < within);
    }
}

/* Offsets with mean 0 over each place and each exposure are found to 0.02 stops. */
static void offsets_are_found(void **unused)
{
    (void)unused;
    static const float of[PLACES] = {0.4f, -0.1f, 0.2f, -0.5f};
    begin();
    for (int i = 0; i < PLACES; i++) {
        off[i] = of[i];
        off[PLACES + 2 * i] = -of[i] / 2;
        off[PLACES + 2 * i + 1] = -of[i] / 2;
    }
    take_all();
    assert_found(0.02f);
}

static void steady_light_is_left_alone(void **unused)
{
    (void)unused;
    begin();
    take_all();
    assert_found(1e-9f);
    off[1] = 0.03f; // root mean square over all: below the least
    take_all();
    off[1] = 0;
    assert_found(1e-9f);
}

/* What all photographs of an exposure share is the curve's, unless that is known. */
static void shared_offsets_need_a_known_curve(void **unused)
{
    (void)unused;
    begin();
    for (int i = 0; i < ALL; i++)
        off[i] = i < PLACES ? -0.2f : 0.1f;
    take_all();
    assert_int_equal(exposure_even_run(&run, &v, &tone, stops), OK);
    for (int i = 0; i < ALL; i++)
        assert_true(stops[i] == 0);
    v.srgb = true; // `tone` is what it says
    assert_found(0.02f);
}

/* Whoever walks through a third of a photograph changes nothing; nor does anything that is masked,
 * even over more than half of it. */
static void what_moved_does_not_count(void **unused)
{
    (void)unused;
    begin();
    v.srgb = true;
    for (int i = 0; i < PLACES; i++)
        off[i] = 0.2f, off[PLACES + 2 * i] = off[PLACES + 2 * i + 1] = -0.1f;
    take_all();
    for (int k = 0; k < PX; k += 3)
        memset(rgb + 3 * (size_t)k, 90, 3);
    assert_found(0.05f);
    v.masked = masked;
    for (int k = 0; k < PX; k++)
        if (k % 5 < 3) {
            masked[k] = 1;
            memset(rgb + 3 * (size_t)k, 90, 3);
        }
    for (int k = 0; k < PX; k++)
        masked[k] |= k % 3 == 0;
    assert_found(0.02f);
}

/* Black, white and far apart: finite, and 0 where nothing is shared. */
static void nothing_in_common(void **unused)
{
    (void)unused;
    begin();
    for (int i = 0; i < ALL; i++)
        memset(rgb + (size_t)i * 3 * PX, i % 2 ? 255 : 0, 3 * PX);
    for (int i = 0; i < ALL; i++)
        log2t[i] = i % 2 ? 26 : -26;
    assert_int_equal(exposure_even_run(&run, &v, &tone, stops), OK);
    for (int i = 0; i < ALL; i++)
        assert_true(stops[i] == 0);
    v.n_more = 0;
    assert_int_equal(exposure_even_run(&run, &v, &tone, stops), OK);
    assert_true(stops[0] == 0);
    arena_free(&tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(offsets_are_found),
        cmocka_unit_test(steady_light_is_left_alone),
        cmocka_unit_test(shared_offsets_need_a_known_curve),
        cmocka_unit_test(what_moved_does_not_count),
        cmocka_unit_test(nothing_in_common),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
