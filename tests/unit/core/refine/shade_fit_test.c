/* A wall that two physical cameras see from eight places: vignetting, gain and balance are found
 * where there are some, and nothing where there is none. */
#include "core/refine/shade_fit.h"

#include "core/photo/response.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 8, SIZE = 96, MAP = SIZE / 2, PX = SIZE * SIZE, MPX = MAP * MAP };

static struct world {
    struct arena tmp;
    struct run r;
    struct views v;
    struct depthmaps depth;
    struct tonemap tone;
    struct camera cams[VIEWS];
    struct shade shade[VIEWS];
    int camera[VIEWS];
    float log2t[VIEWS], stops[VIEWS], balance[VIEWS][3], z[VIEWS * MPX], conf[VIEWS * MPX];
    uint8_t rgb[3 * VIEWS * PX];
    struct shade_fit_input in;
    struct shade_fit_drift drift;
    bool other[VIEWS];
    struct light_change change;
} w;

static const struct shade_model none,
    real[2] = {{{-0.6, -0.15, 0}, {0.42, 0.3, 0.18}}, {{0, 0, 0}, {-0.42, -0.3, -0.18}}};

static bool lamp; // beside the wall, is on

/* log2 radiance of the wall z = 4 at x, y. */
static float wall(float x, float y, int c)
{
    return (lamp ? log2f(1 + expf(-x * x - y * y)) : 0) + 0.4f * sinf(2 * x + (float)c) +
           0.4f * cosf(2 * y - x) + 0.2f * (float)c - 0.5f;
}

static void photograph(int i, const struct shade_model *m)
{
    const struct camera *c = &w.cams[i];
    for (int k = 0; k < PX; k++) {
        const float u = (float)(k % SIZE) + 0.5f, v = (float)(k / SIZE) + 0.5f;
        const float x = (u - 48) / 90 * 4 - c->t[0], y = (v - 48) / 90 * 4 - c->t[1];
        float stops[3];
        shade_stops(m, shade_r2(&w.shade[i], u / SIZE, v / SIZE), stops);
        for (int n = 0; n < 3; n++)
            w.rgb[3 * (i * PX + k) + n] =
                (uint8_t)(255 *
                              response_display(&w.tone, n, wall(x, y, n) + stops[n] + w.log2t[i]) +
                          0.5f);
    }
}

/* models: of the two cameras, which take turns. */
static void photograph_all(const struct shade_model *models)
{
    for (int i = 0; i < VIEWS; i++)
        photograph(i, &models[w.camera[i]]);
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
                         .cams = w.cams};
    w.depth = (struct depthmaps){VIEWS, 2, squares(VIEWS, MAP), w.z, w.conf, NULL};
    response_srgb(0, &w.tone);
    for (int i = 0; i < VIEWS; i++) {
        struct camera *c = &w.cams[i];
        *c = (struct camera){
            .w = SIZE, .h = SIZE, .fx = 90, .fy = 90, .cx = 48, .cy = 48, .q = {1, 0, 0, 0}};
        c->t[0] = -0.4f * (float)(i % 4);
        c->t[1] = -0.5f * (float)(i / 4);
        w.camera[i] = i % 2;
        w.log2t[i] = 0.5f * (float)(i % 3) - 1;
        shade_map(NULL, 0, 0, c, &w.shade[i]);
    }
    for (int k = 0; k < VIEWS * MPX; k++) {
        w.z[k] = 4;
        w.conf[k] = 1;
    }
    w.in = (struct shade_fit_input){&w.v, &w.depth, &w.tone, true, w.shade, w.camera, 2};
    w.drift.stops = w.stops;
    w.drift.balance = w.balance;
    w.change.other = w.other;
    w.r = (struct run){.tmp = &w.tmp};
    return arena_init(&w.tmp, "tmp", shade_fit_plan(VIEWS)) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&w.tmp);
    return 0;
}

static void assert_near(const struct shade_model *found, const struct shade_model *want)
{
    for (int i = 0; i <= 4; i++) {
        float a[3], b[3];
        shade_stops(found, (float)i / 4, a);
        shade_stops(want, (float)i / 4, b);
        for (int c = 0; c < 3; c++)
            assert_float_equal(a[c], b[c], 0.02);
    }
}

static void what_is_there_is_found(void **state)
{
    (void)state;
    struct shade_fit_camera found[2];
    photograph_all(real);
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_int_equal(arena_mark(&w.tmp), 0);
    for (int k = 0; k < 2; k++) {
        assert_near(&found[k].model, &real[k]);
        assert_true(found[k].kept[SHADE_FIT_GAIN] && found[k].kept[SHADE_FIT_BALANCE]);
        assert_true(found[k].error < 0.7 * found[k].error_before && found[k].held > 100);
    }
    int last = SHADE_FIT_V6; // of the ladder, the one that was tried
    while (last > SHADE_FIT_V2 && !found[0].kept[last])
        last--;
    assert_true(found[0].kept[last] && found[0].without[last] > found[0].error);
    assert_false(found[1].kept[SHADE_FIT_V2]);
    for (int c = 0; c < 3; c++) // the gauge
        assert_float_equal(found[0].model.gain[c] + found[1].model.gain[c], 0, 1e-3);
}

