/* A textured plane photographed from known places at mixed exposures: tracks lie where the plane
 * says. Pictures without texture, extreme exposures, priors right and wrong. */
#include "core/sfm/match.h"

#include "core/base/cpu.h"
#include "core/kernels/kernels.h"
#include "tests/unit/core/base/team_local.h"
#include "tests/unit/squares.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 224, VIEWS_MAX = 6, GRID = SIZE / 14 };

struct world {
    struct views v;
    float log2t[VIEWS_MAX];
    double h[VIEWS_MAX][9]; // plane, -1..1, to px
    struct arena keep, tmp;
    struct kernels k;
    struct pool *pool;
    struct run run;
};

/* ---- pictures ---- */

static double hash(int x, int y, int seed)
{
    uint32_t s =
        (uint32_t)x * 0x9E3779B1u ^ (uint32_t)y * 0x85EBCA77u ^ (uint32_t)seed * 0xC2B2AE3Du;
    s = (s ^ s >> 15) * 0x2C1B3C6Du;
    s = (s ^ s >> 12) * 0x297A2D39u;
    return (double)(s ^ s >> 15) / 4294967296.0;
}

/* Stops of a plane with noise in octaves and shingles of random shade; five stops of range. */
static double texture(double x, double y)
{
    double sum = 0, size = 1;
    for (int o = 0; o < 5; o++, size *= 0.5) {
        double u = x * 6 / size, v = y * 6 / size;
        int i = (int)floor(u), j = (int)floor(v);
        double a = u - i, b = v - j;
        a = a * a * (3 - 2 * a);
        b = b * b * (3 - 2 * b);
        sum += size * ((1 - b) * ((1 - a) * hash(i, j, o) + a * hash(i + 1, j, o)) +
                       b * ((1 - a) * hash(i, j + 1, o) + a * hash(i + 1, j + 1, o)) - 0.5);
    }
    int row = (int)floor(y * 9), column = (int)floor(x * 7 + 0.5 * (row & 1));
    return 1.6 * sum + 2.0 * hash(column, row, 9) - 1 + x;
}

static void apply(const double h[9], double x, double y, double out[2])
{
    double w = h[6] * x + h[7] * y + h[8];
    out[0] = (h[0] * x + h[1] * y + h[2]) / w;
    out[1] = (h[3] * x + h[4] * y + h[5]) / w;
}

static void invert(const double h[9], double out[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
            out[3 * i + j] = h[3 * a + c] * h[3 * b + d] - h[3 * a + d] * h[3 * b + c];
        }
}

/* Camera turned by `angle` about the vertical axis in front of the plane. */
static void place_camera(struct world *w, int i, double angle, double zoom)
{
    double f = 1.1 * SIZE, far = 2.4 / zoom, c = cos(angle), s = sin(angle);
    const double h[9] = {f * c + SIZE / 2.0 * s,
                         0,
                         SIZE / 2.0 * far + 0.03 * f * angle,
                         SIZE / 2.0 * s,
                         f,
                         SIZE / 2.0 * far + 0.02 * f * i,
                         s,
                         0,
                         far};
    memcpy(w->h[i], h, sizeof h);
}

static double gauss(uint32_t *state)
{
    double sum = -6;
    for (int i = 0; i < 12; i++) {
        *state = *state * 1664525u + 1013904223u;
        sum += (double)(*state >> 8) / (1 << 24);
    }
    return sum;
}

/* Shot noise of `electrons` at white and read noise, gamma, 8 bits. */
static void photograph(struct world *w, int i, double electrons)
{
    double back[9];
    uint32_t seed = 77u + (uint32_t)i;
    invert(w->h[i], back);
    for (int k = 0; k < SIZE * SIZE; k++) {
        double sum = 0;
        for (int n = 0; n < 4; n++) {
            double p[2];
            apply(back, k % SIZE + 0.25 + 0.5 * (n & 1), (double)(k / SIZE) + 0.25 + 0.25 * (n & 2),
                  p);
            sum += 0.25 * exp2(texture(p[0], p[1]));
        }
        for (int c = 0; c < 3; c++) {
            double x = 0.2 * sum * exp2((double)w->log2t[i]) * (0.8 + 0.2 * c);
            x += sqrt((fmax(x, 0) + 4 / electrons) / electrons) * gauss(&seed);
            double z = 255 * pow(fmin(fmax(x, 0), 1), 1 / 2.2);
            w->v.rgb[((size_t)i * SIZE * SIZE + (size_t)k) * 3 + (size_t)c] = (uint8_t)(z + 0.5);
        }
    }
}

