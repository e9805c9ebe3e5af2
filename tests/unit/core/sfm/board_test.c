/* Places of tags; poses of boards, cameras and lenses from corners with noise, against the truth
 * and finite differences; cameras that see nothing in common; too little to see. */
#include "core/sfm/board.h"

#include "core/base/lin.h"
#include "core/base/num.h"
#include "core/base/rotation.h"
#include "core/base/splitmix.h"
#include "core/sfm/adjust.h"
#include "core/sfm/boardcal.h"
#include "core/sfm/boardpose.h"

#include "tests/unit/expect.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CAMERAS = 4, MANY = 100, TAKES = 12, COLS = 6, ROWS = 4 };

struct rig {
    int n_cameras, n_takes, n_lenses;
    int lens_of[MANY];
    struct lens lens[1];
    double pose[MANY][BOARDFIT_POSE], board[TAKES][BOARDFIT_POSE];
    double noise, spread; // px
    int tags;             // of each board, at most
    bool frontal;         // boards are parallel to the first camera
    uint64_t state;
    struct boardfit_corner *corner; // (n) malloc'd
    int n;
};

static double draw(struct rig *g)
{
    g->state += SPLITMIX_STEP;
    return (double)(splitmix_mix(g->state) >> 11) * 0x1p-53;
}

static double draw_normal(struct rig *g)
{
    return sqrt(-2 * log(1 - draw(g))) * cos(2 * NUM_PI * draw(g));
}

/* Cameras that stand `turn` degrees apart on a ring of 1 unit and look outwards. */
static void set_ring(struct rig *g, int n, double turn)
{
    g->n_cameras = n;
    for (int i = 0; i < n; i++) {
        const double w[3] = {0.02 * (i % CAMERAS), -turn * i * NUM_PI / 180, 0.1 * (i % CAMERAS)},
                     at[3] = {0, 0, 1};
        rotation_exp(w, g->pose[i]);
        memcpy(g->pose[i] + 9, (double[]){-at[0], -at[1], -at[2]}, 3 * sizeof(double));
    }
}

static void set_lens(struct rig *g, enum lens_model model, double focal, double k1)
{
    g->n_lenses = 1;
    g->lens[0] = (struct lens){.model = model,
                               .fx = focal,
                               .fy = focal,
                               .cx = 643,
                               .cy = 477,
                               .term = {k1, model == LENS_RADIAL ? 0.02 : 0}};
    assert_int_equal(lens_init(&g->lens[0]), OK);
}

/* The board of a take before the cameras k and k + 1; these are spread over many. */
static void place_board(struct rig *g, int take)
{
    const int pairs = g->n_cameras - 1,
              a = pairs > g->n_takes ? take * pairs / (g->n_takes - 1)
                  : pairs > 0        ? take % pairs
                                     : 0,
              b = num_min(a + 1, g->n_cameras - 1);
    double w[3], turn[9], x[3] = {0}, mean[9], q[4];
    for (int k = 0; k < 3; k++)
        w[k] = g->frontal ? 0 : (k == 2 ? 0.3 : 0.5) * draw_normal(g);
    for (int k = 0; k < 9; k++)
        mean[k] = g->pose[a][k] + g->pose[b][k];
    rotation_to_quat(mean, q);
    rotation_from_quat(q, mean);
    rotation_exp(w, turn);
    double *to = g->board[take];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            to[3 * i + k] =
                mean[i] * turn[k] + mean[3 + i] * turn[3 + k] + mean[6 + i] * turn[6 + k];
    const double at[3] = {2 * draw(g) - 1, 2 * draw(g) - 1, 9 + 4 * draw(g)};
    lin_apply_t(mean, at, x);
    for (int k = 0; k < 3; k++)
        to[9 + k] = x[k] - to[3 * k] * 3.6 - to[3 * k + 1] * 2.4;
}

static void see_corner(struct rig *g, const struct boardfit *b, int camera, int take, int tag)
{
    for (int k = 0; k < 4; k++) {
        struct boardfit_corner *c = &g->corner[g->n];
        double e[2];
        const int id = board_id(tag % COLS, tag / COLS);
        *c = (struct boardfit_corner){.camera = camera, .take = take};
        board_corner(id, k, c->at);
        c->inward[0] = k == 1 || k == 2 ? -1 : 1; // boards are nearly upright
        c->inward[1] = k >= 2 ? -1 : 1;
        if (!boardfit_error(b, c, e) || e[0] < 0 || e[1] < 0 || e[0] > 1280 || e[1] > 960) {
            g->n -= k; // a tag is seen as a whole
            return;
        }
        for (int d = 0; d < 2; d++)
            c->px[d] = e[d] + g->noise * draw_normal(g) + g->spread * c->inward[d];
        g->n++;
    }
}

