/* Curves that are known are recovered from pictures at several exposures; extremes give a finite
 * rising curve. */
#include "core/photo/response.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 96, VIEWS = 6 };

typedef float curve_fn(float x); // log2 exposure -> display value

static float gamma_curve(float x)
{
    return fminf(powf(exp2f(x - 1.5f), 1.0f / 2.2f), 1.0f);
}

static float film_curve(float x)
{
    float u = 0.55f * x - 0.02f * x * fabsf(x);
    return 1.0f / (1.0f + expf(-u));
}

static float black_curve(float x)
{
    return 0.0f * x;
}

static float white_curve(float x)
{
    return 1.0f + 0.0f * x;
}

struct world {
    struct views v;
    struct arena tmp;
    struct run run;
    float log2t[VIEWS];
};

static uint32_t random_bits(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return *state >> 8;
}

/* View i of a scene that is cut differently in each view `cut`, `away` stops from middle. */
static void draw(struct world *w, curve_fn *curve, int i, int cut, float away)
{
    uint32_t seed = (uint32_t)i;
    for (int k = 0; k < SIZE * SIZE; k++) {
        float x = (float)(k % SIZE + 3 * cut), y = (float)(k / SIZE - 2 * cut);
        for (int c = 0; c < 3; c++) {
            float l = 2.5f * sinf(0.11f * x + (float)c) + 2.0f * cosf(0.07f * y + 0.05f * x) +
                      0.5f * (float)c;
            float noise = (float)random_bits(&seed) / (float)(1 << 24) - 0.5f;
            float z = 255.0f * curve(l + away) + 3.0f * noise;
            w->v.rgb[(i * SIZE * SIZE + k) * 3 + c] = (uint8_t)fminf(fmaxf(z + 0.5f, 0.0f), 255.0f);
        }
    }
}

/* The same scene, differently cut in each view, at exposures 0, step, 2 step, ... in turn. */
static void make_world(struct world *w, curve_fn *curve, int exposures, float step)
{
    memset(w, 0, sizeof *w);
    w->v =
        (struct views){.n = VIEWS, .size = SIZE, .extent = squares(VIEWS, SIZE), .log2t = w->log2t};
    w->v.rgb = malloc((size_t)VIEWS * SIZE * SIZE * 3);
    assert_non_null(w->v.rgb);
    w->v.mid_log2t = 0.5f * step * (float)(exposures - 1) - 3.0f;
    for (int i = 0; i < VIEWS; i++) {
        w->log2t[i] = step * (float)(i % exposures) - 3.0f;
        draw(w, curve, i, i, w->log2t[i] - w->v.mid_log2t);
    }
    assert_int_equal(arena_init(&w->tmp, "tmp", response_plan(&w->v)), OK);
    w->run = (struct run){.tmp = &w->tmp, .keep = &w->tmp};
}

static void free_world(struct world *w)
{
    free(w->v.rgb);
    arena_free(&w->tmp);
}

/* Root mean square difference in stops over display 12..243, the mean removed: the gauge is ours to
 * choose. */
static float curve_error(const struct tonemap *tone, curve_fn *truth)
{
    float sum = 0.0f, square = 0.0f;
    int n = 0;
    for (int z = 12; z <= 243; z++, n++) {
        float lo = -20.0f, hi = 20.0f;
        for (int i = 0; i < 40; i++) {
            float mid = 0.5f * (lo + hi);
            if (truth(mid) < (float)z / 255.0f)
                lo = mid;
            else
                hi = mid;
        }
        float x = response_radiance_log(tone, 1, (float)z / 255.0f, tone->mid_log2t) / 0.69314718f;
        sum += x - lo;
        square += (x - lo) * (x - lo);
    }
    return sqrtf(square / (float)n - sum * sum / (float)(n * n));
}

static void check_rising(const struct tonemap *tone)
{
    for (int k = 0; k < TONE_PARAMS; k++)
        assert_true(isfinite(tone->p[k]));
    for (int c = 0; c < 3; c++) {
        assert_true(fabsf(response_display(tone, c, 0.0f) - 0.5f) < 0.02f);
        for (float x = -15.0f; x < 15.0f; x += 0.25f)
            assert_true(response_display(tone, c, x + 0.25f) >= response_display(tone, c, x));
    }
}

static void recover(curve_fn *curve, int exposures, float step, float bound)
{
    struct world w;
    struct tonemap tone;
    make_world(&w, curve, exposures, step);
    assert_int_equal(response_run(&w.run, &w.v, &tone), OK);
    assert_int_equal(w.tmp.used, 0);
    check_rising(&tone);
    float err = curve_error(&tone, curve);
    if (err > bound)
        fail_msg("curve differs by %g stops, bound %g", (double)err, (double)bound);
    free_world(&w);
}

