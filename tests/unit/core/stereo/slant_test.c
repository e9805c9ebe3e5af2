/* Planes through pixels: a slope is found from a staircase, other views' depths decide between
 * repeats, and what shows nothing stays. */
#include "core/stereo/slant.h"

#include "tests/unit/expect.h"

#include <math.h>
#include <string.h>

enum { W = 64, H = 48, PIXELS = W * H };

static const float STEP = 0.01f;            // of inverse depth
static const float SHIFT = 100;             // px in the neighbour per unit of inverse depth
static const float U = 0.003f, V = -0.002f; // slope of the wall, per px

struct pair {
    float own[2 * PIXELS], other[2 * PIXELS], contrast[PIXELS];
    float rho[PIXELS], true_rho[PIXELS], near_rho[PIXELS], near_sure[PIXELS];
};

static float pattern(float u, float v)
{
    return sinf(0.9f * u + 0.4f * v) + sinf(0.23f * u - 0.7f * v) + sinf(1.3f * v + 0.11f * u);
}

/* A wall through inverse depth `mid` at the first pixel, and what a camera to the right sees. */
static void make_wall(struct pair *p, float (*light)(float u, float v), float mid, float u, float v)
{
    for (int i = 0; i < PIXELS; i++) {
        const float x = (float)(i % W), y = (float)(i / W);
        const float seen = (x + SHIFT * (mid + v * y)) / (1 - SHIFT * u); // what falls on x there
        p->true_rho[i] = mid + u * x + v * y;
        p->near_rho[i] = mid + u * seen + v * y;
        p->near_sure[i] = 1;
        p->own[2 * i] = light(x, y);
        p->other[2 * i] = light(seen, y);
        p->own[2 * i + 1] = p->other[2 * i + 1] = 1;
    }
}

static void refine(struct pair *p)
{
    static float slope[2 * PIXELS], cost[PIXELS];
    const struct match_light own = {W, H, p->own}, other = {W, H, p->other};
    struct slant s = {.own = &own,
                      .n_near = 1,
                      .near = {{&other,
                                p->near_rho,
                                p->near_sure,
                                {1, 0, 0, -(double)SHIFT, 0, 1, 0, 0, 0, 0, 1, 0}}},
                      .contrast = p->contrast,
                      .step = STEP,
                      .slope = slope,
                      .cost = cost};
    for (int i = 0; i < PIXELS; i++)
        p->contrast[i] = match_contrast(&own, i % W, i / W);
    slant_refine(&s, p->rho);
    for (int i = 0; i < PIXELS; i++) {
        assert_true(isfinite(p->rho[i]) && p->rho[i] >= 0);
        assert_true(cost[i] >= 0 && cost[i] <= 1.1f);
    }
}

/* Root mean square of the error in steps, from column `first` on, away from the borders. */
static float error(const struct pair *p, int first)
{
    double sum = 0;
    int n = 0;
    for (int i = 0; i < PIXELS; i++) {
        const int x = i % W, y = i / W;
        if (x < first || x >= W - 4 || y < 4 || y >= H - 4)
            continue;
        const double d = (double)((p->rho[i] - p->true_rho[i]) / STEP);
        sum += d * d;
        n++;
    }
    return (float)sqrt(sum / n);
}

static void a_staircase_becomes_a_slope(void **state)
{
    (void)state;
    static struct pair p;
    make_wall(&p, pattern, 0.12f, U, V);
    for (int i = 0; i < PIXELS; i++)
        p.rho[i] = STEP * roundf(p.true_rho[i] / STEP);
    const float before = error(&p, 34);
    refine(&p);
    assert_true(before > 0.25f && before < 0.35f);
    assert_true(error(&p, 34) < 0.3f * before);
}

static float stripes(float u, float v)
{
    (void)v;
    return sinf(6.2831853f / 12 * u);
}

/* The right part is one stripe off. */
static void put_repeat(struct pair *p)
{
    make_wall(p, stripes, 0.2f, 0, 0);
    for (int i = 0; i < PIXELS; i++)
        p->rho[i] = p->true_rho[i] + (i % W > 40 ? 12 / SHIFT : 0);
}

static void depths_of_others_decide_between_repeats(void **state)
{
    (void)state;
    static struct pair p;
    put_repeat(&p);
    refine(&p);
    assert_true(error(&p, 44) < 0.5f);
    put_repeat(&p);
    memset(p.near_sure, 0, sizeof p.near_sure);
    refine(&p);
    assert_true(error(&p, 44) > 6);
}

static float plain(float u, float v)
{
    (void)u;
    (void)v;
    return 0.25f;
}

/* Without texture, or where nothing is reliable or in the neighbour's picture. */
static void what_shows_nothing_stays(void **state)
{
    (void)state;
    static struct pair p;
    for (int kind = 0; kind < 3; kind++) {
        make_wall(&p, kind == 0 ? plain : pattern, kind == 2 ? 9 : 0.12f, 0, 0);
        memset(p.near_sure, 0, sizeof p.near_sure);
        for (int i = 0; i < PIXELS; i++) {
            p.rho[i] = p.true_rho[i] + STEP * (float)(i % 5);
            if (kind == 1)
                p.own[2 * i + 1] = p.other[2 * i + 1] = 0;
        }
        float first[PIXELS];
        memcpy(first, p.rho, sizeof first);
        refine(&p);
        for (int i = 0; i < PIXELS; i++)
            if (kind == 2 || i % W >= 30) // others may fall outside the neighbour
                assert_float_equal(p.rho[i], first[i], 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_staircase_becomes_a_slope),
        cmocka_unit_test(depths_of_others_decide_between_repeats),
        cmocka_unit_test(what_shows_nothing_stays),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