static void photograph(struct rig *g)
{
    struct boardfit_lens lens[1];
    for (int i = 0; i < g->n_lenses; i++)
        lens[i] = (struct boardfit_lens){.lens = g->lens[i]};
    const struct boardfit b = {.n_cameras = g->n_cameras,
                               .n_takes = g->n_takes,
                               .n_lenses = g->n_lenses,
                               .lens_of = g->lens_of,
                               .lens = lens,
                               .pose = g->pose,
                               .board = g->board};
    g->n = 0;
    for (int t = 0; t < g->n_takes; t++) {
        place_board(g, t);
        for (int c = 0; c < g->n_cameras; c++)
            for (int i = 0; i < num_min(COLS * ROWS, g->tags); i++)
                see_corner(g, &b, c, t, i);
    }
}

static err_t calibrate(struct rig *g, struct boardcal_result *out)
{
    const struct boardcal_lens lens = {.w = 1280, .h = 960};
    struct arena tmp;
    struct boardcal in = {g->n_cameras, g->n_takes, g->n_lenses, g->n,
                          g->lens_of,   &lens,      g->corner};
    assert_int_equal(arena_init(&tmp, "tmp", boardcal_plan(g->n_cameras, g->n_takes, g->n, 0, 0)),
                     OK);
    const struct run r = {.tmp = &tmp};
    const err_t e = boardcal_run(&r, &in, out);
    assert_int_equal(tmp.used, 0);
    arena_free(&tmp);
    return e;
}

/* Worst rotation, degrees, and centre, units, relative to the first camera. */
static void compare(const struct rig *g, const struct boardcal_result *o, double *turned,
                    double *shift)
{
    *turned = *shift = 0;
    for (int i = 1; i < g->n_cameras; i++) {
        double rel[9], diff[9], w[3], c[3], c0[3], truth[3], found[3], d = 0;
        lin_product_t(g->pose[i], g->pose[0], rel);
        lin_product_t(rel, o->pose[i], diff);
        rotation_log(diff, w);
        *turned = fmax(*turned, sqrt(lin_dot(w, w)) * 180 / NUM_PI);
        lin_apply_t(g->pose[i], g->pose[i] + 9, c);
        lin_apply_t(g->pose[0], g->pose[0] + 9, c0);
        for (int k = 0; k < 3; k++)
            c[k] = c0[k] - c[k];
        lin_apply(g->pose[0], c, truth);
        lin_apply_t(o->pose[i], o->pose[i] + 9, found);
        for (int k = 0; k < 3; k++)
            d += (truth[k] + found[k]) * (truth[k] + found[k]);
        *shift = fmax(*shift, sqrt(d));
    }
}

static struct rig *new_rig(int n, double turn, int takes)
{
    struct rig *g = calloc(1, sizeof *g);
    assert_non_null(g);
    g->corner = calloc((size_t)(n * takes * COLS * ROWS * 4), sizeof *g->corner);
    assert_non_null(g->corner);
    g->n_takes = takes;
    g->noise = 0.1;
    g->tags = COLS * ROWS;
    g->state = 7;
    set_ring(g, n, turn);
    set_lens(g, LENS_RADIAL, 900, -0.12);
    return g;
}

static void free_rig(struct rig *g)
{
    free(g->corner);
    free(g);
}

/* ---- */

static void places(void **state)
{
    struct board b;
    double at[2], size[2];
    (void)state;
    board_corner(0, 0, at);
    assert_true(at[0] == 0 && at[1] == 0);
    board_corner(25, 2, at);
    assert_true(at[0] == 2.25 && at[1] == 2.25);
    board_corner(2, 3, at);
    assert_true(at[0] == 2.5 && at[1] == 1);
    assert_true(board_has(575) && !board_has(576) && !board_has(-1));
    assert_true(board_fit(277, 178, 37, &b));
    assert_int_equal(b.cols, 6);
    assert_int_equal(b.rows, 4);
    board_size(&b, size);
    assert_true(size[0] == 7.25 && size[1] == 4.75);
    assert_true(board_fit(2.25, 2.25, 1, &b));
    assert_int_equal(b.cols, 2);
    assert_false(board_fit(2.24, 3, 1, &b));
    assert_true(board_fit(1e9, 1e9, 1, &b));
    assert_int_equal(b.cols, BOARD_STRIDE);
}

