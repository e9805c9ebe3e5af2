/* A wall that four cameras see in parts, brighter from part to part, so that histograms mislead:
 * with depth the curve is found. And what views know of a point (visibility.h). */
#include "core/refine/response_refit.h"

#include "core/photo/response.h"
#include "core/stereo/visibility.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 4, SIZE = 96, MAP = SIZE / 2, PX = SIZE * SIZE, MPX = MAP * MAP };

static struct world {
    struct arena tmp;
    struct run r;
    struct views v;
    struct depthmaps depth;
    struct camera cams[VIEWS];
    float log2t[VIEWS], z[VIEWS * MPX], conf[VIEWS * MPX];
    uint8_t rgb[3 * VIEWS * PX];
} w;

static float film(float x)
{
    float u = 0.55f * x - 0.02f * x * fabsf(x);
    return 1 / (1 + expf(-u));
}

/* log2 radiance of the wall z = 4 at x, y. */
static float wall(float x, float y, int c)
{
    return 1.2f * x + 1.5f * sinf(2 * x + (float)c) + 1.5f * cosf(2 * y - x) + 0.4f * (float)c - 1;
}

/* Cameras 0.4 apart, 2 stops more from one to the next. */
static void photograph(int i)
{
    struct camera *c = &w.cams[i];
    *c = (struct camera){
        .w = SIZE, .h = SIZE, .fx = 90, .fy = 90, .cx = 48, .cy = 48, .q = {1, 0, 0, 0}};
    c->t[0] = -0.4f * (float)i;
    w.log2t[i] = 2 * (float)i - 5;
    for (int k = 0; k < PX; k++) {
        const float x = ((float)(k % SIZE) + 0.5f - 48) / 90 * 4 - c->t[0];
        const float y = ((float)(k / SIZE) + 0.5f - 48) / 90 * 4;
        for (int n = 0; n < 3; n++)
            w.rgb[3 * (i * PX + k) + n] =
                (uint8_t)(255 * film(wall(x, y, n) + w.log2t[i] - w.v.mid_log2t) + 0.5f);
    }
}

static int setup(void **state)
{
    (void)state;
    memset(&w, 0, sizeof w);
    w.v = (struct views){.n = VIEWS,
                         .size = SIZE,
                         .extent = squares(VIEWS, SIZE),
                         .rgb = w.rgb,
                         .log2t = w.log2t,
                         .mid_log2t = -2,
                         .cams = w.cams};
    w.depth = (struct depthmaps){VIEWS, 2, squares(VIEWS, MAP), w.z, w.conf, NULL};
    for (int i = 0; i < VIEWS; i++)
        photograph(i);
    for (int k = 0; k < VIEWS * MPX; k++) {
        const bool wrong = k % 7 == 0; // pixels that are not sure have any depth
        w.z[k] = wrong ? 1.5f : 4;
        w.conf[k] = wrong ? 0.3f : 1;
    }
    const size_t need = response_refit_plan(VIEWS), other = response_plan(&w.v);
    w.r = (struct run){.tmp = &w.tmp};
    return arena_init(&w.tmp, "tmp", need > other ? need : other) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&w.tmp);
    return 0;
}

/* Root mean square in stops between display 0.04 and 0.96, up to a factor of exposure. */
static double error_of(const struct tonemap *t)
{
    double sum = 0, square = 0;
    int n = 0;
    for (int z = 10; z <= 245; z += 5, n++) {
        const float want = (float)z / 255;
        float lo = -12, hi = 12;
        for (int i = 0; i < 30; i++)
            *(film(0.5f * (lo + hi)) < want ? &lo : &hi) = 0.5f * (lo + hi);
        const double e =
            (double)(response_radiance_log(t, 1, want, -2) / 0.6931472f - 0.5f * (lo + hi));
        sum += e;
        square += e * e;
    }
    return sqrt(square / n - sum / n * sum / n);
}

static void surfaces_tell_the_curve_where_histograms_mislead(void **state)
{
    (void)state;
    struct tonemap t;
    assert_int_equal(response_run(&w.r, &w.v, &t), OK);
    const double before = error_of(&t);
    assert_int_equal(response_refit_run(&w.r, &w.v, &w.depth, &t), OK);
    const double after = error_of(&t);
    print_message("  %.3f stops from histograms, %.3f from surfaces\n", before, after);
    assert_true(before > 0.6 && after < 0.25);
    assert_int_equal(arena_mark(&w.tmp), 0);
}