static void what_is_not_there_is_not_found(void **state)
{
    (void)state;
    const struct shade_model plain[2] = {none, none};
    struct shade_fit_camera found[2];
    photograph_all(plain);
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    for (int k = 0; k < 2; k++)
        assert_memory_equal(&found[k].model, &none, sizeof none);
    assert_false(w.drift.kept);
    for (int i = 0; i < VIEWS; i++)
        assert_true(w.stops[i] == 0);
}

/* One camera has no gain beside others, and its radiance is what it shows. */
static void one_camera_has_vignetting_only(void **state)
{
    (void)state;
    const struct shade_model one[2] = {real[0], real[0]};
    struct shade_fit_camera found;
    photograph_all(one);
    memset(w.camera, 0, sizeof w.camera);
    w.in.n_cameras = 1;
    assert_int_equal(shade_fit_run(&w.r, &w.in, &found, &w.drift, &w.change), OK);
    struct shade_model want = real[0];
    memset(want.gain, 0, sizeof want.gain);
    assert_near(&found.model, &want);
    for (int c = 0; c < 3; c++)
        assert_true(found.model.gain[c] == 0);
}

/* Light of each photograph, 0 in the mean and without a trend over the exposures. */
static const float lit[VIEWS] = {0.25f, -0.2f, 0.1f, -0.05f, -0.1f, 0.15f, -0.2f, 0.05f};

static void light_up(float times)
{
    for (int i = 0; i < VIEWS; i++) {
        w.log2t[i] += times * lit[i];
        photograph(i, &none);
        w.log2t[i] -= times * lit[i];
    }
}

/* A white balance of each photograph, with light or without; light alone has none, nor has what
 * cameras differ by. */
static void white_balance_that_changes_is_found(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    w.in.n_cameras = 1;
    for (int light = 0; light < 2; light++) {
        for (int i = 0; i < VIEWS; i++) {
            const double red = (double)lit[i], blue = (double)lit[(i + 3) % VIEWS];
            photograph(i, &(struct shade_model){.gain = {red, light ? 0 : -red - blue, blue}});
        }
        assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
        assert_true(w.drift.kept && w.drift.coloured);
        assert_true(w.drift.error < 0.5 * w.drift.error_grey);
        for (int i = 0; i < VIEWS; i++) {
            const float red = lit[i], blue = lit[(i + 3) % VIEWS];
            const float mean = light ? (red + blue) / 3 : 0;
            assert_float_equal(w.stops[i], mean, 0.02);
            assert_float_equal(w.balance[i][0], red - mean, 0.02);
            assert_float_equal(w.balance[i][2], blue - mean, 0.02);
            assert_float_equal(w.balance[i][0] + w.balance[i][1] + w.balance[i][2], 0, 1e-5);
        }
    }
    for (int cameras = 1; cameras <= 2; cameras++) {
        w.in.n_cameras = cameras;
        if (cameras == 1)
            light_up(1);
        else
            photograph_all(real);
        assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
        assert_true(!w.drift.coloured && w.drift.kept == (cameras == 1));
        assert_true(w.drift.error_grey > 0);
        for (int i = 0; i < VIEWS; i++)
            assert_true(w.balance[i][0] == 0 && w.balance[i][1] == 0 && w.balance[i][2] == 0);
    }
}

static void light_that_changes_is_found(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    for (int times = 1; times <= 8; times += 7) { // up to 2 stops
        light_up((float)times);
        for (int cameras = 0; cameras <= 2; cameras += 2) {
            w.in.n_cameras = cameras;
            assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
            assert_true(w.drift.kept && w.drift.held > 100);
            assert_true(w.drift.error < 0.5 * w.drift.error_before);
            float sum = 0;
            for (int i = 0; i < VIEWS; i++) {
                sum += w.stops[i];
                assert_float_equal(w.stops[i], (float)times * lit[i], 0.02 * times);
            }
            assert_float_equal(sum, 0, 1e-4);
        }
    }
}

/* A trend over the exposures may as well be the curve's, and is taken for light only where that is
 * known. */
static void a_trend_is_light_under_a_known_curve(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    for (int i = 0; i < VIEWS; i++) {
        w.log2t[i] *= 1.3f;
        photograph(i, &none);
        w.log2t[i] /= 1.3f;
    }
    w.in.n_cameras = 0;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_true(w.drift.kept);
    assert_float_equal(w.stops[2] - w.stops[0], 0.3, 0.02);
    w.in.tone_known = false;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    for (int i = 0; i < VIEWS; i++)
        assert_float_equal(w.stops[i], 0, 0.02);
}

/* Nor is another function of the exposure, as image processors make it, under a curve that is not
 * known; light whose means at the exposures differ by chance is. */