/* Errors of a corner with an unknown moved by `step`: 0..5 the camera's twist, 6..11 the board's,
 * then those of the lens. */
static void error_moved(struct boardfit *b, const struct boardfit_corner *c, int unknown,
                        double step, double e[2])
{
    double *pose = unknown < 6 ? b->pose[c->camera] : b->board[c->take], was[BOARDFIT_POSE],
           twist[6] = {0};
    struct lens *l = &b->lens[0].lens;
    const struct lens lens = *l;
    double *const to[BOARDFIT_LENS] = {NULL,        &l->term[0], &l->term[1], &l->term[2],
                                       &l->term[3], &l->cx,      &l->cy};
    memcpy(was, pose, sizeof was);
    if (unknown < 12) {
        twist[unknown % 6] = step;
        adjust_move_pose(pose, twist);
    } else if (unknown == 12) {
        l->fx = l->fy = lens.fx * exp(step);
    } else {
        *to[unknown - 12] += step;
    }
    assert_true(boardfit_error(b, c, e));
    memcpy(pose, was, sizeof was);
    *l = lens;
}

static double derivative(const struct boardfit_jacobian *j, int unknown, int d)
{
    return unknown < 6    ? j->camera[d][unknown]
           : unknown < 12 ? j->board[d][unknown - 6]
                          : j->lens[d][unknown - 12];
}

/* Derivatives against differences, for every model. */
static void gradients(void **state)
{
    static const enum lens_model models[] = {LENS_PINHOLE, LENS_RADIAL, LENS_OPENCV_FISHEYE};
    static const int terms[] = {0, 2, 4};
    (void)state;
    for (int m = 0; m < 3; m++) {
        struct rig *g = new_rig(2, 10, 1);
        set_lens(g, models[m], 700, models[m] == LENS_PINHOLE ? 0 : -0.1);
        photograph(g);
        struct boardfit_lens lens = {.lens = g->lens[0]};
        struct boardfit b = {2,        1,    1,    g->n,      g->lens_of, &lens, g->pose,
                             g->board, NULL, NULL, g->corner, 1,          {0}};
        for (int i = 0; i < g->n * (12 + BOARDFIT_LENS); i++) {
            const struct boardfit_corner *c = &g->corner[i / (12 + BOARDFIT_LENS)];
            const int unknown = i % (12 + BOARDFIT_LENS);
            struct boardfit_jacobian j;
            double more[2], less[2];
            if (unknown > 12 + terms[m] && unknown <= 12 + LENS_TERMS)
                continue;
            assert_true(boardfit_jacobian(&b, c, &j));
            error_moved(&b, c, unknown, 1e-6, more);
            error_moved(&b, c, unknown, -1e-6, less);
            for (int d = 0; d < 2; d++)
                assert_true(fabs((more[d] - less[d]) / 2e-6 - derivative(&j, unknown, d)) < 1e-3);
        }
        free_rig(g);
    }
}

/* A pose of the board from few corners, also where two poses look alike. */
static void poses(void **state)
{
    struct arena tmp;
    (void)state;
    assert_int_equal(arena_init(&tmp, "tmp", boardpose_plan(96)), OK);
    for (int seed = 0; seed < 20; seed++) {
        struct rig *g = new_rig(1, 0, 1);
        double pose[BOARDFIT_POSE], error;
        g->state = (uint64_t)seed;
        g->noise = 0.02;
        g->tags = seed % 2 ? 24 : 2;
        photograph(g);
        assert_int_equal(boardpose_find(&tmp, &g->lens[0], g->corner, g->n, pose, &error), OK);
        if (g->n < 8) {
            free_rig(g);
            continue;
        }
        assert_true(error < 0.01);
        double truth[9], diff[9], w[3];
        lin_product(g->pose[0], g->board[0], truth);
        lin_product_t(truth, pose, diff);
        rotation_log(diff, w);
        assert_true(sqrt(lin_dot(w, w)) < (g->tags == 2 ? 0.05 : 0.004));
        free_rig(g);
    }
    arena_free(&tmp);
}