static void what_says_nothing_changes_nothing(void **state)
{
    (void)state;
    struct tonemap was, t;
    assert_int_equal(response_run(&w.r, &w.v, &was), OK);
    t = was;
    for (int i = 0; i < VIEWS; i++) // one exposure
        w.log2t[i] = -2 + 0.05f * (float)i;
    assert_int_equal(response_refit_run(&w.r, &w.v, &w.depth, &t), OK);
    assert_memory_equal(&t, &was, sizeof t);
    for (int i = 0; i < VIEWS; i++)
        w.log2t[i] = 2 * (float)i;
    for (int k = 0; k < VIEWS * MPX; k++) // no depth is sure
        w.conf[k] = 0.5f;
    assert_int_equal(response_refit_run(&w.r, &w.v, &w.depth, &t), OK);
    assert_memory_equal(&t, &was, sizeof t);
    for (int k = 0; k < VIEWS * MPX; k++)
        w.conf[k] = 1;
    memset(w.rgb, 255, sizeof w.rgb); // all is saturated
    assert_int_equal(response_refit_run(&w.r, &w.v, &w.depth, &t), OK);
    assert_memory_equal(&t, &was, sizeof t);
    memset(w.rgb, 0, sizeof w.rgb);
    assert_int_equal(response_refit_run(&w.r, &w.v, &w.depth, &t), OK);
    assert_memory_equal(&t, &was, sizeof t);
}

static void pairs_have_a_bound_and_stop(void **state)
{
    (void)state;
    static struct camera cams[40];
    static float log2t[40];
    struct tonemap t;
    atomic_bool cancel = true;
    struct depthmaps maps = {40,  2, squares(40, MAP), calloc(40 * MPX, 4), calloc(40 * MPX, 4),
                             NULL};
    struct views v = {.n = 40,
                      .size = SIZE,
                      .extent = squares(40, SIZE),
                      .rgb = calloc(40 * PX, 3),
                      .log2t = log2t};
    assert_non_null(maps.depth && maps.conf && v.rgb ? v.rgb : NULL);
    v.cams = cams;
    for (int i = 0; i < 40; i++) { // all in one place: every pixel is found in every view
        cams[i] = w.cams[0];
        log2t[i] = (float)(i % 5);
    }
    for (int k = 0; k < 40 * MPX; k++) {
        maps.conf[k] = 1;
        maps.depth[k] = 4;
    }
    memset(v.rgb, 100, 3 * 40 * PX);
    arena_free(&w.tmp);
    assert_int_equal(arena_init(&w.tmp, "tmp", response_refit_plan(40)), OK);
    assert_int_equal(response_refit_run(&w.r, &v, &maps, &t), OK);
    for (int k = 0; k < TONE_PARAMS; k++)
        assert_true(isfinite(t.p[k]));
    w.r.cancel = &cancel;
    assert_int_equal(response_refit_run(&w.r, &v, &maps, &t), ERR_CANCELLED);
    free(maps.depth);
    free(maps.conf);
    free(v.rgb);
}

static void views_know_points(void **state)
{
    (void)state;
    struct visibility s;
    struct projected p;
    float point[3];
    assert_int_equal(visibility_layout(&s, w.r.tmp, w.depth.n), OK);
    visibility_set(&s, &w.depth, w.cams);
    visibility_unproject(&s, 0, (const float[3]){50.5f, 20.5f, 4}, point);
    assert_true(visibility_project(&s, 1, point, &p));
    assert_float_equal(p.u, 50.5f - 0.4f * 90 / 4, 1e-4);
    assert_float_equal(p.v, 20.5f, 1e-4);
    assert_float_equal(p.z, 4, 1e-6);
    assert_int_equal(p.at, MPX + 10 * MAP + 20);
    w.conf[p.at] = 0.6f;
    w.z[p.at] = 4.07f;
    assert_true(visibility_on_surface(&s, &p) && !visibility_in_front(&s, &p));
    w.z[p.at] = 4.1f;
    assert_true(!visibility_on_surface(&s, &p) && !visibility_in_front(&s, &p));
    w.z[p.at] = 4.3f;
    assert_true(!visibility_on_surface(&s, &p) && visibility_in_front(&s, &p));
    w.z[p.at] = 3.5f;
    assert_true(!visibility_on_surface(&s, &p) && !visibility_in_front(&s, &p));
    w.conf[p.at] = 0.59f;
    w.z[p.at] = 4;
    assert_true(!visibility_confident(&s, p.at) && !visibility_on_surface(&s, &p));
    w.z[p.at] = 9;
    assert_true(!visibility_in_front(&s, &p));
    assert_false(visibility_project(&s, 1, (const float[3]){0, 0, -4}, &p));       // behind
    assert_false(visibility_project(&s, 1, (const float[3]){9, 0, 4}, &p));        // outside
    assert_false(visibility_project(&s, 1, (const float[3]){NAN, 0, 4}, &p));      // nowhere
    assert_false(visibility_project(&s, 1, (const float[3]){0.4f, 0, NAN}, &p));   // nowhere
    assert_false(visibility_project(&s, 1, (const float[3]){INFINITY, 0, 4}, &p)); // far away
    assert_int_equal(visibility_index(&s, 1, 95.9f, 95.9f), 2 * MPX - 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(surfaces_tell_the_curve_where_histograms_mislead, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(what_says_nothing_changes_nothing, setup, teardown),
        cmocka_unit_test_setup_teardown(pairs_have_a_bound_and_stop, setup, teardown),
        cmocka_unit_test_setup_teardown(views_know_points, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