static void open_world(struct world *w, int n, int threads)
{
    memset(w, 0, sizeof *w);
    w->v = (struct views){.n = n, .size = SIZE, .extent = squares(n, SIZE), .log2t = w->log2t};
    w->v.rgb = malloc((size_t)n * SIZE * SIZE * 3);
    assert_non_null(w->v.rgb);
    kernels_init(&w->k, cpu_detect());
    struct plan plan = plan_begin(threads);
    struct match_tracks most;
    match_plan(&plan, &w->v, 0, &most);
    assert_int_equal(arena_init(&w->keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&w->tmp, "tmp", plan.tmp.peak), OK);
    if (threads > 1)
        assert_int_equal(pool_open(&w->pool, threads), OK);
    w->run = (struct run){.k = &w->k, .pool = w->pool, .keep = &w->keep, .tmp = &w->tmp};
}

static void close_world(struct world *w)
{
    pool_close(w->pool);
    arena_free(&w->keep);
    arena_free(&w->tmp);
    free(w->v.rgb);
}

/* A fan of views, exposures `stops` apart around the middle. */
static void make_fan(struct world *w, double step, double stops, double electrons)
{
    for (int i = 0; i < w->v.n; i++) {
        static const int order[VIEWS_MAX] = {1, 0, 2, 1, 2, 0};
        w->log2t[i] = (float)(stops * (order[i] - 1));
        place_camera(w, i, step * (i - 0.5 * (w->v.n - 1)), 1 + 0.1 * (i % 3));
        photograph(w, i, electrons);
    }
}

/* ---- checks ---- */

static void check_form(const struct world *w, const struct match_tracks *t)
{
    int length = 0;
    assert_true(t->n <= MATCH_SEEN_MAX && t->n >= 2 * t->n_tracks);
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *s = t->obs + i;
        bool same = i > 0 && s[-1].track == s->track;
        assert_true(s->view >= 0 && s->view < w->v.n);
        assert_true(s->u > 0 && s->v > 0 && s->u < SIZE && s->v < SIZE);
        assert_true(s->sigma > 0 && s->sigma < 3);
        assert_int_equal(s->track, i == 0 ? 0 : s[-1].track + !same);
        assert_true(!same || s[-1].view < s->view);
        assert_true(same || i == 0 || length >= 2);
        length = same ? length + 1 : 1;
    }
    assert_true(t->n == 0 || t->obs[t->n - 1].track == t->n_tracks - 1);
}

static int ascending(const void *a, const void *b)
{
    double d = *(const double *)a - *(const double *)b;
    return d < 0 ? -1 : d > 0;
}

struct quality {
    double good, median, spread; // share within 1 px; px; median error over expected error
};

/* Each observation against where the other observations of its track, on average, lie on the plane.
 * */
static struct quality rate_tracks(const struct world *w, const struct match_tracks *t)
{
    double *error = malloc(sizeof *error * 2 * (size_t)t->n), *ratio = error + t->n, back[9];
    struct quality q = {0, 0, 0};
    assert_non_null(error);
    for (int i = 0, end; i < t->n; i = end) {
        for (end = i; end < t->n && t->obs[end].track == t->obs[i].track; end++)
            continue;
        for (int k = i; k < end; k++) {
            double x = 0, y = 0, p[2];
            for (int j = i; j < end; j++) {
                invert(w->h[t->obs[j].view], back);
                apply(back, (double)t->obs[j].u, (double)t->obs[j].v, p);
                x += j == k ? 0 : p[0] / (end - i - 1);
                y += j == k ? 0 : p[1] / (end - i - 1);
            }
            apply(w->h[t->obs[k].view], x, y, p);
            error[k] = hypot(p[0] - (double)t->obs[k].u, p[1] - (double)t->obs[k].v);
            ratio[k] = error[k] / (double)t->obs[k].sigma;
            q.good += (error[k] < 1) / (double)t->n;
        }
    }
    if (t->n) {
        qsort(error, (size_t)t->n, sizeof *error, ascending);
        qsort(ratio, (size_t)t->n, sizeof *ratio, ascending);
        q.median = error[t->n / 2];
        q.spread = ratio[t->n / 2];
    }
    print_message(
        "%d tracks, %d observations, %.3f within 1 px, median %.3f px, %.2f of expected\n",
        t->n_tracks, t->n, q.good, q.median, q.spread);
    free(error);
    return q;
}

