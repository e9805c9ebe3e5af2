/* A slanted textured wall with a card before it, photographed at three exposures through a gamma
 * curve. */
#include "core/stereo/sweep.h"

#include "core/photo/response.h"
#include "tests/unit/core/base/team_local.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 6, SIZE = 128 };

static const float NEAR_CARD = 0.4f;

struct world {
    struct views v;
    struct camera cams[VIEWS];
    float log2t[VIEWS];
    struct tonemap tone;
    struct pool *pool;
    struct arena keep, tmp;
    struct run run;
};

/* Log2 radiance of a surface point: waves and random cells. */
static float texture(float x, float y, int salt)
{
    float sum = 0.6f * sinf(3.1f * x + 1.7f * y) + 0.8f * sinf(0.9f * y - 0.5f * x);
    for (int level = 0; level < 3; level++) {
        float cell = 0.35f / (float)(1 << level);
        uint32_t h = (uint32_t)(int)floorf(x / cell) * 73856093u ^
                     (uint32_t)(int)floorf(y / cell) * 19349663u ^
                     (uint32_t)(salt + level) * 83492791u;
        h = (h ^ (h >> 13)) * 1274126177u;
        sum += 0.9f * ((float)((h >> 8) & 0xffff) / 65535.0f - 0.5f);
    }
    return sum;
}

static bool near_card; // at a tenth of the wall's distance, at the border of views 1, 2, 4 and 5

/* Depth and log2 radiance along the ray of pixel (u, v). */
static float cast(const struct camera *c, float u, float v, float *light)
{
    const float ray[3] = {(u - c->cx) / c->fx, (v - c->cy) / c->fy, 1.0f};
    const float ox = -c->t[0], oy = -c->t[1], oz = -c->t[2]; // cameras without rotation
    float z = NEAR_CARD - oz;
    if (near_card && fabsf(ox + z * ray[0] + 0.15f) < 0.07f && fabsf(oy + z * ray[1]) < 0.2f) {
        *light = texture(4 * (ox + z * ray[0]), 4 * (oy + z * ray[1]), 9);
        return z;
    }
    z = (3.0f - oz) / ray[2];
    float x = ox + z * ray[0], y = oy + z * ray[1];
    if (fabsf(x) < 0.7f && fabsf(y) < 0.5f) {
        *light = texture(x, y, 5);
        return z;
    }
    z = (5.0f + 0.3f * ox + 0.1f * oy - oz) / (ray[2] - 0.3f * ray[0] - 0.1f * ray[1]);
    *light = texture(ox + z * ray[0], oy + z * ray[1], 0);
    return z;
}

static void paint(struct world *w, int i)
{
    for (int k = 0; k < SIZE * SIZE; k++) {
        float sum = 0.0f;
        for (int j = 0; j < 4; j++) {
            float light;
            (void)cast(&w->cams[i], (float)(k % SIZE) + 0.25f + 0.5f * (float)(j % 2),
                       (float)(k / SIZE) + 0.25f + 0.5f * (float)(j / 2), &light);
            sum += 0.25f * exp2f(light);
        }
        for (int c = 0; c < 3; c++) {
            float lin =
                0.25f * sum * exp2f(w->log2t[i] - w->v.mid_log2t) * (1.0f - 0.2f * (float)c);
            w->v.rgb[((size_t)i * SIZE * SIZE + (size_t)k) * 3 + (size_t)c] =
                (uint8_t)(255.0f * fminf(powf(lin, 1.0f / 2.2f), 1.0f) + 0.5f);
        }
    }
}

