/* Seeds on a slanted plane with exact depth maps: on the surface, everywhere, once, with the right
 * radiance. */
#include "core/stereo/seed.h"

#include "core/base/shell.h"
#include "core/photo/response.h"
#include "core/stereo/far.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { VIEWS = 4, SIZE = 96, MAP = SIZE / 2, MAX = 20000 };

static const float SLOPE = 0.4f; // in the plane z = 4 + SLOPE x

struct world {
    struct views v;
    struct camera cams[VIEWS];
    float log2t[VIEWS];
    struct depthmaps depth;
    struct tonemap tone;
    struct seed_input in;
    struct arena keep, tmp;
    struct run run;
};

static float plane_depth(const struct camera *c, float u, float *x)
{
    float ray = (u - c->cx) / c->fx, ox = -c->t[0], oz = -c->t[2];
    float z = (4.0f + SLOPE * ox - oz) / (1.0f - SLOPE * ray);
    *x = ox + z * ray;
    return z;
}

/* Left half of the plane is flat in colour, right half striped; natural log of radiance. */
static float plane_light(float x)
{
    return x < 0.0f ? -0.5f : 0.6f * sinf(9.0f * x);
}

static void make_world(struct world *w)
{
    memset(w, 0, sizeof *w);
    w->v = (struct views){.n = VIEWS,
                          .size = SIZE,
                          .extent = squares(VIEWS, SIZE),
                          .log2t = w->log2t,
                          .cams = w->cams};
    w->v.rgb = malloc((size_t)VIEWS * SIZE * SIZE * 3);
    assert_non_null(w->v.rgb);
    w->depth = (struct depthmaps){.n = VIEWS, .scale = 2, .extent = squares(VIEWS, MAP)};
    struct plan plan = plan_begin(1);
    struct gaussians splats;
    assert_int_equal(arena_alloc(&plan.keep, VIEWS * MAP * MAP, sizeof(float), &w->depth.depth),
                     OK);
    assert_int_equal(arena_alloc(&plan.keep, VIEWS * MAP * MAP, sizeof(float), &w->depth.conf), OK);
    seed_plan(&plan, w->depth.extent, VIEWS, MAX, &splats);
    assert_int_equal(arena_init(&w->tmp, "tmp", plan.tmp.peak), OK);
    assert_int_equal(arena_init(&w->keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_alloc(&w->keep, VIEWS * MAP * MAP, sizeof(float), &w->depth.depth), OK);
    assert_int_equal(arena_alloc(&w->keep, VIEWS * MAP * MAP, sizeof(float), &w->depth.conf), OK);
    response_fit(NULL, 0, 0.0f, &w->tone);
    for (int i = 0; i < VIEWS; i++) {
        float x;
        w->log2t[i] = (float)(i % 2) - 0.5f;
        w->cams[i] =
            (struct camera){.w = SIZE, .h = SIZE, .fx = 90, .fy = 90, .cx = 48, .cy = 48, .q = {1}};
        w->cams[i].t[0] = 0.2f * (float)i - 0.3f;
        for (int k = 0; k < SIZE * SIZE; k++) {
            (void)plane_depth(&w->cams[i], (float)(k % SIZE) + 0.5f, &x);
            for (int c = 0; c < 3; c++) {
                float display =
                    response_display(&w->tone, c, plane_light(x) / 0.69314718f + w->log2t[i]);
                w->v.rgb[(i * SIZE * SIZE + k) * 3 + c] = (uint8_t)(255.0f * display + 0.5f);
            }
        }
        for (int k = 0; k < MAP * MAP; k++) {
            w->depth.depth[i * MAP * MAP + k] =
                plane_depth(&w->cams[i], 2.0f * (float)(k % MAP) + 1.0f, &x);
            w->depth.conf[i * MAP * MAP + k] = 1.0f;
        }
    }
    w->in = (struct seed_input){&w->v, &w->depth, &w->tone};
    w->run = (struct run){.keep = &w->keep, .tmp = &w->tmp};
}

static void free_world(struct world *w)
{
    arena_free(&w->keep);
    arena_free(&w->tmp);
    free(w->v.rgb);
}

static void check_finite(const struct gaussians *g)
{
    for (int p = 0; p < gaussians_planes(0); p++) {
        for (int i = 0; i < g->n; i++)
            assert_true(isfinite(g->plane[p][i]));
    }
}

/* Mark the pixels of view j's map within two standard deviations of splat i. */
static void mark_hits(const struct world *w, const struct gaussians *g, int j, int i, uint8_t *hit)
{
    const float *t = w->cams[j].t;
    float f = 45.0f / (g->plane[G_MU + 2][i] + t[2]);
    float u = (g->plane[G_MU][i] + t[0]) * f + 23.5f,
          v = (g->plane[G_MU + 1][i] + t[1]) * f + 23.5f;
    float reach = 2.0f * expf(g->plane[G_LOG_SCALE + 1][i]) * f;
    for (int k = 0; k < MAP * MAP; k++)
        hit[k] |= fabsf((float)(k % MAP) - u) <= reach && fabsf((float)(k / MAP) - v) <= reach;
}

/* Share of the pixels of the maps that have a splat within two standard deviations. */
static float coverage(const struct world *w, const struct gaussians *g)
{
    int sum = 0;
    for (int j = 0; j < VIEWS; j++) {
        uint8_t hit[MAP * MAP] = {0};
        for (int i = 0; i < g->n; i++)
            mark_hits(w, g, j, i, hit);
        for (int k = 0; k < MAP * MAP; k++)
            sum += hit[k];
    }
    return (float)sum / (VIEWS * MAP * MAP);
}

static void test_plane(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    int flat = 0, off = 0, behind = 0;
    make_world(&w);
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    assert_int_equal(w.tmp.used, 0);
    check_finite(&g);
    assert_true(g.n > 500 && g.n < 3 * MAP * MAP);
    for (int i = 0; i < g.n; i++) {
        float x = g.plane[G_MU][i], z = g.plane[G_MU + 2][i],
              light = g.plane[G_SH + 1][i] * 0.2820948f;
        if (g.plane[G_LOGIT][i] < 1.0f) { // fills a crack at the rim of a view
            assert_true(z - 4.0f - SLOPE * x > -0.01f * z);
            behind++;
            continue;
        }
        assert_true(fabsf(z - 4.0f - SLOPE * x) < 0.01f * z);
        flat += x < -0.1f;
        off += fabsf(light - plane_light(x)) > 0.15f;
        /* The thin axis is the normal of the plane: third column of the rotation along (SLOPE, 0,
         * -1). */
        float q[4];
        for (int k = 0; k < 4; k++)
            q[k] = g.plane[G_QUAT + k][i];
        float nx = 2.0f * (q[1] * q[3] + q[0] * q[2]),
              nz = 1.0f - 2.0f * (q[1] * q[1] + q[2] * q[2]);
        assert_true(fabsf(nx * SLOPE - nz) / sqrtf(1.0f + SLOPE * SLOPE) > 0.98f);
    }
    assert_true(behind < g.n / 50);
    assert_true(flat < g.n / 6); // one large splat stands for many pixels
    assert_true(off < g.n / 10);
    assert_true(coverage(&w, &g) > 0.995f);
    free_world(&w);
}

/* The upper third of each view is on the shell. far: (VIEWS, MAP, MAP) room. */
static struct shell put_far(struct world *w, uint8_t *far, uint8_t kind)
{
    const struct shell shell = shell_of(w->cams, VIEWS);
    w->depth.far = far;
    for (int k = 0; k < VIEWS * MAP * MAP; k++) {
        const int y = k / MAP % MAP, x = k % MAP;
        far[k] = y < MAP / 3 ? kind : 0;
        if (far[k])
            w->depth.depth[k] =
                shell_depth(&shell, &w->cams[k / (MAP * MAP)], 2 * (float)x + 1, 2 * (float)y + 1);
    }
    return shell;
}

/* The upper third of each view is sky, saturated in all views but the first: it is on the shell,
 * has the radiance of the view that tells it, lets nothing through, and no guess about other
 * pixels stands on it. */
static void test_sky_is_on_the_shell(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    static uint8_t far[VIEWS * MAP * MAP];
    int sky = 0, seen[2] = {0};
    make_world(&w);
    const struct shell shell = put_far(&w, far, FAR_SKY);
    for (int k = 0; k < VIEWS * MAP * MAP; k++)
        if (k / MAP % MAP >= MAP / 3 && k / MAP % MAP < MAP / 2)
            w.depth.conf[k] = 0;
    for (int i = 0; i < VIEWS; i++)
        memset(w.v.rgb + (size_t)i * SIZE * SIZE * 3, i ? 255 : 200, SIZE / 3 * SIZE * 3);
    for (int y = 0; y < SIZE / 3; y++)
        memset(w.v.rgb + (size_t)y * SIZE * 3, 180, SIZE / 2 * 3); // a cloud
    float want[2];                                                 // left, right
    for (int k = 0; k < 2; k++)
        want[k] = response_radiance_log(&w.tone, 0, (k ? 200 : 180) / 255.0f, w.log2t[0]);
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    check_finite(&g);
    for (int i = 0; i < g.n; i++) {
        const float x[3] = {g.plane[G_MU][i], g.plane[G_MU + 1][i], g.plane[G_MU + 2][i]};
        if (!shell_has(&shell, x)) {
            assert_true(x[2] < 20);
            continue;
        }
        sky++;
        assert_true(x[1] < 0 && g.plane[G_LOGIT][i] > 3);
        const float light = g.plane[G_SH][i] * 0.2820948f;
        assert_true(light > want[0] - 0.1f && light < want[1] + 0.1f);
        for (int k = 0; k < 2; k++)
            seen[k] += fabsf(light - want[k]) < 0.02f;
    }
    assert_true(seen[0] > 3 && seen[1] > 3);  // each part has its own radiance
    assert_true(sky > 20 && sky < MAP * MAP); // many pixels each
    free_world(&w);
}

/* The upper third of each view is a black backdrop with noise: one pixel in eight is not 0. It is
 * as dark as the mean of its pixels, although the bright ones alone are reliable. */
static void test_black_backdrop_is_as_dark_as_its_mean(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    static uint8_t far[VIEWS * MAP * MAP];
    double sum = 0, n = 0;
    make_world(&w);
    const struct shell shell = put_far(&w, far, FAR_BLACK);
    for (int k = 0; k < VIEWS * SIZE * SIZE; k++)
        if (k % (SIZE * SIZE) < SIZE / 3 * SIZE)
            memset(w.v.rgb + (size_t)k * 3, ((unsigned)k * 2654435761u) >> 29 ? 0 : 24, 3);
    memset(w.log2t, 0, sizeof w.log2t);
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    const double noise = exp((double)response_radiance_log(&w.tone, 0, 24 / 255.0f, 0)),
                 black = exp((double)response_radiance_log(&w.tone, 0, 0, 0));
    for (int i = 0; i < g.n; i++) {
        const float x[3] = {g.plane[G_MU][i], g.plane[G_MU + 1][i], g.plane[G_MU + 2][i]};
        if (!shell_has(&shell, x))
            continue;
        const double area = exp(2 * (double)g.plane[G_LOG_SCALE + 1][i]);
        sum += area * exp((double)(g.plane[G_SH][i] * 0.2820948f));
        n += area;
    }
    const double mean = sum / n, want = noise / 8 + black * 7 / 8;
    print_message("  backdrop %.5f, as told %.5f, noise %.5f\n", mean, want, noise);
    assert_true(fabs(mean / want - 1) < 0.25);
    free_world(&w);
}

/* The first view shows a wall of which red is saturated; the others are black, which tells nothing
 * of it. Red is as bright as saturation at least. Where the first view is black and the others are
 * white, its own splats stay black. */
static void test_saturated_and_black_are_bounds(void **state)
{
    (void)state;
    for (int black = 0; black < 2; black++) {
        struct world w;
        struct gaussians g;
        make_world(&w);
        memset(w.v.rgb, black ? 255 : 0, (size_t)VIEWS * SIZE * SIZE * 3);
        for (int k = 0; k < SIZE * SIZE; k++)
            memcpy(w.v.rgb + 3 * k, black ? (uint8_t[]){3, 0, 2} : (uint8_t[]){255, 200, 150}, 3);
        for (int k = 0; k < MAP * MAP && black; k++) // lets all others wait
            w.depth.conf[MAP * MAP + k] = w.depth.conf[2 * MAP * MAP + k] =
                w.depth.conf[3 * MAP * MAP + k] = 0.3f;
        assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
        int n = 0;
        for (int i = 0; i < g.n; i++) {
            const float light = g.plane[G_SH][i] * 0.2820948f;
            if (g.plane[G_LOGIT][i] < 1.0f || fabsf(g.plane[G_MU][i]) > 1)
                continue;
            n++;
            if (black)
                assert_true(light <=
                            response_radiance_log(&w.tone, 0, 8 / 255.0f, w.log2t[0]) + 0.01f);
            else
                assert_true(light > response_radiance_log(&w.tone, 0, 246 / 255.0f, w.log2t[0]));
        }
        assert_true(n > 10);
        free_world(&w);
    }
}

static void test_detail_is_given_up(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    for (int max = MAX; max >= 1; max /= 7) {
        size_t mark = arena_mark(&w.keep);
        assert_int_equal(seed_run(&w.run, &w.in, max, &g), OK);
        assert_true(g.n >= 1 && g.n <= max);
        check_finite(&g);
        assert_true(max < 400 || coverage(&w, &g) > 0.98f);
        arena_reset(&w.keep, mark);
    }
    free_world(&w);
}

static void test_floating_surface_is_dropped(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    for (int y = 10; y < 20; y++) {
        for (int x = 20; x < 30; x++)
            w.depth.depth[MAP * MAP + y * MAP + x] =
                2.0f; // view 1 alone believes in something near
    }
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    for (int i = 0; i < g.n; i++)
        assert_true(g.plane[G_MU + 2][i] > 2.5f);
    free_world(&w);
}

/* Views 1 and 2 confirm each other in something near, which view 3 sees through and view 0 does not
 * judge. */
static void test_wrong_matches_are_dropped(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    for (int k = 0; k < VIEWS * MAP * MAP; k++) {
        const struct camera *c = &w.cams[k / (MAP * MAP)];
        const float z = 2.0f + c->t[2], u = 2.0f * (float)(k % MAP) + 1.0f;
        const float v = 2.0f * (float)(k / MAP % MAP) + 1.0f;
        const float x = (u - c->cx) / c->fx * z - c->t[0], y = (v - c->cy) / c->fy * z - c->t[1];
        const int view = k / (MAP * MAP);
        if (view == 0)
            w.depth.conf[k] = 0.0f;
        else if (view < 3 && fabsf(x) < 0.2f && fabsf(y) < 0.2f)
            w.depth.depth[k] = z;
    }
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    for (int i = 0; i < g.n; i++)
        assert_true(g.plane[G_MU + 2][i] > 2.5f);
    free_world(&w);
}

/* View 0, and as many others, believe in a surface just where the camera of view 3 stands.
 * returns: splats beside that camera. */
static int near_camera(int others)
{
    struct world w;
    struct gaussians g;
    int near = 0;
    make_world(&w);
    memset(w.depth.conf + MAP * MAP, 0,
           2 * MAP * MAP * sizeof(float)); // views 1 and 2 do not judge
    w.cams[3].t[0] = -0.1f;
    w.cams[3].t[2] = -1.0f;
    for (int k = 0; k < MAP * MAP; k++) {
        float surface;
        w.depth.depth[3 * MAP * MAP + k] =
            plane_depth(&w.cams[3], 2.0f * (float)(k % MAP) + 1.0f, &surface);
        for (int i = 0; i <= others; i++) {
            const float x = (2.0f * (float)(k % MAP) - 47) / 90 - w.cams[i].t[0];
            if (fabsf(x - 0.1f) > 0.08f || abs(k / MAP - 24) > 3)
                continue;
            w.depth.depth[i * MAP * MAP + k] = 1;
            w.depth.conf[i * MAP * MAP + k] = 1;
        }
    }
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    for (int i = 0; i < g.n; i++) {
        const float x = g.plane[G_MU][i] - 0.1f, y = g.plane[G_MU + 1][i];
        const float z = g.plane[G_MU + 2][i] - 1.0f, away = sqrtf(x * x + y * y + z * z);
        assert_true(away > 0.03f);
        near += away < 0.1f;
    }
    free_world(&w);
    return near;
}

static void test_cameras_are_in_the_open(void **state)
{
    (void)state;
    assert_int_equal(near_camera(1), 0);
    assert_true(near_camera(2) > 0);
}

/* View 0 guesses a surface at a depth where camera 3 stands at `x`, 1 before it, and does not see
 * it: nothing is guessed around that camera, nor with a corner before what it sees. */
static void expect_open(float x, float guess)
{
    struct world w;
    struct gaussians g;
    int guesses = 0;
    make_world(&w);
    memset(w.depth.conf, 0, 3 * MAP * MAP * sizeof(float));
    for (int i = 1; i < 3; i++) { // views 1 and 2 look back
        w.cams[i].q[0] = 0;
        w.cams[i].q[2] = 1;
    }
    w.cams[3].t[0] = -x;
    w.cams[3].t[2] = -1.0f;
    for (int k = 0; k < MAP * MAP; k++) {
        float surface;
        w.depth.depth[3 * MAP * MAP + k] =
            plane_depth(&w.cams[3], 2.0f * (float)(k % MAP) + 1.0f, &surface);
        w.depth.depth[k] = guess;
        w.depth.conf[k] = k % MAP < 3;
    }
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    for (int i = 0; i < g.n; i++) {
        const float at[3] = {g.plane[G_MU][i] - x, g.plane[G_MU + 1][i],
                             g.plane[G_MU + 2][i] - 1.0f};
        const float half = 0.5f * expf(g.plane[G_LOG_SCALE + 1][i]) / 0.55f;
        if (g.plane[G_LOGIT][i] > 1.0f)
            continue;
        guesses++;
        assert_true(at[0] * at[0] + at[1] * at[1] + at[2] * at[2] > 1);
        for (int k = 0; k < 4 && at[2] > 0; k++) {
            const float u = 45 * (at[0] + (k % 2 ? half : -half)) / at[2] + 24;
            const float v = 45 * (at[1] + (k / 2 ? half : -half)) / at[2] + 24;
            if (u > 1 && v > 1 && u < MAP - 1 && v < MAP - 1)
                assert_true(at[2] > 0.9f * w.depth.depth[(3 * MAP + (int)v) * MAP + (int)u]);
        }
    }
    assert_true(guesses > 10);
    free_world(&w);
}

static void test_guesses_leave_cameras_in_the_open(void **state)
{
    (void)state;
    expect_open(-0.3f, 1.5f);
    expect_open(0.25f, 2.9f);
}

/* Where nothing is sure, holes are filled from behind: nothing new stands before the surface. */
static void test_unsure_pixels_are_filled_from_behind(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    for (int k = 0; k < VIEWS * MAP * MAP; k++) {
        if (k / MAP % MAP > 15 && k / MAP % MAP < 30) {
            w.depth.conf[k] = 0.0f;
            w.depth.depth[k] *= 0.5f;
        }
    }
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    check_finite(&g);
    assert_true(coverage(&w, &g) > 0.98f);
    for (int i = 0; i < g.n; i++)
        assert_true(g.plane[G_MU + 2][i] > 2.5f);
    free_world(&w);
}

/* A hole in a near surface is filled near it, not as far away as the farthest surface of the view.
 */
static void test_hole_is_filled_near_its_surface(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    int guesses = 0;
    make_world(&w);
    for (int k = 0; k < VIEWS * MAP * MAP; k++)
        if (k % MAP > 2 && k % MAP < 20 && k / MAP % MAP > 15 && k / MAP % MAP < 30)
            w.depth.conf[k] = 0.0f;
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    assert_true(coverage(&w, &g) > 0.98f);
    for (int i = 0; i < g.n; i++) {
        float x = g.plane[G_MU][i], z = g.plane[G_MU + 2][i], surface = 4.0f + SLOPE * x;
        if (g.plane[G_LOGIT][i] > 1.0f || x > -1.0f || fabsf(g.plane[G_MU + 1][i]) > 0.6f)
            continue;
        guesses++;
        if (z < 0.99f * surface || z > 1.25f * surface)
            fail_msg("a guess at depth %g where the surface is at %g", (double)z, (double)surface);
    }
    assert_true(guesses > 3);
    free_world(&w);
}

/* Views in which next to nothing is sure are filled, too. */
static void test_blind_views_are_filled(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    memset(w.depth.conf, 0, VIEWS * MAP * MAP * sizeof(float));
    for (int k = 0; k < MAP; k++)
        w.depth.conf[k] = 1.0f; // 2 % of the first view
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
    assert_true(coverage(&w, &g) > 0.98f);
    free_world(&w);
}

static void test_extremes(void **state)
{
    (void)state;
    struct world w;
    struct gaussians g;
    make_world(&w);
    size_t mark = arena_mark(&w.keep);
    for (int value = 0; value <= 255; value += 255) {
        memset(w.v.rgb, value, (size_t)VIEWS * SIZE * SIZE * 3);
        memset(w.depth.conf, 0, VIEWS * MAP * MAP * sizeof(float));
        assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), OK);
        assert_true(g.n > 0);
        check_finite(&g);
        arena_reset(&w.keep, mark);
    }
    atomic_bool cancel = true;
    w.run.cancel = &cancel;
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), ERR_CANCELLED);
    assert_true(g.n == 0 && w.keep.used == mark && w.tmp.used == 0);
    w.run.cancel = NULL;
    assert_int_equal(seed_run(&w.run, &w.in, 0, &g), ERR_ARG);
    w.tmp.size = 1000;
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), ERR_NOMEM);
    w.depth.n = 3;
    assert_int_equal(seed_run(&w.run, &w.in, MAX, &g), ERR_ARG);
    free_world(&w);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_plane),
        cmocka_unit_test(test_sky_is_on_the_shell),
        cmocka_unit_test(test_black_backdrop_is_as_dark_as_its_mean),
        cmocka_unit_test(test_saturated_and_black_are_bounds),
        cmocka_unit_test(test_detail_is_given_up),
        cmocka_unit_test(test_floating_surface_is_dropped),
        cmocka_unit_test(test_wrong_matches_are_dropped),
        cmocka_unit_test(test_cameras_are_in_the_open),
        cmocka_unit_test(test_guesses_leave_cameras_in_the_open),
        cmocka_unit_test(test_unsure_pixels_are_filled_from_behind),
        cmocka_unit_test(test_hole_is_filled_near_its_surface),
        cmocka_unit_test(test_blind_views_are_filled),
        cmocka_unit_test(test_extremes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