static struct match_tracks find(struct world *w, const struct correspondence *prior)
{
    struct match_tracks t;
    w->keep.used = 0;
    assert_int_equal(match_run(&w->run, &w->v, prior, NULL, &t), OK);
    assert_int_equal(w->tmp.used, 0);
    check_form(w, &t);
    return t;
}

static void expect_tracks(struct world *w, int tracks, double good, double median)
{
    struct match_tracks t = find(w, NULL);
    struct quality q = rate_tracks(w, &t);
    assert_true(t.n_tracks >= tracks);
    assert_true(q.good >= good);
    assert_true(q.median <= median);
    assert_true(q.spread > 0.4 && q.spread < 3);
}

/* ---- tests ---- */

static void test_one_exposure(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 4, 2);
    make_fan(&w, 0.1, 0, 5000);
    expect_tracks(&w, 300, 0.98, 0.2);
    close_world(&w);
}

static void test_mixed_exposures(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 6, 2);
    make_fan(&w, 0.1, 2, 2000);
    expect_tracks(&w, 300, 0.95, 0.3);
    close_world(&w);
}

/* The darkest view shows a tenth of the grey values, the brightest is mostly white. */
static void test_far_exposures(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 3, 2);
    make_fan(&w, 0.08, 5, 20000);
    expect_tracks(&w, 20, 0.9, 0.4);
    close_world(&w);
}

static void test_wide_turns_and_noise(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 3, 2);
    make_fan(&w, 0.4, 0, 5000);
    expect_tracks(&w, 60, 0.9, 0.3);
    make_fan(&w, 0.1, 0, 150);
    expect_tracks(&w, 100, 0.9, 0.4);
    close_world(&w);
}

static void test_scale(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 2, 2);
    for (int i = 0; i < 2; i++) {
        place_camera(&w, i, 0.1 * i, 1 + 0.5 * i);
        photograph(&w, i, 5000);
    }
    expect_tracks(&w, 80, 0.9, 0.3);
    close_world(&w);
}

/* The picture turned about its middle, from x to y. */
static void roll_camera(struct world *w, int i, double roll)
{
    const double c = cos(roll), s = sin(roll), m = SIZE / 2.0;
    const double turn[9] = {c, -s, m - c * m + s * m, s, c, m - s * m - c * m, 0, 0, 1};
    double h[9] = {0};
    for (int k = 0; k < 27; k++)
        h[k / 3] += turn[k / 9 * 3 + k % 3] * w->h[i][k % 3 * 3 + k / 3 % 3];
    memcpy(w->h[i], h, sizeof h);
}

/* A plane from the front and from 52 to 60 degrees aside, where it is half as wide: alike, at other
 * exposures, rolled. */
static void test_far_apart(void **state)
{
    static const double angle[3] = {1.05, 0.95, 0.9};
    struct world w;
    (void)state;
    open_world(&w, 2, 2);
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 2; i++) {
            w.log2t[i] = (float)(k == 1 ? i : 0);
            place_camera(&w, i, angle[k] * i, 1 + 0.3 * i);
            roll_camera(&w, i, k == 2 ? 1.5 * i : 0);
            photograph(&w, i, 5000);
        }
        expect_tracks(&w, 60, 0.9, 0.4);
    }
    close_world(&w);
}