static void overlapping(void **state)
{
    static struct boardcal_result o;
    double turned, shift, sd[2];
    (void)state;
    struct rig *g = new_rig(4, 8, 6);
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    assert_true(boardcal_tied(&(struct boardcal){.n_cameras = 4}, &o));
    compare(g, &o, &turned, &shift);
    print_message("overlapping: %.4f degrees, %.4f units, focal %.2f, k1 %.4f, rms %.3f px\n",
                  turned, shift, o.lens[0].fx, o.lens[0].term[0], o.rms_px);
    assert_true(turned < 0.05 && shift < 0.02);
    assert_true(fabs(o.lens[0].fx / 900 - 1) < 2e-3 && fabs(o.lens[0].term[0] + 0.12) < 0.01);
    assert_true(o.rms_px < 0.2);
    covariance_deviations(o.covariance[3], sd);
    assert_true(sd[0] > 0 && turned * NUM_PI / 180 < 5 * sd[0] + 1e-4);
    free_rig(g);
}

/* Points that all cameras see, before the one in the middle. own: of *p, free. */
static void see_points(struct rig *g, int n, double depth, struct boardfit_points *p)
{
    struct boardfit_lens lens = {.lens = g->lens[0]};
    struct boardfit b = {.lens_of = g->lens_of, .lens = &lens, .pose = g->pose};
    const size_t sights = (size_t)(n * g->n_cameras);
    struct boardfit_sight *s = calloc(sights, sizeof *s);
    const double *middle = g->pose[(g->n_cameras - 1) / 2];
    int *first = calloc((size_t)n + 1, sizeof *first);
    *p = (struct boardfit_points){n, first, s, calloc((size_t)n, sizeof *p->at), 0};
    assert_true(s && first && p->at);
    for (int i = 0; i < n; i++) {
        const double z = depth * (1 + draw(g)),
                     cam[3] = {z * (draw(g) - 0.5) - middle[9], z * (draw(g) - 0.5) - middle[10],
                               z - middle[11]};
        double x[3];
        lin_apply_t(middle, cam, x);
        for (int c = 0; c < g->n_cameras; c++, s++) {
            *s = (struct boardfit_sight){.camera = c, .sigma = 0.1};
            assert_true(boardfit_sight_error(&b, s, x, s->px));
            for (int d = 0; d < 2; d++)
                s->px[d] += 0.1 * draw_normal(g) + (i % 20 == 0 && c == 1 ? 3 : 0);
        }
        for (int k = 0; k < 3; k++) // in the world of the first camera, and not exact
            p->at[i][k] =
                lin_dot(g->pose[0] + 3 * k, x) + g->pose[0][9 + k] + 0.02 * draw_normal(g);
        first[i + 1] = (i + 1) * g->n_cameras;
    }
}

static void free_points(struct boardfit_points *p)
{
    free((void *)p->first);
    free((void *)p->sight);
    free(p->at);
}

/* From the boards' places on, beside corners with much noise. */
static void with_points(void **state)
{
    static const struct {
        int cameras, takes, points;
        double turn, depth;
    } rigs[] = {{CAMERAS, 3, 300, 8, 6}, {MANY, TAKES, 60, 0.3, 9}};
    static struct boardcal_result o;
    const struct boardcal_lens lens = {.w = 1280, .h = 960};
    (void)state;
    for (int i = 0; i < 2; i++) {
        const int n = rigs[i].cameras, takes = rigs[i].takes, points = rigs[i].points;
        struct boardfit_points p;
        struct arena tmp;
        double before[2], after[2], sd[2];
        struct rig *g = new_rig(n, rigs[i].turn, takes);
        g->noise = 0.6;
        g->tags = n == MANY ? 8 : g->tags;
        photograph(g);
        struct boardcal in = {n, takes, 1, g->n, g->lens_of, &lens, g->corner};
        assert_int_equal(arena_init(&tmp, "tmp", boardcal_plan(n, takes, g->n, points, points * n)),
                         OK);
        const struct run r = {.tmp = &tmp};
        assert_int_equal(boardcal_run(&r, &in, &o), OK);
        assert_true(boardcal_tied(&in, &o));
        compare(g, &o, &before[0], &before[1]);
        see_points(g, points, rigs[i].depth, &p);
        assert_int_equal(boardcal_refine(&r, &in, &p, &o), OK);
        assert_int_equal(tmp.used, 0);
        compare(g, &o, &after[0], &after[1]);
        print_message("%d cameras with points: %.4f degrees, %.4f units; without %.4f, %.4f\n", n,
                      after[0], after[1], before[0], before[1]);
        assert_true(after[0] < 0.02 && after[1] < 0.004 && after[0] < before[0] / 2);
        covariance_deviations(o.covariance[n - 1], sd);
        assert_true(sd[0] > 0 && sd[0] < 0.001);
        arena_free(&tmp);
        free_points(&p);
        free_rig(g);
    }
}

