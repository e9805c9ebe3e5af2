/* What the completion branch is told about three views before a wall at 4, and its answer. */
#include "core/stereo/fill.h"

#include "core/base/shell.h"
#include "core/stereo/far.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 3, MAP = 24, SIZE = 2 * MAP, PX = SIZE * SIZE, MPX = MAP * MAP };

#define WALL 4.0f
#define STEP 0.25f // between the cameras: 2 px of the map at the wall

static struct place {
    struct arena tmp;
    struct views views;
    struct tonemap tone;
    struct depthmaps maps;
    struct fill f;
    struct camera cams[VIEWS];
    float log2t[VIEWS], depth[VIEWS * MPX], conf[VIEWS * MPX];
    uint8_t far[VIEWS * MPX];
    uint8_t rgb[3 * VIEWS * PX], masked[VIEWS * PX];
    float input[MPX * FILL_INPUT], answer[VIEWS * MPX * FILL_ANSWER];
} w;

static int setup(void **state)
{
    (void)state;
    memset(&w, 0, sizeof w);
    memset(w.rgb, 128, sizeof w.rgb);
    w.maps = (struct depthmaps){VIEWS, 2, squares(VIEWS, MAP), w.depth, w.conf, w.far};
    w.views = (struct views){.n = VIEWS,
                             .size = SIZE,
                             .extent = squares(VIEWS, SIZE),
                             .rgb = w.rgb,
                             .log2t = w.log2t,
                             .cams = w.cams};
    response_srgb(0, &w.tone);
    for (int i = 0; i < VIEWS; i++) {
        w.cams[i] = (struct camera){.w = SIZE,
                                    .h = SIZE,
                                    .fx = 64,
                                    .fy = 64,
                                    .cx = SIZE / 2,
                                    .cy = SIZE / 2,
                                    .q = {1, 0, 0, 0}};
        w.cams[i].t[0] = -STEP * (float)i;
    }
    for (int k = 0; k < VIEWS * MPX; k++) {
        w.depth[k] = WALL;
        w.conf[k] = 0.7f;
    }
    struct arena need = arena_counter();
    if (fill_layout(&w.f, &need, w.maps.extent, VIEWS) || arena_init(&w.tmp, "tmp", need.peak) ||
        fill_layout(&w.f, &w.tmp, w.maps.extent, VIEWS))
        return -1;
    fill_set(&w.f, &w.views, &w.tone, &w.maps);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&w.tmp);
    return 0;
}

static const float *known(int x, int y)
{
    return w.input + (y * MAP + x) * FILL_INPUT;
}

static void paint(int view, int x, int y, uint8_t value)
{
    for (int k = 0; k < 4; k++) {
        const int at = (2 * y + k / 2) * SIZE + 2 * x + k % 2;
        memset(w.rgb + 3 * (view * PX + at), value, 3);
    }
}

static void light_is_in_stops_over_the_median_of_the_view(void **state)
{
    (void)state;
    paint(1, 5, 6, 188); // sRGB: 2.3 times as bright as 128
    paint(1, 7, 6, 0);
    w.log2t[1] = 3; // changes nothing
    fill_input(&w.f, 1, w.input);
    for (int c = 0; c < 3; c++) {
        assert_true(fabsf(known(1, 1)[c]) < 1e-6f);
        assert_true(fabsf(3 * known(5, 6)[c] - log2f(0.5029f / 0.2159f)) < 0.02f);
        assert_true(known(7, 6)[c] >= -2 && known(7, 6)[c] < -1);
    }
    const float weight = known(1, 1)[FILL_WEIGHT];
    w.views.masked = w.masked;
    memset(w.masked + PX + SIZE, 1, SIZE / 2); // half of the left half of the first row of the map
    fill_input(&w.f, 1, w.input);
    assert_true(fabsf(known(0, 0)[FILL_WEIGHT] - weight / 2) < 1e-6f &&
                known(MAP - 1, 0)[FILL_WEIGHT] == weight);
    assert_true(known(1, 1)[FILL_WEIGHT] > 0.9f && known(7, 6)[FILL_WEIGHT] < 0.01f);
}