/* Tracks seen from views of both groups: 0 .. 2 and 3 .. 5. */
static int count_bridges(const struct match_tracks *t)
{
    int sum = 0;
    for (int i = 0, end; i < t->n; i = end) {
        int from[2] = {0, 0};
        for (end = i; end < t->n && t->obs[end].track == t->obs[i].track; end++)
            from[t->obs[end].view / 3]++;
        sum += from[0] && from[1];
    }
    return sum;
}

/* Each view has two alike beside it; of the other group it shares too little upright. */
static void test_groups_far_apart(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 6, 2);
    for (int i = 0; i < 6; i++) {
        place_camera(&w, i, i < 3 ? -0.05 * i : 1.1 + 0.05 * (i % 3), 1 + 0.3 * (i / 3));
        photograph(&w, i, 5000);
    }
    struct match_tracks t = find(&w, NULL);
    print_message("%d tracks from both sides\n", count_bridges(&t));
    assert_true(count_bridges(&t) >= 100);
    assert_true(rate_tracks(&w, &t).good >= 0.9);
    close_world(&w);
}

static void test_roll(void **state)
{
    /* in the last, the roll of the outer two follows from those of their pairs with the middle */
    static const double rolls[3][3] = {{0, 1.0, 1.9}, {1.5708, 0, 3.1416}, {0, 0.34, 0.68}};
    struct world w;
    (void)state;
    open_world(&w, 3, 2);
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 3; i++) {
            w.log2t[i] = (float)(i - 1);
            place_camera(&w, i, 0.1 * i, 1);
            roll_camera(&w, i, rolls[k][i]);
            photograph(&w, i, 5000);
        }
        expect_tracks(&w, k == 2 ? 270 : 100, 0.9, 0.3);
    }
    close_world(&w);
}

/* A shift by a whole pixel is found exactly on the finest level, within a part of a pixel of the
 * others, whose pixels it is not a multiple of. */
static void test_shift(void **state)
{
    for (size_t shift = 0; shift < 2; shift++) {
        struct world w;
        int exact = 0, close = 0;
        (void)state;
        open_world(&w, 2, 1);
        make_fan(&w, 0, 0, 1e9);
        for (size_t y = 0; y < SIZE; y++) {
            uint8_t *row = w.v.rgb + y * SIZE * 3;
            memmove(row + (size_t)SIZE * SIZE * 3, row + shift * 3, (SIZE - shift) * 3);
        }
        struct match_tracks t = find(&w, NULL);
        for (int i = 0; i < t.n; i += 2) {
            const struct match_observation *a = t.obs + i, *b = a + 1;
            float off = hypotf(a->u - b->u - (float)shift, a->v - b->v);
            exact += off < 0.002f;
            close += off < 0.15f;
        }
        assert_true(t.n_tracks > 250);
        assert_true(exact >= (shift ? t.n_tracks / 2 : t.n_tracks));
        assert_int_equal(close, t.n_tracks);
        close_world(&w);
    }
}

/* Black, white, grey, noise alone, different scenes, one view, views too small: nothing is found,
 * nothing breaks. */
static void test_nothing_to_see(void **state)
{
    struct world w;
    struct match_tracks t;
    uint32_t seed = 5;
    (void)state;
    open_world(&w, 3, 2);
    for (int kind = 0; kind < 5; kind++) {
        static const uint8_t level[4] = {0, 255, 128, 16};
        for (size_t i = 0; i < (size_t)3 * SIZE * SIZE * 3; i++) {
            double noise = kind == 3 ? 4 * gauss(&seed) : 0;
            w.v.rgb[i] = (uint8_t)(kind < 4 ? level[kind] + noise : i % 2 * 255.0);
        }
        t = find(&w, NULL);
        assert_true(t.n_tracks < 20);
    }
    for (int i = 0; i < 3; i++) { // three places of the plane that share nothing
        place_camera(&w, i, 0, 1);
        for (int k = 0; k < 2; k++)
            w.h[i][3 * k + 2] += 9000.0 * i;
        photograph(&w, i, 5000);
    }
    t = find(&w, NULL);
    assert_true(t.n_tracks < 20);
    w.v.n = 1;
    assert_int_equal(find(&w, NULL).n_tracks, 0);
    w.v.n = 3;
    for (w.v.size = 1; w.v.size < 90; w.v.size += 11) {
        w.keep.used = 0;
        w.v.extent = squares(3, w.v.size);
        assert_int_equal(match_run(&w.run, &w.v, NULL, NULL, &t), OK);
        assert_true(t.n_tracks < 20);
    }
    close_world(&w);
}

