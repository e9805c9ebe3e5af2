/* Refinement on the scene of refine_world.h. */
#include "core/refine/refine.h"

#include "core/base/rotation.h"
#include "core/refine/align.h"
#include "tests/unit/core/refine/refine_world.h"

#include <stdlib.h>

static struct refine_report refine(int steps, int degree_max, bool poses)
{
    struct refine_config cfg = {steps, degree_max, CAP, 5, poses, false, 2, 0, NULL, NULL};
    struct refine_report rep;
    assert_int_equal(refine_run(&W.r, &W.v, &cfg, &W.start, &rep), OK);
    assert_int_equal(arena_mark(&W.tmp), 0);
    return rep;
}

static void assert_scene_finite(void)
{
    for (int p = 0; p < gaussians_planes(W.start.g.degree); p++)
        for (int i = 0; i < W.start.g.n; i++)
            assert_true(isfinite(W.start.g.plane[p][i]));
    for (int i = 0; i < TONE_PARAMS; i++)
        assert_true(isfinite(W.start.tone.p[i]));
}

static void test_learns(void **state)
{
    (void)state;
    open_world(2, 0);
    struct refine_report rep = refine(240, 0, false);
    print_message("  held-out %.2f -> %.2f dB, %d Gaussians, %d steps\n",
                  (double)rep.held_out_db[0], (double)rep.held_out_db[1], rep.gaussians, rep.steps);
    assert_true(rep.held_out_db[1] > rep.held_out_db[0] + 4);
    assert_true(rep.held_out_db[1] > 32);
    assert_scene_finite();
    close_world();
}

/* From the truth there is nothing to gain: a scene before the last one is the result. */
static void test_keeps_best(void **state)
{
    (void)state;
    open_world(2, 0);
    gaussians_copy(&W.truth.g, 0, &W.start.g);
    struct refine_report rep = refine(240, 0, true), again = refine(0, 0, true);
    print_message("  held-out %.3f dB, step %d of %d kept: %s\n", (double)rep.held_out_db[1],
                  rep.step_kept, rep.steps, rep.notes[rep.n_notes - 1]);
    assert_in_range(rep.step_kept, 1, rep.steps - 1);
    assert_float_equal(again.held_out_db[0], rep.held_out_db[1], 1e-3);
    assert_int_equal(rep.gaussians, W.start.g.n);
    close_world();
}

/* Nor by more splats, where what is wrong is not in the splats: views that are turned by some
 * pixels. */
static void test_splits_stop(void **state)
{
    (void)state;
    open_world(2, 0);
    gaussians_copy(&W.truth.g, 0, &W.start.g);
    for (int i = 0; i < V; i++)
        pose_move(&W.cams[i], (const float[6]){i % 2 ? 0.03f : -0.03f, 0, 0, 0, 0, 0});
    const struct refine_report rep = refine(400, 0, false);
    assert_non_null(strstr(rep.notes[0], "more made held-out squares no better"));
    close_world();
}

/* Mean error of ln radiance in the inner half of view 3. */
static double radiance_error(void)
{
    static float got[3 * PX], want[3 * PX];
    double sum = 0;
    int n = 0;
    render(&W.start.g, &W.cams[3], got);
    render(&W.truth.g, &W.cams[3], want);
    for (int i = 0; i < 3 * PX; i++)
        if (abs(i % S - S / 2) < S / 4 && abs(i % PX / S - S / 2) < S / 4) {
            sum += fabs(log((double)got[i] / (double)want[i]));
            n++;
        }
    return sum / n;
}

/* Parts that one exposure cannot show are learned from the others, which share its camera. */
static void test_brackets(void **state)
{
    (void)state;
    double error[2];
    for (int all = 0; all < 2; all++) {
        open_world(2, 0);
        take_brackets(all ? V : 0);
        refine(150, 0, false);
        error[all] = radiance_error();
        assert_scene_finite();
        close_world();
    }
    print_message("  error of ln radiance: %.3f of one exposure, %.3f of five\n", error[0],
                  error[1]);
    assert_true(error[1] < 0.6 * error[0]); // 0.49 to 0.52 by compiler
}

/* Somebody stands in the way of two photographs. */
static void test_outliers(void **state)
{
    (void)state;
    double error[2];
    for (int k = 0; k < 2; k++) {
        open_world(2, 0);
        if (k) {
            stand_before(1);
            stand_before(3);
        }
        const struct refine_report rep = refine(240, 0, false);
        bool noted = false;
        for (int i = 0; i < rep.n_notes; i++)
            noted = noted || strstr(rep.notes[i], "in 2 photographs");
        assert_true(noted == (k > 0));
        error[k] = radiance_error();
        close_world();
    }
    print_message("  error of ln radiance: %.3f, %.3f where somebody stood\n", error[0], error[1]);
    assert_true(error[1] < 1.3 * error[0]);
}

