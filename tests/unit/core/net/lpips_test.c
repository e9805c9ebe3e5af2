/* LPIPS with hashed weights against PyTorch's numbers (tests/peers/lpips.py numbers), for both
 * networks, one band and several; the same bytes for any number of threads; memory as planned. */
#include "core/net/lpips.h"

#include "core/base/cpu.h"
#include "core/base/pool.h"
#include "core/kernels/kernels.h"

#include "tests/unit/small_model.h"
#include "tests/unit/some_of.h"

#include <limits.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

enum { PX_MAX = 16 * 2081, SIDE_OF_BANDS = 2081 };

static const struct {
    enum lpips_net net;
    int w, h;
    double as_it_is, centred;
} known[] = {
    {LPIPS_VGG16, 16, 16, 0.0776045177, 0.3076971448},
    {LPIPS_VGG16, 53, 38, 0.0877185281, 0.3610558827},
    {LPIPS_VGG16, 16, SIDE_OF_BANDS, 0.0895110799, 0.3632096017},
    {LPIPS_ALEXNET, 31, 31, 0.1004931562, 0.3539899193},
    {LPIPS_ALEXNET, 90, 61, 0.1028030466, 0.3881566882},
};

enum { N_KNOWN = sizeof known / sizeof known[0] };

static struct small_model model;
static struct lpips net;
static float px[2][3 * PX_MAX];
static unsigned hidden; // instruction sets

static void open_net(enum lpips_net which)
{
    const struct net_dims d = {.lpips = which};
    if (model.model.dims.lpips == which)
        return;
    small_model_free(&model);
    small_model_init(&model, &d, PRECISION_F32);
    assert_int_equal(lpips_bind(&model.model, &net), OK);
}

static void draw_pictures(int w, int h)
{
    float *a = px[0], *b = px[1];
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < h; y++)
            for (int x = 0; x < w; x++) {
                *a = (float)((7 * x + 13 * y + 29 * c + 5 * (x * y % 17)) % 64) / 64;
                *b = (float)((5 * x + 11 * y + 31 * c + 7 * (x * y % 13)) % 64) / 64;
                *b = (*a++ + *b) / 2;
                b++;
            }
}

static double measure(int w, int h, int threads, const float *a, const float *b)
{
    static struct kernels kernels;
    struct plan plan = plan_begin(threads);
    struct arena tmp;
    struct run r = {.k = &kernels, .tmp = &tmp};
    double out = NAN;
    kernels_init(&kernels, cpu_detect() & ~hidden);
    lpips_plan(&plan, &net, w, h);
    assert_int_equal(plan.tmp.used, 0);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(pool_open(&r.pool, threads), OK);
    const struct image images[2] = {{w, h, 3, (float *)(uintptr_t)a},
                                    {w, h, 3, (float *)(uintptr_t)b}};
    assert_int_equal(lpips_run(&r, &net, &images[0], &images[1], &out), OK);
    assert_int_equal(tmp.used, 0);
    assert_true(tmp.peak <= plan.tmp.peak && tmp.peak > plan.tmp.peak / 2);
    pool_close(r.pool);
    arena_free(&tmp);
    return out;
}

static void as_pytorch_has_it(void **state)
{
    (void)state;
    for (int i = 0; i < N_KNOWN; i += some_of(3)) {
        const int w = known[i].w, h = known[i].h;
        open_net(known[i].net);
        draw_pictures(w, h);
        for (int centred = 0; centred < 2; centred++) {
            hidden = i % 3 == 0 ? UINT_MAX : 0; // some in plain C
            const double want = centred ? known[i].centred : known[i].as_it_is;
            net.centred = centred;
            const double got = measure(w, h, 2, px[0], px[1]);
            if (!(fabs(got / want - 1) < 3e-6))
                fail_msg("case %d: %.10f, not %.10f", i, got, want);
        }
    }
    net.centred = false;
    hidden = 0;
}

static void any_number_of_threads(void **state)
{
    (void)state;
    for (int i = 1; i < N_KNOWN; i += 3) {
        const int w = known[i].w, h = known[i].h;
        open_net(known[i].net);
        draw_pictures(w, h);
        const double one = measure(w, h, 1, px[0], px[1]);
        for (int threads = 2; threads < 6; threads += 3)
            assert_true(measure(w, h, threads, px[0], px[1]) == one);
    }
}

static void a_distance(void **state)
{
    (void)state;
    open_net(LPIPS_ALEXNET);
    draw_pictures(40, 33);
    assert_true(measure(40, 33, 2, px[0], px[0]) == 0);
    assert_true(measure(40, 33, 2, px[0], px[1]) == measure(40, 33, 2, px[1], px[0]));
}

static void what_cannot_be_compared(void **state)
{
    static const int least[] = {[LPIPS_VGG16] = 16, [LPIPS_ALEXNET] = 31};
    struct image a = {40, 40, 3, px[0]}, b = {40, 41, 3, px[1]};
    struct run r = {.tmp = &(struct arena){0}};
    double out;
    (void)state;
    for (int n = LPIPS_VGG16; n <= LPIPS_ALEXNET; n++) {
        open_net((enum lpips_net)n);
        assert_int_equal(lpips_check(&net, least[n], least[n]), OK);
        assert_int_equal(lpips_check(&net, least[n] - 1, 100), ERR_ARG);
        assert_int_equal(lpips_check(&net, 100, least[n] - 1), ERR_ARG);
    }
    assert_non_null(strstr(err_text(), "LPIPS of alexnet needs pictures of at least 31 px, these "
                                       "have 100 x 30"));
    assert_int_equal(lpips_run(&r, &net, &a, &b, &out), ERR_ARG);
    b = (struct image){40, 40, 1, px[1]};
    assert_int_equal(lpips_run(&r, &net, &a, &b, &out), ERR_ARG);
    model.model.dims.lpips = LPIPS_NONE;
    assert_int_equal(lpips_bind(&model.model, &net), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "not of LPIPS"));
    small_model_free(&model);
    open_net(LPIPS_ALEXNET);
    float *linear = (float *)(uintptr_t)net.linear[2], was = linear[7];
    linear[7] = -1e-3f;
    assert_int_equal(lpips_bind(&model.model, &net), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "lin2.model.1.weight: element 7 is -0.001"));
    linear[7] = was;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(as_pytorch_has_it),
        cmocka_unit_test(any_number_of_threads),
        cmocka_unit_test(a_distance),
        cmocka_unit_test(what_cannot_be_compared),
    };
    int failures = cmocka_run_group_tests(tests, NULL, NULL);
    small_model_free(&model);
    return failures;
}