static void test_threads(void **state)
{
    struct match_observation *first = NULL;
    int n = 0;
    (void)state;
    for (int threads = 1; threads <= 7; threads += threads == 1 ? 1 : 5) {
        struct world w;
        open_world(&w, 4, threads);
        make_fan(&w, 0.1, 2, 2000);
        struct match_tracks t = find(&w, NULL);
        assert_true(t.n > 0);
        if (!first) {
            n = t.n;
            first = malloc((size_t)n * sizeof *first);
            assert_non_null(first);
            memcpy(first, t.obs, (size_t)n * sizeof *first);
        }
        assert_int_equal(t.n, n);
        assert_memory_equal(t.obs, first, (size_t)n * sizeof *first);
        close_world(&w);
    }
    free(first);
}

/* Some cameras are rolled: pairs are turned, and stretched. */
static void make_rolled_fan(struct world *w)
{
    make_fan(w, 0.1, 2, 2000);
    roll_camera(w, 1, 1.6);
    roll_camera(w, 3, 0.8);
    for (int i = 0; i < 4; i++)
        photograph(w, i, 2000);
}

static err_t find_on_rank(void *ctx, struct team *team)
{
    const struct match_tracks *alone = ctx;
    struct world w;
    open_world(&w, 4, 1);
    make_rolled_fan(&w);
    w.run.team = team;
    struct match_tracks t = find(&w, NULL);
    const bool same =
        t.n == alone->n && memcmp(t.obs, alone->obs, (size_t)t.n * sizeof *t.obs) == 0;
    close_world(&w);
    return same ? OK : err_fail(ERR_ARG, "rank %d has other tracks", team_rank(team));
}

static void test_ranks(void **state)
{
    const int uneven[8] = {8, 2, 8, 1, 8, 8, 8, 8}; // of 6 pairs some ranks have none
    struct world w;
    (void)state;
    open_world(&w, 4, 2);
    make_rolled_fan(&w);
    struct match_tracks t = find(&w, NULL);
    assert_true(t.n > 0);
    for (int size = 2; size <= 8; size += 3)
        if (team_local_run(size, uneven, find_on_rank, &t, NULL))
            fail_msg("%s", err_text());
    close_world(&w);
}

/* Every patch's true place in the other views, `off` columns aside, with that share. */
static struct correspondence make_prior(const struct world *w, int off, float share)
{
    int tokens = GRID * GRID, n = w->v.n;
    size_t all = (size_t)(n * tokens * n * CORRESPONDENCE_BEST);
    struct correspondence p = {.n_views = n, .grid = GRID};
    p.token = malloc(all * sizeof *p.token);
    p.share = malloc(all * sizeof *p.share);
    assert_true(p.token && p.share);
    for (size_t i = 0; i < all; i++) {
        int best = (int)i % CORRESPONDENCE_BEST, to = (int)i / CORRESPONDENCE_BEST % n;
        int t = (int)i / CORRESPONDENCE_BEST / n % tokens;
        int from = (int)i / CORRESPONDENCE_BEST / n / tokens;
        double back[9], at[2];
        invert(w->h[from], back);
        apply(back, 14 * (t % GRID + 0.5), 14 * (t / GRID + 0.5), at);
        apply(w->h[to], at[0], at[1], at);
        int x = (int)floor(at[0] / 14), y = (int)floor(at[1] / 14);
        bool in = x >= 0 && y >= 0 && x < GRID && y < GRID && best == 0 && to != from;
        p.token[i] = (int16_t)(in ? y * GRID + (x + off) % GRID : -1);
        p.share[i] = in ? share : 0;
    }
    return p;
}

