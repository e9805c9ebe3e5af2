/* Predictions of a network that is not there, corrected by cameras, depth and photographs. */
#include "core/base/gaussians.h"
#include "core/base/rotation.h"
#include "core/kernels/kernels.h"
#include "core/net/depth.h"
#include "core/photo/response.h"
#include "core/photo/tonemap.h"
#include "core/refine/correct.h"
#include "core/splat/raster.h"
#include "core/splat/voxel.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

/* ---- geometry ---- */

enum { VIEWS = 4, SIZE = 28, PX = SIZE * SIZE, N = VIEWS * PX };

struct world {
    struct arena keep, tmp;
    struct kernels kernels;
    struct run r;
    struct prediction p;
    struct camera own[VIEWS], known[VIEWS];
    uint8_t rgb[3 * N];
    float log2t[VIEWS];
};

static struct world w;

static float wave(int i, int k)
{
    return sinf((float)(i * 7 + k * 13) * 0.37f);
}

/* Cameras around a wall at depth 2; known cameras: the same, turned, moved, 3 times as large. */
static void make_cameras(void)
{
    const float turn[4] = {0.6f, 0.48f, -0.64f, 0}; // unit
    for (int i = 0; i < VIEWS; i++) {
        struct camera *c = &w.own[i], *k = &w.known[i];
        float half = 0.05f * (float)i;
        *c = (struct camera){.w = SIZE, .h = SIZE, .fx = 30, .fy = 30, .cx = 14, .cy = 14};
        c->q[0] = cosf(half), c->q[2] = sinf(half);
        c->t[0] = 0.3f * (float)i, c->t[1] = 0.1f * (float)(i % 2), c->t[2] = 0.05f;
        /* q_known = q conj(turn); centre 3 turn(c) + (1, 2, 3) */
        const float *a = c->q, b[4] = {turn[0], -turn[1], -turn[2], -turn[3]};
        float r[9], centre[3], moved[3], s[9];
        *k = *c;
        k->q[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
        k->q[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
        k->q[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
        k->q[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
        rotation_from_unit(c->q, r);
        rotation_from_unit(turn, s);
        for (int j = 0; j < 3; j++)
            centre[j] = -(r[j] * c->t[0] + r[3 + j] * c->t[1] + r[6 + j] * c->t[2]);
        for (int j = 0; j < 3; j++)
            moved[j] =
                3 * (s[3 * j] * centre[0] + s[3 * j + 1] * centre[1] + s[3 * j + 2] * centre[2]) +
                (float)(j + 1);
        rotation_from_unit(k->q, r);
        for (int j = 0; j < 3; j++)
            k->t[j] = -(r[3 * j] * moved[0] + r[3 * j + 1] * moved[1] + r[3 * j + 2] * moved[2]);
    }
}

static struct tonemap plain_tone(void)
{
    struct tonemap t;
    response_fit(NULL, 0, 1, &t);
    return t;
}

/* A photograph of a grey whose log2 radiance this is. */
static void paint(int view, float radiance, float log2t)
{
    const struct tonemap tone = plain_tone();
    w.log2t[view] = log2t;
    const float shown = response_display(&tone, 0, radiance + w.log2t[view] - tone.mid_log2t);
    memset(w.rgb + 3 * PX * view, (int)(255 * shown + 0.5f), 3 * PX);
}

static int setup(void **state)
{
    (void)state;
    memset(&w, 0, sizeof w);
    make_cameras();
    for (int i = 0; i < VIEWS; i++)
        paint(i, 0, (float)(i % 3));
    struct plan plan = plan_begin(1);
    voxel_plan(&plan, N);
    if (arena_init(&w.keep, "keep", plan.keep.peak + (4 << 20)) != OK ||
        arena_init(&w.tmp, "tmp", plan.tmp.peak + raster_plan(N, SIZE, SIZE, false) + (4 << 20)) !=
            OK)
        return -1;
    kernels_init(&w.kernels, 0);
    w.r = (struct run){.k = &w.kernels, .keep = &w.keep, .tmp = &w.tmp};
    struct geometry *g = &w.p.geom;
    w.p.n = N;
    if (arena_alloc(&w.keep, VIEWS, sizeof *g->cams, &g->cams) != OK ||
        arena_alloc(&w.keep, N, sizeof(float), &g->depth) != OK ||
        arena_alloc(&w.keep, N, 3 * sizeof(float), &w.p.points) != OK ||
        arena_alloc(&w.keep, N, VOXEL_FEATURES * sizeof(float), &w.p.features) != OK ||
        arena_alloc(&w.keep, N, sizeof(float), &w.p.confidence) != OK)
        return -1;
    g->n_views = VIEWS, g->size = SIZE;
    memcpy(g->cams, w.own, sizeof w.own);
    for (int i = 0; i < N; i++) {
        g->depth[i] = 2 + 0.2f * wave(i, 0);
        w.p.confidence[i] = wave(i, 1);
        for (int k = 0; k < VOXEL_FEATURES; k++)
            w.p.features[k * N + i] = wave(i, k + 2) * (k >= VOXEL_SH ? 2 : 1);
        for (int k = 0; k < 3; k++)
            w.p.features[(VOXEL_SCALE + k) * N + i] += 20;
    }
    for (int v = 0; v < VIEWS; v++)
        depth_unproject(g, v, w.p.points + (size_t)v * PX * 3);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&w.keep);
    arena_free(&w.tmp);
    return 0;
}

static void draw(const struct gaussians *g, const struct camera *cam, float px[4 * PX])
{
    struct raster rs;
    struct raster_input in = {g, cam, {1, 1, 1}};
    struct render out = {.radiance = px, .alpha = px + 3 * PX};
    size_t mark = arena_mark(&w.tmp);
    assert_int_equal(raster_init(&rs, &w.tmp, g->cap, SIZE, SIZE, false), OK);
    assert_int_equal(raster_run(&w.r, &rs, &in, &out), OK);
    arena_reset(&w.tmp, mark);
}

/* The cell is small enough that no two pixels share one: rounding cannot move points to others. */
static void pictures(const struct camera *cam, float scale, float px[4 * PX])
{
    const struct voxel_input in = {w.p.n, w.p.points, w.p.features, w.p.confidence};
    struct voxels v;
    struct gaussians g;
    float cell;
    size_t mark = arena_mark(&w.keep);
    assert_int_equal(voxel_merge_most(&w.r, &in, 1e-5f, 0, &v, &cell), OK);
    assert_float_equal(cell, 1e-5f, 0);
    assert_int_equal(voxel_adapt(&w.r, &v, &g), OK);
    gaussians_scale(&g, scale);
    draw(&g, cam, px);
    arena_reset(&w.keep, mark);
}

static void known_cameras_see_what_the_network_saw(void **state)
{
    (void)state;
    static float before[VIEWS][4 * PX], after[4 * PX];
    float scale;
    for (int v = 0; v < VIEWS; v++)
        pictures(&w.own[v], 1, before[v]);
    assert_int_equal(correct_cameras(&w.r, w.known, NULL, &w.p, &scale), OK);
    assert_float_equal(scale, 3, 1e-4f);
    for (int v = 0; v < VIEWS; v++) {
        double worst = 0, ink = 0;
        pictures(&w.known[v], scale, after);
        for (int i = 0; i < 4 * PX; i++) {
            worst = fmax(worst, fabs((double)(after[i] - before[v][i])));
            ink += fabs((double)before[v][i] - 1);
        }
        print_message("  view %d: largest difference %.1e\n", v, worst);
        assert_true(ink > PX / 4);
        assert_true(worst < 2e-3);
    }
}

static double softplus(float x)
{
    return x > 30 ? (double)x : log1p(exp((double)x));
}

static void views_that_are_left_out_leave_no_gap(void **state)
{
    (void)state;
    const bool keep[VIEWS] = {true, false, true, false};
    const int from[2] = {0, 2}, n = 2 * PX;
    float scale[VIEWS] = {1, 2, 3, 4};
    static float features[VOXEL_FEATURES * N];
    for (int i = 0; i < N; i++)
        w.p.confidence[i] = w.p.geom.depth[i] = w.p.points[3 * i + 2] = (float)i;
    for (int i = 0; i < VOXEL_FEATURES * N; i++)
        features[i] = w.p.features[i] = (float)i;
    correct_drop(keep, scale, &w.p);
    assert_int_equal(w.p.n, n);
    assert_int_equal(w.p.geom.n_views, 2);
    for (int v = 0; v < 2; v++) {
        assert_float_equal(scale[v], (float)from[v] + 1, 0);
        assert_memory_equal(&w.p.geom.cams[v], &w.own[from[v]], sizeof w.own[0]);
        for (int i = 0; i < PX; i++) {
            const int now = v * PX + i, was = from[v] * PX + i;
            assert_float_equal(w.p.confidence[now], (float)was, 0);
            assert_float_equal(w.p.geom.depth[now], (float)was, 0);
            assert_float_equal(w.p.points[3 * now + 2], (float)was, 0);
            for (int k = 0; k < VOXEL_FEATURES; k++)
                assert_float_equal(w.p.features[k * n + now], features[k * N + was], 0);
        }
    }
}

/* Maps and photographs (grey unless said) of a world 3 times as large. */
static void sharpen(const struct depthmaps *map, const struct tonemap *tone)
{
    static struct camera cams[VIEWS];
    const struct views v = {.n = VIEWS,
                            .size = SIZE,
                            .extent = squares(VIEWS, SIZE),
                            .rgb = w.rgb,
                            .log2t = w.log2t,
                            .mid_log2t = 1,
                            .cams = cams};
    const struct correct_known known = {{&v, map, tone}, &v, tone};
    memcpy(cams, w.own, sizeof cams);
    for (int i = 0; i < VIEWS; i++)
        for (int k = 0; k < 3; k++)
            cams[i].t[k] *= 3;
    assert_int_equal(correct_run(&w.r, &known, 3, &w.p), OK);
    assert_int_equal(arena_mark(&w.tmp), 0);
}

/* A map of half the size, sure in its upper half, in a world 3 times as large; below, depth is what
 * the views agree on (consensus_test). */
static void sure_depth_moves_pixels_along_their_rays(void **state)
{
    (void)state;
    enum { SMALL = SIZE / 2 };
    static float depth[VIEWS * SMALL * SMALL], conf[VIEWS * SMALL * SMALL], was[N], scales[3 * N],
        want[3 * PX];
    struct depthmaps map = {VIEWS, 2, squares(VIEWS, SMALL), depth, conf, NULL};
    const struct tonemap tone = plain_tone();
    float *size = w.p.features + VOXEL_SCALE * N;
    for (int k = 0; k < VIEWS * SMALL * SMALL; k++) {
        depth[k] = 3 * (1.5f + 0.4f * wave(k, 3));
        conf[k] = k % (SMALL * SMALL) < SMALL * SMALL / 2 ? 0.7f : 0.5f;
    }
    for (int i = 0; i < 3 * N; i++)
        size[i] -= 22 + (float)(i % 40); // down to where softplus is all but 0
    size[5] = 1000;
    memcpy(was, w.p.geom.depth, sizeof was);
    memcpy(scales, size, sizeof scales);
    sharpen(&map, &tone);
    for (int i = 0; i < N; i++) {
        const int y = i % PX / SIZE, k = i / PX * SMALL * SMALL + y / 2 * SMALL + i % SIZE / 2;
        const bool sure = y < SIZE / 2;
        const double factor = (double)(w.p.geom.depth[i] / was[i]);
        if (sure)
            assert_float_equal(w.p.geom.depth[i], (double)(depth[k] / 3), 1e-6);
        for (int c = 0; c < 3; c++) {
            const double pixel = (double)w.p.geom.depth[i] / 30 / (double)VOXEL_SCALE_UNIT;
            double now = softplus(size[c * N + i]);
            double then = fmin(softplus(scales[c * N + i]) * factor, pixel);
            assert_true(isfinite(size[c * N + i]) && fabs(now - then) <= 1e-5 * then);
        }
    }
    for (int v = 0; v < VIEWS; v++) {
        w.p.geom.cams[v].cx -= 0.5f; // depth_unproject takes a pixel's corner
        w.p.geom.cams[v].cy -= 0.5f;
        depth_unproject(&w.p.geom, v, want);
        for (int i = 0; i < 3 * PX; i++)
            assert_float_equal(w.p.points[v * 3 * PX + i], want[i], 1e-5);
    }
}

/* View 0 is sure of a wall at 4; what others guess before it moves there, or is left out where no
 * pixel of view 0 lands. */
static void guesses_give_way_to_what_a_view_is_sure_of(void **state)
{
    (void)state;
    static float depth[N], conf[N];
    struct depthmaps map = {VIEWS, 1, squares(VIEWS, SIZE), depth, conf, NULL};
    const struct tonemap tone = plain_tone();
    const struct camera *c = &w.own[0];
    int out = 0, moved = 0;
    for (int k = 0; k < N; k++) {
        depth[k] = 12;
        conf[k] = k < PX ? 1 : 0;
    }
    sharpen(&map, &tone);
    for (int i = 0; i < N; i++) { // the camera of view 0 is not turned
        const float *at = w.p.points + 3 * i;
        double z = (double)(at[2] + c->t[2]), u = 30 * (double)(at[0] + c->t[0]) / z + 14,
               v = 30 * (double)(at[1] + c->t[1]) / z + 14;
        if (fmin(fabs(u), fabs(u - SIZE)) < 1e-3 || fmin(fabs(v), fabs(v - SIZE)) < 1e-3)
            continue; // on the edge
        const bool seen = i >= PX && u > 0 && u < SIZE && v > 0 && v < SIZE;
        const bool there = fabs(z - 4) < 0.1;
        assert_int_equal(isnan(w.p.confidence[i]), seen && !there);
        out += seen && !there;
        moved += seen && there;
    }
    print_message("  %d of %d moved, %d left out\n", moved, 3 * PX, out);
    assert_true(moved > PX && out > 30);
    for (int k = 0; k < PX; k++)
        depth[k] = 3 * 1.0f; // before all of them
    memset(w.p.confidence, 0, N * sizeof(float));
    sharpen(&map, &tone);
    for (int i = 0; i < N; i++)
        assert_false(isnan(w.p.confidence[i]));
}

/* Depth of the plane z = 2 in the world of view 0, in units of the maps. */
static void plane(float depth[N])
{
    for (int i = 0; i < N; i++) {
        const struct camera *c = &w.own[i / PX];
        const float ray[3] = {((float)(i % SIZE) + 0.5f - c->cx) / c->fx,
                              ((float)(i % PX / SIZE) + 0.5f - c->cy) / c->fy, 1};
        float r[9], at = 2, along = 0;
        rotation_from_unit(c->q, r);
        for (int k = 0; k < 3; k++) {
            at += r[3 * k + 2] * c->t[k];
            along += r[3 * k + 2] * ray[k];
        }
        depth[i] = 3 * at / along;
    }
}

static bool inside_another(const float *point, int view, float margin)
{
    for (int j = 0; j < VIEWS; j++) {
        float r[9], x[3];
        const struct camera *c = &w.own[j];
        rotation_from_unit(c->q, r);
        for (int k = 0; k < 3; k++)
            x[k] =
                r[3 * k] * point[0] + r[3 * k + 1] * point[1] + r[3 * k + 2] * point[2] + c->t[k];
        const float u = 30 * x[0] / x[2] + 14, v = 30 * x[1] / x[2] + 14;
        if (j != view && fminf(fminf(u, v), SIZE - fmaxf(u, v)) > margin)
            return true;
    }
    return false;
}

/* View 1 is all but black, the others are grey. */
static void who_knows_a_surface_better_shows_it(void **state)
{
    (void)state;
    static float depth[N], conf[N], before[N];
    struct depthmaps map = {VIEWS, 1, squares(VIEWS, SIZE), depth, conf, NULL};
    const struct tonemap tone = plain_tone();
    int out = 0;
    plane(depth);
    memset(w.rgb + 3 * PX, 3, 3 * PX);
    memcpy(before, w.p.confidence, sizeof before);
    for (int k = 0; k < N; k++)
        conf[k] = 1;
    sharpen(&map, &tone);
    for (int i = 0; i < N; i++) {
        const float *at = w.p.points + 3 * i;
        const bool dark = i / PX == 1;
        if (!dark || !inside_another(at, 1, -0.01f))
            assert_float_equal(w.p.confidence[i], before[i], 0);
        else if (inside_another(at, 1, 0.01f))
            assert_true(isnan(w.p.confidence[i]));
        out += isnan(w.p.confidence[i]);
    }
    print_message("  %d of %d left out\n", out, PX);
    assert_true(out > PX / 2 && out < PX);

    for (int k = 0; k < N; k++) // the others stand before something else
        depth[k] *= k / PX == 1 ? 1 : 0.5f;
    memcpy(w.p.confidence, before, sizeof before);
    sharpen(&map, &tone);
    assert_memory_equal(w.p.confidence, before, sizeof before);

    for (int k = 0; k < PX; k++) // a guess is not needed where another knows anything
        conf[PX + k] = 0;
    sharpen(&map, &tone);
    for (int i = PX; i < 2 * PX; i++)
        if (inside_another(w.p.points + 3 * i, 1, 0.01f))
            assert_true(isnan(w.p.confidence[i]));
}

/* All guess the plane z = 2. What view 2 shows there changes, and what the others do. */
static void more_views_than_one_decide_what_a_guess_shows(void **state)
{
    (void)state;
    static float depth[N], conf[N];
    struct depthmaps map = {VIEWS, 1, squares(VIEWS, SIZE), depth, conf, NULL};
    const struct tonemap tone = plain_tone();
    const struct {
        float mine, others; // log2 radiance
        float longer;       // stops that view 2 exposed longer
        bool out;
    } cases[] = {{0, 0, 1, false}, {0.5f, 0, 1, false},        {-2, 0, 1, true}, {6, -12, 1, true},
                 {6, 9, 1, false}, {-11.5f, -11.5f, 17, false}}; // saturated; saturated and black
    for (size_t n = 0; n < sizeof cases / sizeof *cases; n++) {
        int seen = 0, out[VIEWS] = {0};
        plane(depth);
        for (int i = 0; i < VIEWS; i++)
            paint(i, i == 2 ? cases[n].mine : cases[n].others, i == 2 ? cases[n].longer : 0);
        for (int i = 0; i < N; i++)
            w.p.geom.depth[i] = depth[i] / 3;
        memset(w.p.confidence, 0, N * sizeof(float));
        sharpen(&map, &tone);
        for (int i = 0; i < N; i++) {
            out[i / PX] += isnan(w.p.confidence[i]);
            seen += i / PX == 2 && inside_another(w.p.points + 3 * i, 2, 0.01f);
        }
        print_message("  view 2 at %+.1f, others at %+.1f stops: %d %d %d %d left out\n",
                      (double)cases[n].mine, (double)cases[n].others, out[0], out[1], out[2],
                      out[3]);
        assert_true(cases[n].out ? out[2] >= seen : out[2] == 0);
        assert_true(seen > PX / 2 && out[0] < PX / 2);
    }
}

static float x_of(int i, int c, int view)
{
    return w.p.features[(VOXEL_SH + 25 * c) * N + i] * 0.2820948f / 0.6931472f + w.log2t[view] - 1;
}

/* Odd pixels are saturated in red and black in blue. */
static void colours_are_those_of_the_photographs(void **state)
{
    (void)state;
    static float depth[N], conf[N], was[VOXEL_FEATURES * N];
    struct depthmaps map = {VIEWS, 1, squares(VIEWS, SIZE), depth, conf, NULL};
    const struct tonemap tone = plain_tone();
    struct tonemap own;
    double worst = 0;
    tonemap_linear(&own, 0.5f, -12, 12, 1);
    w.p.tone = own;
    plane(depth);
    for (int i = 0; i < N; i++) {
        w.rgb[3 * i] = i % 2 ? 255 : (uint8_t)(20 + i % 200);
        w.rgb[3 * i + 2] = i % 2 ? 0 : 77;
    }
    for (int i = 3; i < N; i += 8) // brighter than the photograph can show
        w.p.features[VOXEL_SH * N + i] = 20;
    memcpy(was, w.p.features, sizeof was);
    sharpen(&map, &tone);
    assert_memory_equal(&w.p.tone, &tone, sizeof tone);
    for (int k = 0; k < 3 * N; k++) {
        const int i = k / 3, c = k % 3, view = i / PX;
        const float x = x_of(i, c, view), *sh = w.p.features + (VOXEL_SH + 25 * c) * N + i;
        const float shown = response_display(&tone, c, x);
        if (w.rgb[k] > 1 && w.rgb[k] < 253) {
            assert_float_equal(shown, (float)w.rgb[k] / 255, 2e-4);
            assert_float_equal(sh[N], 0, 0);
            continue;
        }
        const float before =
            was[(VOXEL_SH + 25 * c) * N + i] * 0.2820948f / 0.6931472f + w.log2t[view] - 1;
        const float meant = response_display(&own, c, before);
        worst = fmax(worst, fabs((double)(shown - meant)));
        assert_true(isfinite(x) && isfinite(sh[N]));
    }
    print_message("  black or saturated: display values within %.1e\n", worst);
    assert_true(worst < 1e-3);

    w.p.linear = true;
    w.p.tone = own;
    memcpy(w.p.features + VOXEL_SH * N, was + VOXEL_SH * N, 75 * N * sizeof(float));
    sharpen(&map, &tone);
    assert_memory_equal(w.p.features + VOXEL_SH * N, was + VOXEL_SH * N, 75 * N * sizeof(float));
    assert_memory_equal(&w.p.tone, &own, sizeof own);
}

static void cells_grow_until_they_fit(void **state)
{
    (void)state;
    const struct voxel_input in = {w.p.n, w.p.points, w.p.features, w.p.confidence};
    struct voxels v;
    float cell;
    size_t mark = arena_mark(&w.keep);
    assert_int_equal(voxel_merge_most(&w.r, &in, 0.001f, 0, &v, &cell), OK);
    assert_true(v.n > 3000);
    arena_reset(&w.keep, mark);
    assert_int_equal(voxel_merge_most(&w.r, &in, 0.001f, 500, &v, &cell), OK);
    assert_true(v.n <= 500 && v.n > 200);
    assert_true(cell > 0.001f);
    arena_reset(&w.keep, mark);
    for (int i = 0; i < N; i++) // far too large a world
        for (int k = 0; k < 3; k++)
            w.p.points[3 * i + k] *= 1e12f;
    assert_int_equal(voxel_merge_most(&w.r, &in, 0.001f, 50, &v, &cell), OK);
    assert_true(v.n <= 50 && v.n > 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(known_cameras_see_what_the_network_saw, setup, teardown),
        cmocka_unit_test_setup_teardown(sure_depth_moves_pixels_along_their_rays, setup, teardown),
        cmocka_unit_test_setup_teardown(guesses_give_way_to_what_a_view_is_sure_of, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(views_that_are_left_out_leave_no_gap, setup, teardown),
        cmocka_unit_test_setup_teardown(who_knows_a_surface_better_shows_it, setup, teardown),
        cmocka_unit_test_setup_teardown(more_views_than_one_decide_what_a_guess_shows, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(colours_are_those_of_the_photographs, setup, teardown),
        cmocka_unit_test_setup_teardown(cells_grow_until_they_fit, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