static void test_known_curves(void **state)
{
    (void)state;
    recover(gamma_curve, 3, 2.0f, 0.12f);
    recover(gamma_curve, 2, 4.0f, 0.1f);
    recover(film_curve, 3, 2.0f, 0.15f);
    recover(film_curve, 3, 4.0f, 0.1f);
    recover(film_curve, 6, 1.0f,
            0.25f); // every view alone with its exposure and its part of the scene
}

/* Three places, each with two exposures of its own and another light: only the two of one place can
 * be compared. */
static void test_brackets(void **state)
{
    (void)state;
    static const float t[VIEWS] = {-4, -1, 2.5f, -1.2f, 1.4f, 5};
    static const float light[VIEWS / 2] = {3, 0, -3};
    int place[VIEWS / 2] = {0, 1, 2};
    struct world w;
    struct tonemap tone;
    make_world(&w, film_curve, 1, 0.0f);
    for (int i = 0; i < VIEWS; i++) {
        w.log2t[i] = t[i];
        draw(&w, film_curve, i, i % 3, t[i] + light[i % 3]);
    }
    w.v.n = w.v.n_more = VIEWS / 2;
    w.v.place = place;
    assert_true(response_plan(&w.v) < w.tmp.size);
    assert_int_equal(response_run(&w.run, &w.v, &tone), OK);
    check_rising(&tone);
    float within = curve_error(&tone, film_curve);
    w.v.n = VIEWS;
    w.v.n_more = 0;
    assert_int_equal(response_run(&w.run, &w.v, &tone), OK);
    float across = curve_error(&tone, film_curve);
    print_message("  %.3f stops within places, %.3f across\n", (double)within, (double)across);
    assert_true(within < 0.15f && across > 0.2f);
    free_world(&w);
}

/* The mean over exposures, and the curve itself if they are one. */
static void test_spread(void **state)
{
    (void)state;
    struct tonemap tone, out;
    float log2t;
    response_fit(NULL, 0, 2.0f, &tone);
    for (int wide = 0; wide < 2; wide++) {
        const float lo = wide ? -3 : 0, hi = wide ? 6 : 0;
        response_spread(&tone, lo, hi, &out, &log2t);
        for (float x = -9; x < 6; x += 0.5f) {
            float mean = 0;
            for (int i = 0; i <= 90; i++)
                mean += response_display(&tone, 1, x + lo + (hi - lo) * (float)i / 90) / 91;
            float shown = response_display(&out, 1, x + log2t - out.mid_log2t);
            assert_true(fabsf(shown - mean) < 0.01f);
        }
        assert_true(fabsf(response_display(&out, 0, 0) - 0.5f) < 0.01f);
    }
}

static void test_single_exposure_is_near_srgb(void **state)
{
    (void)state;
    recover(gamma_curve, 1, 0.0f, 0.3f);
}

static float srgb_curve(float x)
{
    const float l = exp2f(x - 1.5f);
    return fminf(l < 0.0031308f ? 12.92f * l : 1.055f * powf(l, 1 / 2.4f) - 0.055f, 1.0f);
}

/* Places of other brightness at exposures that rise by `step`, by which their pictures get brighter
 * by `seen` only. They tell nothing of the curve, which stays near sRGB. */
static void take_places(float step, const float seen[VIEWS])
{
    struct world w;
    struct tonemap tone;
    make_world(&w, srgb_curve, VIEWS, step);
    for (int i = 0; i < VIEWS; i++)
        draw(&w, srgb_curve, i, i, seen[i]);
    assert_int_equal(response_run(&w.run, &w.v, &tone), OK);
    check_rising(&tone);
    const float err = curve_error(&tone, srgb_curve);
    if (err > 0.3f)
        fail_msg("curve differs by %g stops", (double)err);
    free_world(&w);
}

static void test_other_places(void **state)
{
    (void)state;
    take_places(0.1f, (float[]){0.0f, 0.9f, -0.8f, 0.3f, -0.5f, 0.6f}); // held by hand, in the sun
    take_places(0.6f,
                (float[]){0.0f, 0.1f, -0.1f, 0.0f, 0.1f, -0.1f}); // the camera made them alike
}

static void test_told(void **state)
{
    (void)state;
    struct views v = {.n = 3, .log2t = (float[]){-9.9f, -10.0f, -9.7f}};
    assert_false(response_is_told(&v));
    v.n = 1;
    assert_false(response_is_told(&v));
    v.n_more = 2;
    v.log2t = (float[]){-10.0f, -8.0f, -6.0f};
    assert_true(response_is_told(&v));
    v.drift = (float[]){-2.0f, 0.0f, 2.0f}; // light that was found is no exposure
    assert_false(response_is_told(&v));
}