static void test_parts(void **state)
{
    (void)state;
    struct refine_report rep[2];
    static float kept[CAP];
    for (int k = 0; k < 2; k++) {
        open_wide_world(1 + 2 * k);
        rep[k] = refine(60, 0, true);
        assert_true(rep[k].held_out_db[1] > rep[k].held_out_db[0] + 3);
        assert_scene_finite();
        if (k == 0)
            memcpy(kept, W.start.g.plane[G_MU], sizeof kept);
        else
            assert_memory_equal(kept, W.start.g.plane[G_MU], (size_t)W.start.g.n * sizeof *kept);
        close_world();
    }
    assert_true(rep[0].gaussians == rep[1].gaussians);
    print_message("  held-out %.2f -> %.2f dB\n", (double)rep[0].held_out_db[0],
                  (double)rep[0].held_out_db[1]);
}

static void keep_held_out(void *ctx, const char *stage, int done, int total, const char *note)
{
    (void)stage, (void)done, (void)total;
    *(double *)ctx = strtod(note + strlen("held-out "), NULL);
}

/* Steps see random parts, over random backgrounds; the figure of a round is that of whole views. */
static void test_rounds(void **state)
{
    (void)state;
    double last = 0;
    open_wide_world(2);
    W.r.progress = keep_held_out;
    W.r.progress_ctx = &last;
    const struct refine_report rep = refine(150, 0, false);
    print_message("  held-out %.2f dB in the last round, %.2f dB of whole views\n", last,
                  (double)rep.held_out_db[1]);
    assert_true(fabs(last - (double)rep.held_out_db[1]) < 0.2);
    close_world();
}

/* What one photograph shows alone is not split to fit it. */
static void test_guesses(void **state)
{
    (void)state;
    for (int n = 1; n <= V; n += V - 1) {
        open_world(2, 0);
        W.v.n = W.start.n_views = n;
        const struct refine_report rep = refine(240, 0, false);
        assert_true((rep.gaussians > SIDE * SIDE) == (n > 1));
        close_world();
    }
}

static void test_no_steps(void **state)
{
    (void)state;
    open_world(1, 0);
    struct refine_report rep = refine(0, 0, false);
    assert_int_equal(rep.steps, 0);
    assert_float_equal(rep.held_out_db[0], rep.held_out_db[1], 0);
    close_world();
}

/* Under full splats nothing else would learn; a scene that is not refined stays as it is. */
static void test_half_open(void **state)
{
    (void)state;
    for (int steps = 0; steps < 2; steps++) {
        open_world(1, 0);
        const struct gaussians *g = &W.start.g;
        float most = -INFINITY, wide = 0, was = 0;
        for (int i = 0; i < g->n; i++) {
            g->plane[G_LOGIT][i] = 4;
            was += g->plane[G_LOG_SCALE][i] / (float)g->n;
        }
        refine(steps, 0, false);
        for (int i = 0; i < g->n; i++) {
            most = fmaxf(most, g->plane[G_LOGIT][i]);
            wide += g->plane[G_LOG_SCALE][i] / (float)g->n;
        }
        assert_float_equal(most, steps ? 0 : 4, 0.2);
        assert_float_equal(wide - was, steps ? 0.18f : 0, 0.1);
        close_world();
    }
}

static void test_same_bytes(void **state)
{
    (void)state;
    static float once[G_PLANES_MAX][CAP];
    static struct tonemap tone;
    int n = 0;
    for (int threads = 1; threads <= 3; threads++) {
        open_world(threads, 0);
        take_brackets(2);
        refine(60, 1, true);
        if (threads == 1) {
            n = W.start.g.n;
            tone = W.start.tone;
            for (int p = 0; p < gaussians_planes(W.start.g.degree); p++)
                memcpy(once[p], W.start.g.plane[p], (size_t)n * 4);
        }
        assert_int_equal(n, W.start.g.n);
        assert_memory_equal(&tone, &W.start.tone, sizeof tone);
        for (int p = 0; p < gaussians_planes(W.start.g.degree); p++)
            assert_memory_equal(once[p], W.start.g.plane[p], (size_t)n * 4);
        close_world();
    }
}

/* Colours that change with the direction need a band; noise, which no band can foresee, must not
 * get one. */