static void make_world(struct world *w, int threads)
{
    memset(w, 0, sizeof *w);
    w->v = (struct views){.n = VIEWS,
                          .size = SIZE,
                          .extent = squares(VIEWS, SIZE),
                          .log2t = w->log2t,
                          .cams = w->cams};
    w->v.rgb = malloc((size_t)VIEWS * SIZE * SIZE * 3);
    assert_non_null(w->v.rgb);
    for (int i = 0; i < VIEWS; i++) {
        w->log2t[i] = 2.0f * (float)(i % 3) - 2.0f;
        w->cams[i] = (struct camera){
            .w = SIZE, .h = SIZE, .fx = 120, .fy = 120, .cx = 64, .cy = 64, .q = {1}};
        w->cams[i].t[0] = 0.25f * (float)(i % 3 - 1);
        w->cams[i].t[1] = 0.25f * ((float)(i / 3) - 0.5f);
        w->cams[i].t[2] = 0.05f * (float)(i % 2);
        paint(w, i);
    }
    assert_int_equal(pool_open(&w->pool, threads), OK);
    struct plan plan = plan_begin(threads);
    struct extent maps[VIEWS];
    arena_step(&plan.tmp, response_plan(&w->v));
    (void)sweep_extents(&w->v, maps);
    sweep_plan(&plan, &w->v, maps);
    assert_int_equal(arena_init(&w->tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(arena_init(&w->keep, "keep", plan.keep.peak), OK);
    w->run = (struct run){.keep = &w->keep, .tmp = &w->tmp, .pool = w->pool};
    assert_int_equal(response_run(&w->run, &w->v, &w->tone), OK);
}

static void free_world(struct world *w)
{
    pool_close(w->pool);
    arena_free(&w->keep);
    arena_free(&w->tmp);
    free(w->v.rgb);
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void check_finite(const struct depthmaps *d)
{
    for (int k = 0; k < (int)extent_total(d->extent, d->n); k++) {
        assert_true(isfinite(d->depth[k]) && d->depth[k] > 0.0f);
        assert_true(d->conf[k] >= 0.0f && d->conf[k] <= 1.0f);
    }
}

static float mean_conf(const struct depthmaps *d)
{
    double sum = 0.0;
    for (int k = 0; k < (int)extent_total(d->extent, d->n); k++)
        sum += (double)d->conf[k];
    return (float)(sum / (double)extent_total(d->extent, d->n));
}

static void test_depth(void **state)
{
    (void)state;
    static float error[VIEWS * SIZE * SIZE];
    struct world w;
    struct depthmaps d;
    int n = 0, sure = 0, wrong = 0;
    make_world(&w, 1);
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    assert_int_equal(d.extent[0].w * d.scale, SIZE);
    assert_int_equal(w.tmp.used, 0);
    check_finite(&d);
    for (int k = 0; k < VIEWS * SIZE * SIZE; k++) {
        float light, z = cast(&w.cams[k / (SIZE * SIZE)], (float)(k % SIZE) + 0.5f,
                              (float)(k / SIZE % SIZE) + 0.5f, &light);
        error[n] = fabsf(d.depth[k] - z) / z;
        if (d.conf[k] > 0.5f) {
            sure++;
            wrong += error[n] > 0.05f;
        }
        n++;
    }
    qsort(error, (size_t)n, sizeof *error, by_value);
    if (error[n / 2] > 0.01f || sure < n / 2 || wrong > sure / 30)
        fail_msg("median error %g, 90 %% %g, sure %d of %d, wrong among them %d",
                 (double)error[n / 2], (double)error[n * 9 / 10], sure, n, wrong);
    free_world(&w);
}

/* With two neighbours, planes through the pixels confirm more of the leaning wall: 24,233 of 49,152
 * within 2 %, without them 21,291. */
static void test_few_views_confirm_a_slope(void **state)
{
    (void)state;
    struct world w;
    struct depthmaps d;
    int good = 0, sure = 0;
    make_world(&w, 2);
    w.v.n = 3;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    check_finite(&d);
    for (int k = 0; k < 3 * SIZE * SIZE; k++) {
        float light, z = cast(&w.cams[k / (SIZE * SIZE)], (float)(k % SIZE) + 0.5f,
                              (float)(k / SIZE % SIZE) + 0.5f, &light);
        if (d.conf[k] <= SWEEP_CONF_CONFIRMED)
            continue;
        sure++;
        good += fabsf(d.depth[k] - z) < 0.02f * z;
    }
    if (good < 23000 || good < sure * 3 / 4)
        fail_msg("%d confirmed, %d within 2 %%", sure, good);
    free_world(&w);
}

/* With 3 views each map is made finer as well. */
static void test_same_for_any_number_of_threads(void **state)
{
    (void)state;
    for (int n = 3; n <= VIEWS; n += VIEWS - 3) {
        struct world a, b;
        struct depthmaps da, db;
        make_world(&a, 1);
        make_world(&b, 3);
        a.v.n = b.v.n = n;
        assert_int_equal(sweep_run(&a.run, &a.v, &a.tone, &da), OK);
        assert_int_equal(sweep_run(&b.run, &b.v, &b.tone, &db), OK);
        assert_memory_equal(da.depth, db.depth, (size_t)n * SIZE * SIZE * sizeof(float));
        assert_memory_equal(da.conf, db.conf, (size_t)n * SIZE * SIZE * sizeof(float));
        free_world(&a);
        free_world(&b);
    }
}

/* A rank computes some of the maps, and must end with all of them. */
static err_t compare_on_rank(void *ctx, struct team *t)
{
    const struct depthmaps *whole = ctx;
    struct world w;
    struct depthmaps d;
    const size_t bytes = (size_t)whole->n * SIZE * SIZE * sizeof(float);
    make_world(&w, 1);
    w.v.n = whole->n;
    w.run.team = t;
    err_t e = sweep_run(&w.run, &w.v, &w.tone, &d);
    if (!e &&
        (memcmp(d.depth, whole->depth, bytes) != 0 || memcmp(d.conf, whole->conf, bytes) != 0))
        e = err_fail(ERR_ARG, "rank %d has other maps", team_rank(t));
    free_world(&w);
    return e;
}

static void test_same_for_any_number_of_ranks(void **state)
{
    const int uneven[8] = {8, 1, 8, 8, 2, 8, 8, 8};
    (void)state;
    struct world w;
    struct depthmaps d;
    make_world(&w, 2);
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    for (int size = 2; size <= 8; size += 2) // with 8, some have no view
        if (team_local_run(size, size > 2 ? uneven : NULL, compare_on_rank, &d, NULL))
            fail_msg("%s", err_text());
    arena_reset(&w.keep, 0);
    w.v.n = 3;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    if (team_local_run(2, NULL, compare_on_rank, &d, NULL))
        fail_msg("%s", err_text());
    free_world(&w);
}

/* Runs that find nothing to match must still answer. */
static void expect_guess(struct world *w)
{
    struct depthmaps d;
    assert_int_equal(sweep_run(&w->run, &w->v, &w->tone, &d), OK);
    check_finite(&d);
    assert_true(mean_conf(&d) < 0.05f);
    arena_reset(&w->keep, 0);
}

static void test_nothing_to_match(void **state)
{
    (void)state;
    struct world w;
    make_world(&w, 1);
    w.v.n = 1;
    expect_guess(&w);
    w.v.n = VIEWS;
    for (int i = 0; i < VIEWS; i++)
        memset(w.cams[i].t, 0, sizeof w.cams[i].t);
    expect_guess(&w);
    w.v.n = 2;
    w.cams[1].t[0] = 1.0f;
    memcpy(w.cams[1].q, (float[4]){0.7071068f, 0.0f, 0.7071068f, 0.0f}, sizeof w.cams[1].q);
    expect_guess(&w);
    memset(w.cams[1].q, 0, sizeof w.cams[1].q);
    w.cams[1].q[0] = 1.0f;
    memset(w.v.rgb, 0, 2 * SIZE * SIZE * 3);
    expect_guess(&w);
    memset(w.v.rgb, 255, 2 * SIZE * SIZE * 3);
    expect_guess(&w);
    free_world(&w);
}

/* Grey walls agree at every depth: that is no knowledge. */
static void test_blank_wall(void **state)
{
    (void)state;
    struct world w;
    make_world(&w, 1);
    for (int i = 0; i < VIEWS; i++)
        w.log2t[i] = w.v.mid_log2t;
    memset(w.v.rgb, 128, (size_t)VIEWS * SIZE * SIZE * 3);
    expect_guess(&w);
    free_world(&w);
}

/* A part of the longest exposure is black, or saturated: what others measure there can not be as
 * dark, but may well be as bright. */
static void test_black_is_not_a_bright_surface(void **state)
{
    (void)state;
    static struct world w;
    for (int value = 0; value <= 255; value += 255) {
        struct depthmaps d;
        float sum = 0;
        int n = 0;
        make_world(&w, 2);
        for (int k = 0; k < SIZE * SIZE; k++)
            if (abs(k % SIZE - 64) < 24 && abs(k / SIZE - 100) < 16)
                memset(w.v.rgb + ((size_t)2 * SIZE * SIZE + (size_t)k) * 3, value, 3);
        assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
        for (int k = 0; k < SIZE * SIZE; k++) {
            if (abs(k % SIZE - 64) >= 16 || abs(k / SIZE - 100) >= 8)
                continue;
            sum += d.conf[d.extent[2].at + (size_t)k];
            n++;
        }
        if (value == 0 ? sum > 0.05f * (float)n : sum < 0.2f * (float)n)
            fail_msg("confidence %g where a view is %d", (double)(sum / (float)n), value);
        free_world(&w);
    }
}

static void test_two_views(void **state)
{
    (void)state;
    struct world w;
    struct depthmaps d;
    make_world(&w, 1);
    w.v.n = 2;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    check_finite(&d);
    assert_true(mean_conf(&d) > 0.25f);
    free_world(&w);
}

/* Far apart, what one neighbour alone sees is matched with it. */
static void test_seen_by_one_neighbour(void **state)
{
    (void)state;
    static const float place[4] = {0.0f, 2.6f, -2.6f, -2.9f};
    struct world w;
    struct depthmaps d;
    int n = 0, good = 0;
    make_world(&w, 1);
    w.v.n = 4;
    for (int i = 0; i < 4; i++) {
        w.cams[i].t[0] = place[i];
        w.cams[i].t[1] = w.cams[i].t[2] = 0.0f;
        paint(&w, i);
    }
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    for (int k = 0; k < SIZE * SIZE; k++) {
        float light,
            z = cast(&w.cams[0], (float)(k % SIZE) + 0.5f, (float)(k / SIZE) + 0.5f, &light);
        if (k % SIZE >= SIZE / 4)
            continue;
        good += fabsf(d.depth[k] - z) < 0.02f * z;
        n++;
    }
    if (good < n * 6 / 10)
        fail_msg("%d of %d have their depth", good, n);
    free_world(&w);
}

/* A surface so near that most of the picture would leave the neighbours at its depth. */
static void test_near_at_the_border(void **state)
{
    struct world w;
    struct depthmaps d;
    int good = 0, all = 0;
    (void)state;
    near_card = true;
    make_world(&w, 1);
    near_card = false;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), OK);
    for (int y = 40; y < 80; y++)
        for (int x = 6; x < 30; x++, all++)
            good += fabsf(d.depth[d.extent[1].at + (size_t)(y * SIZE + x)] - 0.45f) < 0.02f;
    print_message("  near card: %d of %d pixels\n", good, all);
    assert_true(good > all * 9 / 10);
    free_world(&w);
}

static void test_refusals(void **state)
{
    (void)state;
    struct world w;
    struct depthmaps d;
    atomic_bool cancel = true;
    make_world(&w, 1);
    w.run.cancel = &cancel;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), ERR_CANCELLED);
    assert_true(d.depth == NULL && w.keep.used == 0 && w.tmp.used == 0);
    w.run.cancel = NULL;
    w.tmp.size /= 2;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), ERR_NOMEM);
    w.tmp.size *= 2;
    w.cams[2].t[1] = NAN;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), ERR_ARG);
    w.cams[2].t[1] = 0.0f;
    w.cams[3].fx = 0.0f;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), ERR_ARG);
    w.v.cams = NULL;
    assert_int_equal(sweep_run(&w.run, &w.v, &w.tone, &d), ERR_ARG);
    free_world(&w);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_depth),
        cmocka_unit_test(test_few_views_confirm_a_slope),
        cmocka_unit_test(test_same_for_any_number_of_threads),
        cmocka_unit_test(test_same_for_any_number_of_ranks),
        cmocka_unit_test(test_nothing_to_match),
        cmocka_unit_test(test_blank_wall),
        cmocka_unit_test(test_black_is_not_a_bright_surface),
        cmocka_unit_test(test_two_views),
        cmocka_unit_test(test_seen_by_one_neighbour),
        cmocka_unit_test(test_near_at_the_border),
        cmocka_unit_test(test_refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