static void a_function_of_the_exposure_is_no_light(void **state)
{
    static const float made[3] = {0.4f, -0.8f, 0.4f};
    struct shade_fit_camera found[2];
    (void)state;
    w.in.n_cameras = 0;
    w.in.tone_known = false;
    for (int i = 0; i < VIEWS; i++) {
        w.log2t[i] += made[i % 3];
        photograph(i, &none);
        w.log2t[i] -= made[i % 3];
    }
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_false(w.drift.kept);
    light_up(1);
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_true(w.drift.kept);
    for (int i = 0; i < VIEWS; i++)
        assert_float_equal(w.stops[i], lit[i], 0.06);
}

/* Stops that are in the exposures already are found again, not those that are left. */
static void known_light_is_not_counted_twice(void **state)
{
    struct shade_fit_camera found[2];
    float known[VIEWS];
    (void)state;
    light_up(1);
    for (int i = 0; i < VIEWS; i++)
        w.log2t[i] += known[i] = 0.9f * lit[i];
    w.v.drift = known;
    w.in.n_cameras = 0;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    for (int i = 0; i < VIEWS; i++)
        assert_float_equal(w.stops[i], lit[i], 0.02);
}

/* An exposure that is off by nearly as much as the bound is evened out; one beyond, with another
 * that lets drift be kept, no farther than that. */
static void no_light_is_farther_than_the_bound(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    photograph_all((const struct shade_model[2]){none, none});
    w.in.n_cameras = 0;
    w.log2t[0] -= 3.3f;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_true(w.drift.kept);
    assert_float_equal(w.stops[0], 3.3 * (VIEWS - 1) / VIEWS, 0.05);
    w.log2t[0] -= 3;
    w.log2t[5] += 1;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_true(w.drift.kept);
    assert_float_equal(w.stops[0], SHADE_FIT_DRIFT_MOST, 1e-6);
    assert_float_equal(w.stops[5] - w.stops[4], -1, 0.05);
}

/* Less than 0.03 stops are left alone. */
static void little_is_not_worth_it(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    light_up(0.15f);
    w.in.n_cameras = 0;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_true(!w.drift.kept && w.drift.error < w.drift.error_before && w.stops[0] == 0);
}

/* A lamp is no drift: it is told which photographs it is on in, and nothing is told without it. */
static void a_lamp_that_is_switched_is_told(void **state)
{
    struct shade_fit_camera found[2];
    (void)state;
    light_up(1);
    w.in.n_cameras = 0;
    memset(w.camera, 0, sizeof w.camera);
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_int_equal(w.change.others, 0);
    lamp = true;
    for (int i = 1; i < VIEWS; i += 3) // 1, 4, 7
        photograph(i, &none);
    lamp = false;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_int_equal(w.change.others, 3);
    for (int i = 0; i < VIEWS; i++)
        assert_true(w.other[i] == (i % 3 == 1));
}

static void too_little_says_nothing(void **state)
{
    (void)state;
    atomic_bool cancel = true;
    struct shade_fit_camera found[2];
    memset(w.rgb, 255, sizeof w.rgb); // saturated
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_memory_equal(&found[0].model, &none, sizeof none);
    assert_true(!w.drift.kept && w.drift.held == 0);
    photograph_all(real);
    for (int k = 0; k < VIEWS * MPX; k++) // no depth is sure
        w.conf[k] = 0.5f;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_memory_equal(&found[0].model, &none, sizeof none);
    w.r.cancel = &cancel;
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), ERR_CANCELLED);
    w.r.cancel = NULL;
    w.v.n = w.depth.n = 1; // nothing to compare with
    assert_int_equal(shade_fit_run(&w.r, &w.in, found, &w.drift, &w.change), OK);
    assert_memory_equal(&found[0].model, &none, sizeof none);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(what_is_there_is_found, setup, teardown),
        cmocka_unit_test_setup_teardown(what_is_not_there_is_not_found, setup, teardown),
        cmocka_unit_test_setup_teardown(one_camera_has_vignetting_only, setup, teardown),
        cmocka_unit_test_setup_teardown(white_balance_that_changes_is_found, setup, teardown),
        cmocka_unit_test_setup_teardown(light_that_changes_is_found, setup, teardown),
        cmocka_unit_test_setup_teardown(a_trend_is_light_under_a_known_curve, setup, teardown),
        cmocka_unit_test_setup_teardown(a_function_of_the_exposure_is_no_light, setup, teardown),
        cmocka_unit_test_setup_teardown(known_light_is_not_counted_twice, setup, teardown),
        cmocka_unit_test_setup_teardown(no_light_is_farther_than_the_bound, setup, teardown),
        cmocka_unit_test_setup_teardown(little_is_not_worth_it, setup, teardown),
        cmocka_unit_test_setup_teardown(a_lamp_that_is_switched_is_told, setup, teardown),
        cmocka_unit_test_setup_teardown(too_little_says_nothing, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