static int count_with(struct world *w, int off, float share, double good)
{
    struct correspondence p = make_prior(w, off, share);
    struct match_tracks t = find(w, &p);
    assert_true(rate_tracks(w, &t).good >= good);
    free(p.token);
    free(p.share);
    return t.n;
}

/* A right prior keeps the matches, a wrong one that is not sure changes nothing, and one that is
 * sure and wrong costs some. */
static void test_prior(void **state)
{
    struct world w;
    (void)state;
    open_world(&w, 3, 2);
    make_fan(&w, 0.1, 1, 2000);
    int without = find(&w, NULL).n;
    int right = count_with(&w, 0, 0.6f, 0.95), vague = count_with(&w, GRID / 2, 0.05f, 0.95);
    int wrong = count_with(&w, GRID / 2, 0.6f, 0.9);
    assert_true(right >= without * 97 / 100);
    assert_int_equal(vague, without);
    assert_true(wrong < right && wrong > without / 3);
    close_world(&w);
}

static void test_too_little_memory(void **state)
{
    struct world w;
    struct match_tracks t;
    (void)state;
    open_world(&w, 2, 1);
    make_fan(&w, 0.1, 0, 5000);
    size_t full = w.tmp.size;
    for (w.tmp.size = 0; w.tmp.size < full; w.tmp.size += full / 11) {
        err_t e = match_run(&w.run, &w.v, NULL, NULL, &t);
        assert_true(e == OK || e == ERR_NOMEM);
        assert_true(e == OK || (!t.obs && t.n == 0 && w.keep.used == 0));
        assert_int_equal(w.tmp.used, 0);
        w.keep.used = 0;
    }
    w.tmp.size = full;
    w.keep.size = 64;
    assert_int_equal(match_run(&w.run, &w.v, NULL, NULL, &t), ERR_NOMEM);
    struct plan plan = plan_begin(1);
    match_plan(&plan, &w.v, 0, &t);
    w.keep.size = plan.keep.peak;
    atomic_bool cancel = true;
    w.run.cancel = &cancel;
    assert_int_equal(match_run(&w.run, &w.v, NULL, NULL, &t), ERR_CANCELLED);
    assert_int_equal(w.tmp.used, 0);
    close_world(&w);
}

/* Most corners that fit, 66 times the same view: observations stay below the bound and nothing
 * collides at the width of a word. */