static void depth_is_in_stops_over_the_median_of_what_is_usable(void **state)
{
    (void)state;
    w.depth[3 * MAP + 2] = WALL / 4;
    w.depth[3 * MAP + 9] = WALL * 2;
    w.conf[3 * MAP + 9] = 0.1f;
    w.depth[3 * MAP + 15] = 1e5f;
    w.far[3 * MAP + 15] = true;
    w.conf[3 * MAP + 15] = FAR_CONF;
    fill_input(&w.f, 0, w.input);
    assert_true(known(4, 4)[FILL_STEREO] == 0 && known(4, 4)[FILL_GUESS] == 0);
    assert_true(known(4, 4)[FILL_USABLE] == 1 && known(4, 4)[FILL_CONF] == 0.7f);
    assert_true(known(2, 3)[FILL_STEREO] == 1); // half of two stops
    assert_true(known(9, 3)[FILL_STEREO] == -0.5f && known(9, 3)[FILL_USABLE] == 0);
    assert_true(known(9, 3)[FILL_GUESS] > -0.25f); // mostly its surroundings
    assert_true(known(15, 3)[FILL_FAR] == 1 && known(15, 3)[FILL_USABLE] == 0);
    assert_true(known(15, 3)[FILL_STEREO] == -3 && fabsf(known(15, 3)[FILL_GUESS]) < 0.1f);
    assert_true(known(4, 4)[FILL_FAR] == 0);
    assert_true(fabsf(known(0, 5)[FILL_RAY] - (1 - 24) / 64.0f) < 1e-6f);
    assert_true(fabsf(known(0, 5)[FILL_RAY + 1] - (11 - 24) / 64.0f) < 1e-6f);
}

/* Camera 2 stands 4 px of the map to the right of camera 0: the left of 0 is not in its picture,
 * and half as much not in that of 1. */
static void what_others_have_measured_is_told(void **state)
{
    (void)state;
    fill_input(&w.f, 0, w.input);
    assert_true(known(0, 8)[FILL_SEEN] == 0.25f && known(12, 8)[FILL_SEEN] == 0.5f);
    assert_true(known(0, 8)[FILL_OTHERS] == 0 && known(0, 8)[FILL_NEAREST] == 0);
    assert_true(known(12, 8)[FILL_OTHERS] == 0.5f);
    assert_true(fabsf(known(12, 8)[FILL_NEAREST]) < 1e-6f);
    /* view 1 has two points there that are twice as near; view 2 is not sure of its own */
    for (int k = 0; k < MPX; k++) {
        w.depth[MPX + k] = WALL / 2;
        w.conf[2 * MPX + k] = 0.5f;
    }
    fill_input(&w.f, 0, w.input);
    assert_true(fabsf(known(12, 8)[FILL_NEAREST] - 0.5f) < 1e-6f);
    assert_true(known(12, 8)[FILL_OTHERS] == 0.25f);
    for (int k = 0; k < MPX; k++)
        w.conf[2 * MPX + k] = 0.6f;
    fill_input(&w.f, 0, w.input);
    assert_true(fabsf(known(12, 8)[FILL_NEAREST] - 0.5f) < 1e-6f);
    assert_true(fabsf(known(12, 8)[FILL_FARTHEST]) < 1e-6f);
    assert_true(known(12, 8)[FILL_OTHERS] == 0.5f);
}

static void what_is_far_does_not_count_in_the_median(void **state)
{
    (void)state;
    for (int k = 0; k < 3 * MPX / 4; k++) {
        w.depth[k] = 1e5f;
        w.far[k] = true;
        w.conf[k] = FAR_CONF;
    }
    fill_input(&w.f, 0, w.input);
    assert_true(known(3, MAP - 1)[FILL_STEREO] == 0);
}

static void nothing_usable_is_told_in_numbers(void **state)
{
    (void)state;
    memset(w.rgb, 0, sizeof w.rgb);
    memset(w.conf, 0, sizeof w.conf);
    fill_input(&w.f, 0, w.input);
    for (int k = 0; k < MPX * FILL_INPUT; k++)
        assert_true(fabsf(w.input[k]) <= 3);
    assert_true(fabsf(known(7, 7)[FILL_GUESS]) < 1e-6f && fabsf(known(7, 7)[FILL_STEREO]) < 1e-6f);
}