static void test_bands(void **state)
{
    (void)state;
    for (int noise = 0; noise < 2; noise++) {
        open_world(2, !noise);
        for (int i = 0; noise && i < V * PX * 3; i++)
            W.rgb[i] = (uint8_t)uniform(0, 256);
        struct refine_report rep = refine(300, 2, false);
        print_message("  %s: degree %d, %s\n", noise ? "noise" : "glossy wall", rep.degree,
                      rep.notes[0]);
        assert_true(noise ? rep.degree == 0 : rep.degree >= 1);
        close_world();
    }
}

/* Mean distance in px between the splats' centres seen by two cameras. */
static double pose_error(const struct camera *a, const struct camera *b)
{
    const struct camera *cams[2] = {a, b};
    double sum = 0;
    for (int i = 0; i < W.truth.g.n; i++) {
        float uv[2][2];
        for (int c = 0; c < 2; c++) {
            float r[9], p[3];
            rotation_from_unit(cams[c]->q, r);
            for (int k = 0; k < 3; k++)
                p[k] = r[3 * k] * W.truth.g.plane[0][i] + r[3 * k + 1] * W.truth.g.plane[1][i] +
                       r[3 * k + 2] * W.truth.g.plane[2][i] + cams[c]->t[k];
            uv[c][0] = cams[c]->fx * p[0] / p[2];
            uv[c][1] = cams[c]->fy * p[1] / p[2];
        }
        sum += hypot((double)(uv[0][0] - uv[1][0]), (double)(uv[0][1] - uv[1][1])) / W.truth.g.n;
    }
    return sum;
}

/* hidden: something else stands before a part of each photograph. */
static void align_moved(bool hidden)
{
    open_world(2, 0);
    static uint8_t masked[V * PX];
    struct camera moved[V];
    double before = 0, after = 0;
    memcpy(moved, W.cams, sizeof moved);
    for (int i = 0; i < V; i++) {
        const float off[6] = {0.004f, -0.006f, 0.003f, 0.02f, -0.01f, 0.015f};
        pose_move(&moved[i], off);
        before += pose_error(&moved[i], &W.cams[i]) / V;
    }
    struct views v = W.v;
    v.cams = moved;
    for (int i = 0; i < V * PX && hidden; i++) {
        masked[i] = i % S < S / 3;
        if (masked[i])
            memset(W.rgb + 3 * i, i / S % 8 * 30, 3);
    }
    v.masked = hidden ? masked : NULL;
    W.truth.cams = W.cams;
    W.truth.n_views = V;
    assert_int_equal(align_run(&W.r, &W.truth, &v), OK);
    for (int i = 0; i < V; i++)
        after += pose_error(&moved[i], &W.cams[i]) / V;
    print_message("  reprojection error %.3f -> %.3f px\n", before, after);
    assert_true(after < before / 50);
    close_world();
}

static void test_align(void **state)
{
    (void)state;
    align_moved(false);
    align_moved(true);
}

/* A camera that looks away, and photographs without any light. */
static void test_align_nothing(void **state)
{
    (void)state;
    open_world(2, 0);
    struct camera moved[V];
    const float away[6] = {0, 3.14f, 0, 0, 0, 0};
    memcpy(moved, W.cams, sizeof moved);
    pose_move(&moved[1], away);
    const struct camera before = moved[1];
    memset(W.rgb, 0, sizeof W.rgb);
    struct views v = W.v;
    v.cams = moved;
    W.truth.n_views = V;
    assert_int_equal(align_run(&W.r, &W.truth, &v), OK);
    assert_memory_equal(&moved[1], &before, sizeof before);
    for (int i = 0; i < V; i++)
        assert_true(isfinite(moved[i].t[0] + moved[i].q[0]));
    close_world();
}

static void test_extremes(void **state)
{
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        open_world(1, 0);
        memset(W.rgb, kind == 0 ? 0 : kind == 1 ? 255 : 0, sizeof W.rgb);
        W.rgb[PX + 33] = 255;
        for (int i = 0; i < V; i++)
            W.log2t[i] = kind == 2 ? (i & 1 ? 20.0f : -20.0f) : 0.0f;
        for (int i = 0; kind == 3 && i < 40; i++) {
            W.start.g.plane[i % 14][i] = i & 1 ? NAN : INFINITY;
            W.start.g.plane[G_LOGIT][100 + i] = i & 1 ? 90.0f : -90.0f;
            W.start.g.plane[G_LOG_SCALE + i % 3][200 + i] = i & 1 ? -18.4f : 6.9f;
        }
        refine(60, 1, true);
        assert_true(W.start.g.n > 0);
        assert_scene_finite();
        for (int i = 0; i < V; i++)
            assert_true(isfinite(W.cams[i].t[0] + W.cams[i].q[0]));
        close_world();
    }
}

static atomic_bool cancel;

