/* A card before a sky whose radiance depends on the direction alone, above textured ground; before
 * a bright smooth wall; and in the dark. Depth of card and ground is known, that of the rest is
 * not. */
#include "core/stereo/far.h"

#include "core/base/shell.h"
#include "core/photo/response.h"
#include "tests/unit/expect.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { VIEWS = 5, SIZE = 96, PIXELS = SIZE * SIZE };

enum backdrop { SKY, WALL, NIGHT };

struct world {
    struct views v;
    struct camera cams[VIEWS];
    float log2t[VIEWS];
    struct depthmaps depth;
    bool truth[VIEWS * PIXELS]; // neither card nor ground
    struct tonemap tone;
    struct pool *pool;
    struct arena keep, tmp;
    struct run run;
};

static float cells(float x, float y)
{
    const uint32_t h =
        (uint32_t)(int)floorf(x * 4) * 73856093u ^ (uint32_t)(int)floorf(y * 4) * 19349663u;
    return (float)((h * 1274126177u >> 8) & 0xffff) / 65535.0f;
}

/* log2 radiance along a ray; depth 0: the backdrop. The wall stands at z = 8 and is lit by a lamp
 * near it. */
static float cast(const struct camera *c, const float ray[2], enum backdrop kind, float *z)
{
    const float o[3] = {-c->t[0], -c->t[1], -c->t[2]};
    const float card = 4 - o[2], ground = ray[1] > 0 ? (1 - o[1]) / ray[1] : 1e9f;
    const float x = o[0] + card * ray[0], y = o[1] + card * ray[1];
    *z = 0;
    if (fabsf(x) < 0.6f && fabsf(y + 0.3f) < 0.8f) {
        *z = card;
        return -1 + 2 * cells(x, y);
    }
    if (ground < 8 - o[2]) {
        *z = ground;
        return -2 + 2 * cells(o[0] + ground * ray[0], ground);
    }
    if (kind == NIGHT)
        return -14;
    if (kind == SKY)
        return 1 - 0.3f * ray[1] + 0.2f * ray[0];
    const float wall = 8 - o[2], across = o[0] + wall * ray[0], up = o[1] + wall * ray[1];
    return 2 - 0.12f * (across * across + up * up);
}

static void paint(struct world *w, int i, enum backdrop kind)
{
    const struct camera *c = &w->cams[i];
    for (int k = 0; k < PIXELS; k++) {
        const float ray[2] = {((float)(k % SIZE) + 0.5f - c->cx) / c->fx,
                              ((float)(k / SIZE) + 0.5f - c->cy) / c->fy};
        float z;
        const float light = cast(c, ray, kind, &z);
        const size_t at = (size_t)(i * PIXELS + k);
        for (int j = 0; j < 3; j++)
            w->v.rgb[3 * at + (size_t)j] =
                (uint8_t)(255 *
                              response_display(&w->tone, j, light + w->log2t[i] - w->v.mid_log2t) +
                          0.5f);
        w->truth[at] = z == 0;
        w->depth.depth[at] = z > 0 ? z : 3;
        w->depth.conf[at] = z > 0 ? 1 : 0;
    }
}