static void answer(int at, float residual, float spread, float far)
{
    w.answer[at * FILL_ANSWER + FILL_RESIDUAL] = residual;
    w.answer[at * FILL_ANSWER + FILL_SPREAD] = spread;
    w.answer[at * FILL_ANSWER + FILL_IS_FAR] = far;
}

static void what_stereo_is_sure_of_stays_unless_it_is_doubted(void **state)
{
    (void)state;
    for (int k = 0; k < MPX; k++)
        answer(k, k % 2 ? 0.09f : 0.29f, k % 2 ? -9 : -2.3f, -9); // below 0.1; below 3 b
    w.conf[5] = 0.3f;
    w.depth[7] = 1e5f;
    w.far[7] = true;
    w.conf[7] = FAR_CONF;
    answer(7, 1, -9, 0); // not sure that it is near
    const struct place before = w;
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_memory_equal(w.depth, before.depth, sizeof w.depth);
    assert_memory_equal(w.conf, before.conf, sizeof w.conf);
    assert_memory_equal(w.far, before.far, sizeof w.far);
    answer(9, 0.11f, -4, -9);
    answer(10, 0.5f, -1.9f, -9);
    assert_int_equal(fill_take(&w.f, 0, w.answer, &w.maps), 2);
    assert_true(fabsf(w.depth[9] - WALL * exp2f(-0.11f)) < 1e-3f);
    assert_true(w.conf[9] < SWEEP_CONF_USABLE); // others have measured the wall there
    assert_true(fabsf(w.depth[10] - WALL * exp2f(-0.5f)) < 1e-3f);
    assert_true(w.conf[10] < SWEEP_CONF_USABLE);
}

static void other_depth_is_taken_and_is_usable_where_the_branch_is_sure(void **state)
{
    (void)state;
    for (int k = 0; k < MPX; k++)
        answer(k, 0, -6, -9);
    answer(90, 1, -6, -9);
    answer(3, -0.5f, 0, -9);
    w.conf[MPX + 3] = w.conf[MPX + 90] = 0; // their surroundings say 4
    (void)fill_take(&w.f, 1, w.answer, &w.maps);
    assert_true(fabsf(w.depth[MPX + 90] - WALL / 2) < 1e-3f);
    assert_true(w.conf[MPX + 90] >= SWEEP_CONF_USABLE && w.conf[MPX + 90] < SWEEP_CONF_CONFIRMED);
    assert_true(fabsf(w.depth[MPX + 3] - WALL * sqrtf(2)) < 1e-3f);
    assert_true(w.conf[MPX + 3] < SWEEP_CONF_USABLE);
    assert_true(w.depth[MPX + 91] == WALL && w.depth[90] == WALL);
}

/* A tenth of the depth is about there. */
static void what_another_view_has_measured_is_its_own_to_show(void **state)
{
    (void)state;
    for (int k = 0; k < MPX; k++)
        answer(k, 0, -6, -9);
    answer(90, 0.13f, -6, -9);
    answer(91, 0.17f, -6, -9);
    for (int k = 90; k < 93; k++)
        w.conf[MPX + k] = 0;
    (void)fill_take(&w.f, 1, w.answer, &w.maps);
    assert_true(w.conf[MPX + 90] < SWEEP_CONF_USABLE && w.conf[MPX + 92] < SWEEP_CONF_USABLE);
    assert_true(w.conf[MPX + 91] == SWEEP_CONF_USABLE);
    for (int i = 0; i < VIEWS; i++) // nobody has
        for (int k = 0; k < MPX; k++)
            w.conf[i * MPX + k] = 0.5f;
    for (int k = 90; k < 93; k++)
        w.conf[MPX + k] = 0;
    (void)fill_take(&w.f, 1, w.answer, &w.maps);
    for (int k = 90; k < 93; k++)
        assert_true(w.conf[MPX + k] == SWEEP_CONF_USABLE);
}