static void cancel_later(void *ctx, const char *stage, int done, int total, const char *note)
{
    (void)ctx, (void)stage, (void)done, (void)total, (void)note;
    atomic_store(&cancel, true);
}

static void test_cancel(void **state)
{
    (void)state;
    open_world(2, 0);
    atomic_store(&cancel, false);
    W.r.cancel = &cancel;
    W.r.progress = cancel_later;
    struct refine_config cfg = {500, 0, CAP, 5, false, false, 2, 0, NULL, NULL};
    struct refine_report rep;
    assert_int_equal(refine_run(&W.r, &W.v, &cfg, &W.start, &rep), ERR_CANCELLED);
    assert_true(rep.steps > 0 && rep.steps < 500);
    assert_int_equal(arena_mark(&W.tmp), 0);
    assert_scene_finite();
    close_world();
}

enum { TRIAL_READS = 6 };

static double now_s, round_s; // a clock that rises when it is read: by 1 s, later by round_s
static int reads;

static double read_clock(void)
{
    return now_s += reads++ < TRIAL_READS ? 1 : round_s;
}

/* By the trial each step takes 0.5 s, a round of 50 steps 25 s. */
static void test_time(void **state)
{
    (void)state;
    static const struct {
        double seconds, round;
        int least, most;
    } cases[] = {{0, 25, 200, 200},
                 {1e6, 25, 200, 200},
                 {60, 25, 100, 110},
                 {60, 50, 50, 60}, // later than expected
                 {3, 25, 0, 0}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        open_world(2, 0);
        W.r.clock = read_clock;
        round_s = cases[i].round;
        reads = 0;
        struct refine_config cfg = {200, 0, CAP, 5, false, false, 2, cases[i].seconds, NULL, NULL};
        struct refine_report rep;
        assert_int_equal(refine_run(&W.r, &W.v, &cfg, &W.start, &rep), OK);
        assert_in_range(rep.steps, cases[i].least, cases[i].most);
        bool noted = false;
        for (int k = 0; k < rep.n_notes; k++)
            noted = noted || strstr(rep.notes[k], "of 200 steps: no more fit");
        assert_true(noted == (rep.steps < 200));
        assert_int_equal(arena_mark(&W.tmp), 0);
        assert_scene_finite();
        close_world();
    }
}

static void test_plan(void **state)
{
    (void)state;
    open_world(2, 0);
    take_brackets(V);
    struct refine_config cfg = {120, 2, CAP, 5, false, false, 2, 0, NULL, NULL};
    struct refine_report rep;
    struct arena exact;
    assert_int_equal(arena_init(&exact, "exact", refine_plan(&W.v, &cfg, 2)), OK);
    W.r.tmp = &exact;
    assert_int_equal(refine_run(&W.r, &W.v, &cfg, &W.start, &rep), OK);
    assert_true(exact.peak > exact.size * 9 / 10);
    arena_free(&exact);
    assert_int_equal(arena_init(&exact, "small", refine_plan(&W.v, &cfg, 2) / 2), OK);
    W.r.tmp = &exact;
    assert_int_equal(refine_run(&W.r, &W.v, &cfg, &W.start, &rep), ERR_NOMEM);
    arena_free(&exact);
    close_world();
}

/* Rounds of 50 steps; splits between a third and 70 %, each a fifth more. */
static void test_begin(void **state)
{
    (void)state;
    static const struct {
        int steps, places, most, begin;
    } cases[] = {{0, 9, 40000, 40000},     {100, 9, 40000, 33333},  {300, 9, 40000, 27777},
                 {300, 200, 40000, 33333}, {1000, 9, 40000, 20000}, {300, 9, 1, 0}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct refine_config cfg = {
            .steps = cases[i].steps, .gaussians_max = cases[i].most, .levels = 2};
        assert_in_range(refine_begin(&cfg, cases[i].places), cases[i].begin, cases[i].begin + 1);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_learns),     cmocka_unit_test(test_brackets),
        cmocka_unit_test(test_outliers),   cmocka_unit_test(test_parts),
        cmocka_unit_test(test_rounds),     cmocka_unit_test(test_guesses),
        cmocka_unit_test(test_no_steps),   cmocka_unit_test(test_half_open),
        cmocka_unit_test(test_same_bytes), cmocka_unit_test(test_bands),
        cmocka_unit_test(test_align),      cmocka_unit_test(test_align_nothing),
        cmocka_unit_test(test_extremes),   cmocka_unit_test(test_cancel),
        cmocka_unit_test(test_plan),       cmocka_unit_test(test_begin),
        cmocka_unit_test(test_keeps_best), cmocka_unit_test(test_splits_stop),
        cmocka_unit_test(test_time)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