/* Neighbours see parts of a board between them. */
static void outward(void **state)
{
    static struct boardcal_result o;
    double turned, shift;
    (void)state;
    struct rig *g = new_rig(4, 40, 8);
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    assert_true(boardcal_tied(&(struct boardcal){.n_cameras = 4}, &o));
    compare(g, &o, &turned, &shift);
    print_message("outward: %.4f degrees, %.4f units, focal %.2f, rms %.3f px\n", turned, shift,
                  o.lens[0].fx, o.rms_px);
    assert_true(turned < 0.15 && shift < 0.06);
    free_rig(g);
}

static void fisheyes(void **state)
{
    static struct boardcal_result o;
    double turned, shift;
    (void)state;
    struct rig *g = new_rig(3, 20, 8);
    set_lens(g, LENS_OPENCV_FISHEYE, 480, 0.02);
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    compare(g, &o, &turned, &shift);
    print_message("fisheye: %s, %.4f degrees, %.4f units, focal %.2f\n", lens_name(o.lens[0].model),
                  turned, shift, o.lens[0].fx);
    assert_int_equal(o.lens[0].model, LENS_OPENCV_FISHEYE);
    assert_true(turned < 0.1 && shift < 0.04 && fabs(o.lens[0].fx / 480 - 1) < 5e-3);
    free_rig(g);
}

/* White that spreads over black, by another amount in each photograph, changes no length. */
static void spread(void **state)
{
    static struct boardcal_result o;
    double turned, shift;
    (void)state;
    struct rig *g = new_rig(4, 8, 6);
    g->spread = 0.3;
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    compare(g, &o, &turned, &shift);
    print_message("spread: %.4f degrees, %.4f units, rms %.3f px\n", turned, shift, o.rms_px);
    assert_true(turned < 0.05 && shift < 0.02 && o.rms_px < 0.25);
    free_rig(g);
}

/* Wrong corners are left out. */
static void outliers(void **state)
{
    static struct boardcal_result o;
    double turned, shift;
    (void)state;
    struct rig *g = new_rig(4, 8, 6);
    photograph(g);
    for (int i = 0; i < g->n; i += 20) {
        g->corner[i].px[0] += 30 * draw_normal(g);
        g->corner[i].px[1] += 30 * draw_normal(g);
    }
    const int n = g->n;
    assert_int_equal(calibrate(g, &o), OK);
    compare(g, &o, &turned, &shift);
    assert_true(turned < 0.05 && shift < 0.02);
    assert_in_range(o.used, n * 9 / 10, n - n / 30);
    free_rig(g);
}

static void degenerate(void **state)
{
    static struct boardcal_result o;
    double sd[2];
    (void)state;
    struct rig *g = new_rig(2, 8, 4);
    g->n = 0;
    assert_int_equal(calibrate(g, &o), ERR_ARG);
    g->tags = 1;
    photograph(g);
    assert_int_equal(calibrate(g, &o), ERR_ARG); // one tag is too few
    free_rig(g);

    g = new_rig(1, 0, 6); // one camera
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    covariance_deviations(o.covariance[0], sd);
    assert_true(fabs(o.lens[0].fx / 900 - 1) < 5e-3 && sd[0] < 1e-9); // only one: the world is it
    free_rig(g);

    g = new_rig(2, 8, 4); // only frontal boards: the focal length is not determined
    g->frontal = true;
    set_ring(g, 1, 0);
    photograph(g);
    assert_int_equal(calibrate(g, &o), OK);
    assert_true(o.lens_sd[0][0] > 0.01);
    free_rig(g);

    g = new_rig(2, 150, 8); // nothing ties them
    photograph(g);
    if (calibrate(g, &o) == OK)
        assert_false(boardcal_tied(&(struct boardcal){.n_cameras = 2}, &o));
    free_rig(g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(places),      cmocka_unit_test(gradients),   cmocka_unit_test(poses),
        cmocka_unit_test(overlapping), cmocka_unit_test(with_points), cmocka_unit_test(outward),
        cmocka_unit_test(fisheyes),    cmocka_unit_test(spread),      cmocka_unit_test(outliers),
        cmocka_unit_test(degenerate),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