static void sky_goes_to_the_shell_and_what_is_none_comes_back(void **state)
{
    (void)state;
    const struct shell shell = shell_of(w.cams, VIEWS);
    for (int k = 0; k < MPX; k++)
        answer(k, 0, 0, -9);
    answer(40, 0, 0, 9);
    w.conf[40] = 0.1f;
    w.far[50] = FAR_SKY;
    w.depth[50] = 1e5f;
    w.conf[50] = FAR_CONF;
    w.f.sky = true;
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    const float z = shell_depth(&shell, w.cams, 2 * (40 % MAP + 0.5f), 2 * (float)(40 / MAP) + 1);
    assert_true(w.far[40] && w.conf[40] == FAR_CONF && fabsf(w.depth[40] / z - 1) < 1e-6f);
    assert_true(!w.far[50] && fabsf(w.depth[50] - WALL) < 1e-3f);
    w.far[60] = FAR_BLACK; // of which the branch knows nothing
    w.depth[60] = 1e5f;
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_true(w.far[60] == FAR_BLACK && w.depth[60] == 1e5f);
    /* cameras in one place: nothing can be far */
    w.maps.far = NULL;
    w.depth[40] = WALL;
    w.conf[40] = 0.1f;
    fill_look_for_sky(&w.f, w.answer);
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_true(fabsf(w.depth[40] - WALL) < 1e-3f);
}

/* A hundredth of all pixels is sky. */
static void a_lamp_is_not_sky(void **state)
{
    (void)state;
    for (int k = 0; k < VIEWS * MPX; k++)
        answer(k, 0, 0, k < VIEWS * MPX / 100 ? 9 : -9);
    w.conf[1] = 0;
    fill_look_for_sky(&w.f, w.answer);
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_true(!w.far[1] && fabsf(w.depth[1] - WALL) < 1e-3f);
    answer(VIEWS * MPX - 1, 0, 0, 9);
    w.far[2] = FAR_SKY; // which the branch takes back whether or not there is sky
    w.far[3] = FAR_SKY;
    answer(2, 0, 0, -9);
    fill_look_for_sky(&w.f, w.answer);
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_true(!w.far[1] && !w.far[2] && w.far[3] == FAR_SKY);
    answer(2, 0, 0, 9);
    fill_look_for_sky(&w.f, w.answer);
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    assert_true(w.far[1] == FAR_SKY);
    w.maps.far = NULL;
    fill_look_for_sky(&w.f, w.answer);
    assert_false(w.f.sky);
}

static void an_answer_beyond_reason_is_limited(void **state)
{
    (void)state;
    memset(w.conf, 0, sizeof w.conf);
    for (int k = 0; k < MPX; k++)
        answer(k, k % 2 ? 1e9f : -1e9f, 0, -9);
    (void)fill_take(&w.f, 0, w.answer, &w.maps);
    const struct shell shell = shell_of(w.cams, VIEWS); // nearer than 64 walls
    for (int k = 0; k < MPX; k++) {
        const float u = 2 * (float)(k % MAP) + 1, v = 2 * (float)(k / MAP) + 1;
        const float most = SHELL_INSIDE * shell_depth(&shell, w.cams, u, v);
        assert_true(!w.far[k] && fabsf(w.depth[k] / (k % 2 ? WALL / 64 : most) - 1) < 1e-5f);
    }
}

int main(void)
{
#define TEST(name) cmocka_unit_test_setup_teardown(name, setup, teardown)
    const struct CMUnitTest tests[] = {
        TEST(light_is_in_stops_over_the_median_of_the_view),
        TEST(depth_is_in_stops_over_the_median_of_what_is_usable),
        TEST(what_others_have_measured_is_told),
        TEST(what_is_far_does_not_count_in_the_median),
        TEST(nothing_usable_is_told_in_numbers),
        TEST(what_stereo_is_sure_of_stays_unless_it_is_doubted),
        TEST(other_depth_is_taken_and_is_usable_where_the_branch_is_sure),
        TEST(what_another_view_has_measured_is_its_own_to_show),
        TEST(sky_goes_to_the_shell_and_what_is_none_comes_back),
        TEST(a_lamp_is_not_sky),
        TEST(an_answer_beyond_reason_is_limited),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