static void make_world(struct world *w, enum backdrop kind, const float stops[VIEWS], int threads)
{
    memset(w, 0, sizeof *w);
    w->v = (struct views){.n = VIEWS,
                          .size = SIZE,
                          .extent = squares(VIEWS, SIZE),
                          .log2t = w->log2t,
                          .cams = w->cams};
    w->v.rgb = malloc((size_t)VIEWS * PIXELS * 3);
    assert_non_null(w->v.rgb);
    w->depth = (struct depthmaps){.n = VIEWS, .scale = 1, .extent = squares(VIEWS, SIZE)};
    struct plan plan = plan_begin(threads);
    arena_hold(&plan.keep, 2 * arena_need((size_t)VIEWS * PIXELS, sizeof(float)));
    far_plan(&plan, w->depth.extent, VIEWS);
    assert_int_equal(arena_init(&w->tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(arena_init(&w->keep, "keep", plan.keep.peak), OK);
    expect_ok(arena_alloc(&w->keep, (size_t)VIEWS * PIXELS, sizeof(float), &w->depth.depth));
    expect_ok(arena_alloc(&w->keep, (size_t)VIEWS * PIXELS, sizeof(float), &w->depth.conf));
    expect_ok(pool_open(&w->pool, threads));
    w->run = (struct run){.keep = &w->keep, .tmp = &w->tmp, .pool = w->pool};
    response_fit(NULL, 0, 0.0f, &w->tone);
    for (int i = 0; i < VIEWS; i++) {
        w->log2t[i] = stops[i];
        w->cams[i] = (struct camera){.w = SIZE,
                                     .h = SIZE,
                                     .fx = 70,
                                     .fy = 70,
                                     .cx = SIZE / 2.0f,
                                     .cy = SIZE / 2.0f,
                                     .q = {1},
                                     .t = {0.8f * (float)(2 - i), 0, 0.1f * (float)(i % 2)}};
        paint(w, i, kind);
    }
}

static void free_world(struct world *w)
{
    pool_close(w->pool);
    arena_free(&w->keep);
    arena_free(&w->tmp);
    free(w->v.rgb);
}

/* Shares of the backdrop and of all else that is far. */
static void shares(const struct world *w, float *hit, float *wrong)
{
    int n[2] = {0}, far[2] = {0};
    for (int k = 0; k < VIEWS * PIXELS; k++) {
        n[w->truth[k]]++;
        far[w->truth[k]] += w->depth.far && w->depth.far[k];
    }
    *hit = (float)far[1] / (float)n[1];
    *wrong = (float)far[0] / (float)n[0];
}

static const float EQUAL[VIEWS] = {0}, MIXED[VIEWS] = {-2, 0, 2, -2, 2};

static void the_sky_is_far(void **state)
{
    (void)state;
    static struct world w;
    for (int mixed = 0; mixed < 2; mixed++) {
        float hit, wrong;
        make_world(&w, SKY, mixed ? MIXED : EQUAL, 2);
        expect_ok(far_run(&w.run, &w.v, &w.tone, &w.depth));
        shares(&w, &hit, &wrong);
        if (hit < 0.98f || wrong > 0.01f)
            fail_msg("%.3f of the sky is far, and %.3f of the rest", (double)hit, (double)wrong);
        const struct shell s = shell_of(w.cams, VIEWS);
        for (int k = 0; k < VIEWS * PIXELS; k++) {
            if (w.depth.far[k])
                assert_true(w.depth.conf[k] == FAR_CONF && w.depth.depth[k] > 0.5f * s.radius);
            else
                assert_true(w.depth.depth[k] < 0.5f * s.radius);
        }
        free_world(&w);
    }
}

/* Windows that reach over its edge give the backdrop the depth of the card. */
static void fatten(struct world *w)
{
    for (int k = 0; k < VIEWS * PIXELS; k++)
        for (int i = 0; i < 49 && w->truth[k]; i++) {
            const int x = k % SIZE + i % 7 - 3, y = k / SIZE % SIZE + i / 7 - 3;
            if (x < 0 || y < 0 || x >= SIZE || y >= SIZE ||
                w->truth[k / PIXELS * PIXELS + y * SIZE + x])
                continue;
            w->depth.depth[k] = 4;
            w->depth.conf[k] = 1;
        }
}

/* Black is where the longest exposures show none of the lamps' light; a short one tells nothing. */
static void the_dark_is_far(void **state)
{
    (void)state;
    static struct world w;
    for (int k = 0; k < 3; k++) {
        const bool mixed = k == 1, fat = k == 2;
        float hit, wrong;
        make_world(&w, NIGHT, mixed ? MIXED : EQUAL, 2);
        if (fat)
            fatten(&w);
        for (int i = 0; i < VIEWS * PIXELS * 3; i++) // noise
            w.v.rgb[i] = (uint8_t)(w.v.rgb[i] + (w.v.rgb[i] < 8 ? i * 7919 % 5 : 0));
        expect_ok(far_run(&w.run, &w.v, &w.tone, &w.depth));
        shares(&w, &hit, &wrong);
        if (hit < 0.98f || wrong > 0.01f)
            fail_msg("%.3f of the dark is far, and %.3f of the rest", (double)hit, (double)wrong);
        free_world(&w);
    }
}

/* What hangs on the wall moves, and so does its light. */
static void a_smooth_wall_is_not(void **state)
{
    (void)state;
    static struct world w;
    for (int mixed = 0; mixed < 2; mixed++) {
        float hit, wrong;
        make_world(&w, WALL, mixed ? MIXED : EQUAL, 1);
        expect_ok(far_run(&w.run, &w.v, &w.tone, &w.depth));
        shares(&w, &hit, &wrong);
        if (hit > 0 || wrong > 0)
            fail_msg("%.3f of the wall is far, and %.3f of the rest", (double)hit, (double)wrong);
        free_world(&w);
    }
}

static void nothing_to_see(void **state)
{
    (void)state;
    static struct world w;
    for (int white = 0; white < 2; white++) {
        make_world(&w, SKY, EQUAL, 1);
        memset(w.v.rgb, white ? 255 : 0, (size_t)VIEWS * PIXELS * 3);
        expect_ok(far_run(&w.run, &w.v, &w.tone, &w.depth));
        for (int k = 0; k < VIEWS * PIXELS; k++)
            assert_false(w.depth.far[k]);
        free_world(&w);
    }
    make_world(&w, SKY, EQUAL, 1);
    for (int i = 0; i < VIEWS; i++)
        memset(w.cams[i].t, 0, sizeof w.cams[i].t);
    const float before = w.depth.depth[0];
    expect_ok(far_run(&w.run, &w.v, &w.tone, &w.depth));
    assert_true(!w.depth.far && w.depth.depth[0] == before);
    w.cams[0].t[0] = 1;
    atomic_bool cancel = true;
    w.run.cancel = &cancel;
    assert_int_equal(far_run(&w.run, &w.v, &w.tone, &w.depth), ERR_CANCELLED);
    free_world(&w);
}

static void same_for_any_number_of_threads(void **state)
{
    (void)state;
    static struct world one, four;
    make_world(&one, SKY, MIXED, 1);
    make_world(&four, SKY, MIXED, 4);
    expect_ok(far_run(&one.run, &one.v, &one.tone, &one.depth));
    expect_ok(far_run(&four.run, &four.v, &four.tone, &four.depth));
    assert_memory_equal(one.depth.far, four.depth.far, (size_t)VIEWS * PIXELS);
    assert_memory_equal(one.depth.depth, four.depth.depth, (size_t)VIEWS * PIXELS * sizeof(float));
    free_world(&one);
    free_world(&four);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_sky_is_far),
        cmocka_unit_test(the_dark_is_far),
        cmocka_unit_test(a_smooth_wall_is_not),
        cmocka_unit_test(nothing_to_see),
        cmocka_unit_test(same_for_any_number_of_threads),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