static void test_many_views(void **state)
{
    struct views v = {.n = 66, .size = 70, .extent = squares(66, 70)};
    struct arena keep, tmp;
    struct kernels k;
    struct match_tracks t;
    size_t view = (size_t)v.size * (size_t)v.size * 3;
    int longest = 0, length = 0;
    (void)state;
    v.rgb = malloc((size_t)v.n * view);
    assert_non_null(v.rgb);
    for (size_t i = 0; i < (size_t)v.n * view; i++) {
        int x = (int)(i % view / 3) % v.size, y = (int)(i % view / 3) / v.size;
        v.rgb[i] = (uint8_t)(40 + 160 * hash(x / 5, y / 5, 3));
    }
    kernels_init(&k, cpu_detect());
    struct plan plan = plan_begin(1);
    match_plan(&plan, &v, 0, &t);
    assert_int_equal(arena_init(&keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    const struct run r = {.k = &k, .keep = &keep, .tmp = &tmp};
    assert_int_equal(match_run(&r, &v, NULL, NULL, &t), OK);
    for (int i = 0; i < t.n; i++) {
        bool same = i > 0 && t.obs[i].track == t.obs[i - 1].track;
        assert_true(!same || t.obs[i].view > t.obs[i - 1].view);
        length = same ? length + 1 : 1;
        longest = length > longest ? length : longest;
    }
    assert_int_equal(longest, 66);
    arena_free(&keep);
    arena_free(&tmp);
    free(v.rgb);
}

enum { STRIP = 70, EDGE = 96, STEP = 14, AROUND = STRIP * STEP };

static uint8_t strip_px[STRIP][EDGE][EDGE][3];

/* Windows that go once around a strip whose ends meet, each with an exposure of its own. */
static void draw_strip(void)
{
    for (int i = 0; i < STRIP; i++)
        for (int y = 0; y < EDGE; y++)
            for (int x = 0; x < EDGE; x++) {
                const int at = (x + i * STEP) % AROUND;
                const double light = 0.6 * hash(at / 5, y / 5, 3) + 0.4 * hash(at / 7, y / 7, 4);
                memset(strip_px[i][y][x], (int)(40 + (120 + i % 3 * 20) * light), 3);
            }
}

static void match_strip(struct team *team, int threads, struct arena *keep, struct match_tracks *t)
{
    struct views v = {.n = STRIP, .size = EDGE, .extent = squares(STRIP, EDGE)};
    struct arena tmp;
    struct kernels k;
    struct pool *pool = NULL;
    v.rgb = &strip_px[0][0][0][0];
    kernels_init(&k, cpu_detect());
    struct plan plan = plan_begin(threads);
    match_plan(&plan, &v, 0, t);
    assert_int_equal(arena_init(keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    if (threads > 1)
        assert_int_equal(pool_open(&pool, threads), OK);
    const struct run r = {.k = &k, .pool = pool, .keep = keep, .tmp = &tmp, .team = team};
    assert_int_equal(match_run(&r, &v, NULL, NULL, t), OK);
    assert_int_equal(tmp.used, 0);
    pool_close(pool);
    arena_free(&tmp);
}

static err_t match_on_rank(void *ctx, struct team *team)
{
    const struct match_tracks *alone = ctx;
    struct arena keep;
    struct match_tracks t;
    match_strip(team, 1, &keep, &t);
    const bool same =
        t.n == alone->n && memcmp(t.obs, alone->obs, (size_t)t.n * sizeof *t.obs) == 0;
    arena_free(&keep);
    return same ? OK : err_fail(ERR_ARG, "rank %d has other tracks", team_rank(team));
}

/* Too many views to compare all: those that follow each other have common points, and so do those
 * where the walk comes back. */
static void test_long_walk(void **state)
{
    struct arena keep[2];
    struct match_tracks t[2];
    int seen[STRIP] = {0}, wrong = 0, closing = 0;
    (void)state;
    draw_strip();
    for (int i = 0; i < 2; i++)
        match_strip(NULL, 1 + 2 * i, keep + i, t + i);
    assert_int_equal(t[0].n, t[1].n);
    assert_memory_equal(t[0].obs, t[1].obs, (size_t)t[0].n * sizeof *t[0].obs);
    if (team_local_run(3, NULL, match_on_rank, t, NULL))
        fail_msg("%s", err_text());
    for (int i = 0; i < t->n; i++) {
        const struct match_observation *s = t->obs + i, *before = s - 1;
        seen[s->view]++;
        if (i == 0 || before->track != s->track)
            continue;
        const float gap = s->u - before->u + (float)((s->view - before->view) * STEP);
        wrong += fabsf(remainderf(gap, AROUND)) > 1 || fabsf(s->v - before->v) > 1;
        closing += s->view >= STRIP - 3 && before->view <= 3;
    }
    for (int i = 0; i < STRIP; i++)
        assert_true(seen[i] >= 30);
    assert_true(100 * wrong < t->n);
    assert_true(closing >= 20);
    for (int i = 0; i < 2; i++)
        arena_free(keep + i);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_one_exposure),
        cmocka_unit_test(test_mixed_exposures),
        cmocka_unit_test(test_far_exposures),
        cmocka_unit_test(test_wide_turns_and_noise),
        cmocka_unit_test(test_scale),
        cmocka_unit_test(test_far_apart),
        cmocka_unit_test(test_groups_far_apart),
        cmocka_unit_test(test_roll),
        cmocka_unit_test(test_shift),
        cmocka_unit_test(test_nothing_to_see),
        cmocka_unit_test(test_threads),
        cmocka_unit_test(test_ranks),
        cmocka_unit_test(test_prior),
        cmocka_unit_test(test_too_little_memory),
        cmocka_unit_test(test_many_views),
        cmocka_unit_test(test_long_walk),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
