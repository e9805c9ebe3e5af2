/* refine_world.h - a small scene that is known: a wall of coloured splats, photographed by the
 * renderer itself. */
#ifndef REFINE_REFINE_WORLD_H
#define REFINE_REFINE_WORLD_H

#include "core/base/cpu.h"
#include "core/base/gaussians.h"
#include "core/photo/tonemap.h"
#include "core/refine/refine.h"
#include "core/sfm/pose.h"
#include "core/splat/raster.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

enum { S = 96, V = 6, BRACKET = 5, SIDE = 24, CAP = 2 * SIDE * SIDE, PX = S * S };

struct world {
    struct arena keep, tmp;
    struct kernels k;
    struct run r;
    struct scene truth, start;
    struct views v;
    struct camera cams[V];
    float log2t[BRACKET * V];
    char names[V][NAME_CAP];
    uint8_t rgb[BRACKET * V * PX * 3];
    int place[(BRACKET - 1) * V];
};

static struct world W;
static uint32_t seed;

static inline float uniform(float lo, float hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (float)(seed >> 8) / 16777216.0f;
}

static inline void make_wall(struct gaussians *g, int degree)
{
    assert_int_equal(gaussians_init(g, &W.keep, CAP, 2), OK);
    g->degree = degree;
    for (int i = 0; i < SIDE * SIDE; i++) {
        g->plane[G_MU][i] = ((float)(i % SIDE) - SIDE / 2 + 0.5f) * 0.2f;
        g->plane[G_MU + 1][i] = ((float)(i / SIDE) - SIDE / 2 + 0.5f) * 0.2f;
        g->plane[G_MU + 2][i] = 3 + 0.3f * sinf((float)i * 0.05f);
        for (int k = 0; k < 3; k++) {
            g->plane[G_LOG_SCALE + k][i] = k < 2 ? -2.2f : -4.0f;
            g->plane[G_SH + k][i] = uniform(-4, 4);
            for (int b = 1; degree == 1 && b < 4; b++)
                g->plane[G_SH + 3 * b + k][i] = uniform(-3, 3);
        }
        g->plane[G_QUAT][i] = 1;
        g->plane[G_LOGIT][i] = 2.5f;
    }
    g->n = SIDE * SIDE;
}

static inline void render(const struct gaussians *g, const struct camera *cam,
                          float radiance[3 * PX])
{
    static float alpha[PX];
    struct raster rs;
    size_t mark = arena_mark(&W.tmp);
    struct raster_input in = {g, cam, {0, 0, 0}};
    struct render out = {0, 0, radiance, NULL, alpha};
    assert_int_equal(raster_init(&rs, &W.tmp, CAP, S, S, false), OK);
    assert_int_equal(raster_run(&W.r, &rs, &in, &out), OK);
    arena_reset(&W.tmp, mark);
}

static inline void photograph(int n)
{
    static float radiance[3 * PX], ldr[3 * PX];
    struct tonemap_table table;
    tonemap_table_init(&table, &W.truth.tone);
    for (int i = 0; i < n; i++) {
        render(&W.truth.g, &W.cams[i < V ? i : W.place[i - V]], radiance);
        for (int c = 0; c < 3; c++)
            tonemap_run(&table.c[c], radiance + c * PX, W.log2t[i], PX, ldr + c * PX);
        for (int p = 0; p < 3 * PX; p++)
            W.rgb[i * 3 * PX + p % PX * 3 + p / PX] = (uint8_t)(ldr[p] * 255 + 0.5f);
    }
}

