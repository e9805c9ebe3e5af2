/* Stereo for the training: a small world is described in finite numbers of the right shape, wrong
 * requests are refused. What the numbers are is fill_test's. */
#include "sim/train/sample.h"
#include "sim/train/stereo.h"

#include "core/stereo/fill.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { VIEWS = 3, SIZE = 32, PX = SIZE * SIZE, GUARD = 7 };

static float radiance[VIEWS * 3 * PX], depth[VIEWS * PX], cams[VIEWS * STEREO_CAMERA];
static float input[VIEWS * PX * FILL_INPUT + GUARD], guess[VIEWS * PX + GUARD];
static const float log2t[VIEWS] = {-1, 0, 1};
static uint8_t px[VIEWS * PX * 3];

static const struct stereo_request usual = {.n = VIEWS,
                                            .w = SIZE,
                                            .h = SIZE,
                                            .px = px,
                                            .log2t = log2t,
                                            .cams = cams,
                                            .input = input,
                                            .guess = guess};

static int photograph(void **state)
{
    const struct sample_request q = {.scene = {.seed = 5,
                                               .kind = WORLD_ROOM,
                                               .n_views = VIEWS,
                                               .size = SIZE,
                                               .spread = 0.3f,
                                               .fov_deg = 60,
                                               .quality = {.samples = 2, .shadow = 1}}};
    double key;
    (void)state;
    int e = sample_photograph(&q, radiance, depth, cams, &key);
    for (int i = 0; i < VIEWS && !e; i++)
        e = sample_develop(&q, key, radiance + 3 * PX * i, 1, &log2t[i], px + 3 * PX * i);
    return e;
}

static void a_world_is_described(void **state)
{
    int usable = 0, right = 0;
    (void)state;
    for (int i = 0; i < GUARD; i++)
        input[VIEWS * PX * FILL_INPUT + i] = guess[VIEWS * PX + i] = -7;
    assert_int_equal(stereo_run(&usual), OK);
    for (int i = 0; i < VIEWS * PX; i++) {
        const float *x = input + FILL_INPUT * i;
        for (int k = 0; k < FILL_INPUT; k++)
            assert_true(isfinite(x[k]));
        assert_true(x[FILL_USABLE] == 0 || x[FILL_USABLE] == 1);
        assert_true(isfinite(guess[i]) && guess[i] > 0);
        usable += x[FILL_USABLE] == 1;
        right += x[FILL_USABLE] == 1 && fabsf(guess[i] * depth[i] - 1) < 0.1f;
    }
    assert_true(usable > VIEWS * PX / 4 && right > usable / 2);
    for (int i = 0; i < GUARD; i++)
        assert_true(input[VIEWS * PX * FILL_INPUT + i] == -7 && guess[VIEWS * PX + i] == -7);
}

static void assert_refused(const struct stereo_request *q, const char *sentence)
{
    assert_int_equal(stereo_run(q), ERR_ARG);
    assert_string_equal(sample_error(), sentence);
}

static void wrong_requests_are_refused(void **state)
{
    struct stereo_request q = usual;
    (void)state;
    q.n = 1;
    assert_refused(&q, "stereo: 1 photographs, allowed are 2 to 16");
    q.n = STEREO_VIEWS + 1;
    assert_refused(&q, "stereo: 17 photographs, allowed are 2 to 16");
    q = usual;
    q.w = 15;
    assert_refused(&q, "stereo: 15 x 32 px, allowed are 16 to 256");
    q = usual;
    q.h = 257;
    assert_refused(&q, "stereo: 32 x 257 px, allowed are 16 to 256");
    q = usual;
    q.guess = NULL;
    assert_refused(&q, "stereo: px, log2t, cams, input and guess must not be NULL");
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_world_is_described),
                                       cmocka_unit_test(wrong_requests_are_refused)};
    return cmocka_run_group_tests(tests, photograph, NULL);
}