static void test_without_grey(void **state)
{
    (void)state;
    recover(black_curve, 3, 2.0f, INFINITY);
    recover(white_curve, 3, 2.0f, INFINITY);
    recover(film_curve, 2, 30.0f, INFINITY);
}

static void test_wrong_pairs(void **state)
{
    (void)state;
    struct response_pair pairs[200];
    struct tonemap tone;
    uint32_t seed = 3;
    for (int i = 0; i < 200; i++) {
        float x = -4.0f + 6.0f * (float)i / 199.0f, d = i % 2 ? 2.0f : 3.0f;
        pairs[i] = (struct response_pair){film_curve(x), film_curve(x + d), d, 1.0f};
        if (i % 5 == 0)
            pairs[i].zb = (float)random_bits(&seed) / (float)(1 << 24);
    }
    response_fit(pairs, 200, 1.0f, &tone);
    check_rising(&tone);
    assert_true(curve_error(&tone, film_curve) < 0.3f);
}

static void test_inverse(void **state)
{
    (void)state;
    struct tonemap tone;
    struct response_table table;
    response_fit(NULL, 0, 2.0f, &tone);
    response_tabulate(&tone, &table);
    for (int z = 2; z < 254; z++) {
        float display = (float)z / 255.0f, ln = response_radiance_log(&tone, 2, display, 5.0f);
        float x = ln / 0.69314718f + 5.0f - 2.0f;
        assert_true(fabsf(response_display(&tone, 2, x) - display) < 1e-3f);
        assert_true(fabsf(table.x[2][z] - x) < 1e-3f);
        assert_true(table.weight[2][z] >= 0.0f && table.weight[2][z] <= 1.0f);
    }
    assert_true(table.weight[0][0] == 0.0f && table.weight[0][255] == 0.0f &&
                table.weight[0][128] > 0.8f);
}

/* Black is at most as bright as display value 8, saturated at least as bright as 247. */
static void test_bounds(void **state)
{
    (void)state;
    struct tonemap tone;
    struct response_table t;
    float range[2];
    response_fit(NULL, 0, 0, &tone);
    response_tabulate(&tone, &t);
    response_bounds(&t, 1, t.x[1][100], t.weight[1][100], range);
    assert_true(range[0] == t.x[1][100] && range[1] == t.x[1][100]);
    response_bounds(&t, 1, t.x[1][0], t.weight[1][0], range);
    assert_true(range[0] == -INFINITY && range[1] == t.x[1][8]);
    response_bounds(&t, 1, t.x[1][255], t.weight[1][255], range);
    assert_true(range[0] == t.x[1][247] && range[1] == INFINITY);
}

static void test_srgb(void **state)
{
    (void)state;
    struct tonemap tone;
    double most = 0;
    response_srgb(3.0f, &tone);
    assert_true(tone.mid_log2t == 3.0f);
    const double middle = pow((0.5 + 0.055) / 1.055, 2.4);
    for (double v = 1e-5; v < 1.0; v *= 1.003) {
        const double z = v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
        for (int c = 0; c < 3; c++) {
            const double got = (double)response_display(&tone, c, (float)log2(v / middle));
            most = fmax(most, fabs(got - z));
            if (z < 0.04) // shadows
                assert_true(fabs(got - z) < 0.01 * z);
        }
    }
    assert_true(most < 0.002);
    assert_true(response_display(&tone, 1, (float)log2(4 / middle)) > 0.999f);
}

static void test_refusals(void **state)
{
    (void)state;
    struct world w;
    struct tonemap tone;
    make_world(&w, film_curve, 2, 2.0f);
    w.log2t[3] = NAN;
    assert_int_equal(response_run(&w.run, &w.v, &tone), ERR_ARG);
    w.log2t[3] = 0.0f;
    w.v.n = 0;
    assert_int_equal(response_run(&w.run, &w.v, &tone), ERR_ARG);
    w.v.n = VIEWS;
    struct arena small;
    assert_int_equal(arena_init(&small, "small", 1000), OK);
    w.run.tmp = &small;
    assert_int_equal(response_run(&w.run, &w.v, &tone), ERR_NOMEM);
    arena_free(&small);
    free_world(&w);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_known_curves), cmocka_unit_test(test_brackets),
        cmocka_unit_test(test_spread),       cmocka_unit_test(test_single_exposure_is_near_srgb),
        cmocka_unit_test(test_without_grey), cmocka_unit_test(test_wrong_pairs),
        cmocka_unit_test(test_inverse),      cmocka_unit_test(test_srgb),
        cmocka_unit_test(test_other_places), cmocka_unit_test(test_told),
        cmocka_unit_test(test_bounds),       cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