/* The truth, its photographs, and a start with displaced splats and flat colours. */
static inline void open_world(int threads, int degree)
{
    memset(&W, 0, sizeof W);
    seed = 77;
    assert_int_equal(arena_init(&W.keep, "keep", (size_t)64 << 20), OK);
    assert_int_equal(arena_init(&W.tmp, "tmp", (size_t)96 << 20), OK);
    kernels_init(&W.k, cpu_detect());
    W.r = (struct run){.k = &W.k, .keep = &W.keep, .tmp = &W.tmp};
    assert_int_equal(pool_open(&W.r.pool, threads), OK);
    tonemap_linear(&W.truth.tone, 0.7f, -8, 8, 0);
    make_wall(&W.truth.g, degree);
    for (int i = 0; i < V; i++) {
        W.log2t[i] = (float)(i % 3 - 1) * 2;
        W.cams[i] = (struct camera){S, S, 90, 90, S / 2, S / 2, {1, 0, 0, 0}, {0}};
        const float away[6] = {
            0, 0.1f * (float)(i - 3), 0, 0.25f * (float)(i - 3), 0.1f * (float)(i % 2), 0};
        pose_move(&W.cams[i], away);
    }
    photograph(V);
    W.v = (struct views){.n = V,
                         .size = S,
                         .extent = squares(V, S),
                         .names = W.names,
                         .rgb = W.rgb,
                         .log2t = W.log2t,
                         .cams = W.cams};
    W.start = (struct scene){.tone = W.truth.tone,
                             .n_views = V,
                             .size = S,
                             .names = W.names,
                             .log2t = W.log2t,
                             .cams = W.cams};
    make_wall(&W.start.g, 0);
    for (int i = 0; i < W.start.g.n; i++) {
        for (int k = 0; k < 3; k++) {
            W.start.g.plane[G_MU + k][i] = W.truth.g.plane[G_MU + k][i] + uniform(-.03f, .03f);
            W.start.g.plane[G_SH + k][i] = W.truth.g.plane[G_SH + k][i] * 0.5f;
        }
    }
}

/* Photographs at 5 stops too much, and four shorter exposures of the first n places. */
static inline void take_brackets(int n)
{
    static const float more[BRACKET - 1] = {2, 0, -2, -5};
    for (int i = 0; i < V; i++)
        W.log2t[i] = 5;
    for (int i = 0; i < n * (BRACKET - 1); i++) {
        W.place[i] = i / (BRACKET - 1);
        W.log2t[V + i] = more[i % (BRACKET - 1)];
    }
    W.v.n_more = n * (BRACKET - 1);
    W.v.place = W.place;
    photograph(V + W.v.n_more);
}

/* Something that only photograph k shows: px [32, 64) of both axes. */
static inline void stand_before(int k)
{
    for (int i = 0; i < 32 * 32 * 3; i++) {
        const int x = 32 + i / 3 % 32, y = 32 + i / 96;
        W.rgb[3 * (k * PX + y * S + x) + i % 3] = (uint8_t)(i % 3 == k % 3 ? 230 : 40 + x % 8);
    }
}

static inline void close_world(void)
{
    pool_close(W.r.pool);
    arena_free(&W.keep);
    arena_free(&W.tmp);
}

/* Photographs so wide that steps see parts of them. */
static inline void open_wide_world(int threads)
{
    enum { WIDE = 1024, HIGH = 32 };
    static float radiance[3 * WIDE * HIGH], alpha[WIDE * HIGH], ldr[WIDE * HIGH];
    static struct extent extent[V];
    struct raster rs;
    struct tonemap_table table;
    open_world(threads, 0);
    tonemap_table_init(&table, &W.truth.tone);
    assert_int_equal(raster_init(&rs, &W.tmp, CAP, WIDE, HIGH, false), OK);
    for (int i = 0; i < V; i++) {
        struct camera *cam = &W.cams[i];
        extent[i] = (struct extent){WIDE, HIGH, (size_t)i * WIDE * HIGH};
        *cam = (struct camera){WIDE, HIGH, 600, 600, WIDE / 2, HIGH / 2, {1, 0, 0, 0}, {0}};
        cam->t[0] = 0.1f * (float)(i - 3);
        const struct raster_input in = {&W.truth.g, cam, {0, 0, 0}};
        struct render out = {0, 0, radiance, NULL, alpha};
        assert_int_equal(raster_run(&W.r, &rs, &in, &out), OK);
        for (int c = 0; c < 3; c++) {
            tonemap_run(&table.c[c], radiance + c * WIDE * HIGH, W.log2t[i], WIDE * HIGH, ldr);
            for (int p = 0; p < WIDE * HIGH; p++)
                W.rgb[3 * (i * WIDE * HIGH + p) + c] = (uint8_t)(ldr[p] * 255 + 0.5f);
        }
    }
    arena_reset(&W.tmp, 0);
    W.v.size = W.start.size = WIDE;
    W.v.extent = extent;
}

#endif
