/* Rough lenses from matches, many of them wrong, against those that the matches were made with. */
#include "core/sfm/division.h"

#include "tests/unit/core/sfm/bundle_scene.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

enum { VIEWS = 6, PAIRS = VIEWS * (VIEWS - 1) / 2, POINTS = 600 };

/* Matches of all pairs of a rig. */
struct set {
    struct scene_rig rig;
    struct epipolar_match match[PAIRS][DIVISION_MATCHES];
    struct division_pair pair[PAIRS];
    int lens_of[VIEWS];
    double frame[SCENE_LENSES], focal[SCENE_LENSES];
    struct division_views views;
    struct arena tmp;
};

static struct lens lens_make(enum lens_model m, double focal, double k1, double k2)
{
    struct lens l = {m, focal, focal, 0, 0, {k1, k2}, 0};
    assert_int_equal(lens_init(&l), OK);
    return l;
}

static void add_matches(struct set *s, const struct match_tracks *t, struct division_pair *p)
{
    struct epipolar_match *to = s->match[p - s->pair];
    for (int i = 0; i < t->n; i++)
        for (int j = i + 1; j < t->n && t->obs[j].track == t->obs[i].track; j++) {
            const struct match_observation *a = &t->obs[i], *b = &t->obs[j];
            if (a->view != p->a || b->view != p->b || p->n == DIVISION_MATCHES)
                continue;
            to[p->n++] =
                (struct epipolar_match){{a->u - SCENE_SIZE / 2.0f, a->v - SCENE_SIZE / 2.0f},
                                        {b->u - SCENE_SIZE / 2.0f, b->v - SCENE_SIZE / 2.0f}};
        }
    p->match = to;
}

/* Six views through the lenses of the rig; a third of the tracks is wrong somewhere. */
static void set_make(struct set *s, uint32_t seed)
{
    struct scene_tracks tracks;
    s->rig.n_points = POINTS;
    s->rig.noise = 0.4;
    s->rig.wrong = s->rig.wrong > 0 ? s->rig.wrong : 0.33;
    s->rig.reach = 60;
    s->rig.seed = seed;
    scene_arc(&s->rig, VIEWS, 50);
    scene_make(&s->rig, &tracks);
    int n = 0;
    for (int b = 0; b < VIEWS; b++) {
        s->lens_of[b] = b % s->rig.n_lenses;
        for (int a = 0; a < b; a++, n++) {
            s->pair[n] = (struct division_pair){.a = a, .b = b};
            add_matches(s, &tracks.t, &s->pair[n]);
        }
    }
    for (int i = 0; i < s->rig.n_lenses; i++) {
        s->frame[i] = hypot(SCENE_SIZE / 2, SCENE_SIZE / 2);
        s->focal[i] = 388;
    }
    s->views = (struct division_views){.n_lenses = s->rig.n_lenses,
                                       .n_pairs = PAIRS,
                                       .lens_of = s->lens_of,
                                       .frame = s->frame,
                                       .focal = s->focal,
                                       .search = {SCENE_SIZE, 1.5f, EPIPOLAR_DRAWS},
                                       .pair = s->pair};
    assert_int_equal(arena_init(&s->tmp, "tmp", division_plan(s->rig.n_lenses, PAIRS)), OK);
    scene_free(&tracks);
}

static void set_free(struct set *s)
{
    arena_free(&s->tmp);
    free(s);
}

static void find_lenses(struct set *s, int threads, struct division_lens *out)
{
    struct pool *pool = NULL;
    assert_int_equal(pool_open(&pool, threads), OK);
    const struct run r = {.tmp = &s->tmp, .pool = pool};
    assert_int_equal(division_run(&r, &s->views, out), OK);
    assert_int_equal(s->tmp.used, 0);
    pool_close(pool);
}

/* Largest error, in percent, of a bend in the distance of rays from the axis, up to r px. */
static double bend_error(const struct lens *truth, double bend, double r)
{
    double most = 0;
    for (int i = 1; i <= 20; i++) {
        const double px[2] = {r * i / 20, 0};
        double ray[3];
        assert_true(lens_unproject(truth, px, ray));
        const double found = px[0] / (1 + bend * px[0] * px[0]) / truth->fx;
        most = fmax(most, 100 * fabs(found * ray[2] / ray[0] - 1));
    }
    return most;
}

/* Barrel, cushion and a fisheye in one rig. */
static void three_lenses_are_told_apart(void **unused)
{
    (void)unused;
    for (uint32_t seed = 1; seed <= 2; seed++) {
        struct set *s = calloc(1, sizeof *s);
        struct division_lens out[SCENE_LENSES], again[SCENE_LENSES];
        s->rig.n_lenses = 3;
        s->rig.lens[0] = lens_make(LENS_RADIAL, 292, -0.35, 0.1);
        s->rig.lens[1] = lens_make(LENS_SIMPLE_RADIAL, 440, 0.1, 0);
        s->rig.lens[2] = lens_make(LENS_OPENCV_FISHEYE, 180, -0.02, 0);
        set_make(s, seed);
        find_lenses(s, 1, out);
        if (seed == 1) {
            find_lenses(s, 3, again);
            assert_memory_equal(out, again, 3 * sizeof *out);
        }
        assert_true(out[0].bend < 0 && out[1].bend > 0 && out[2].bend < out[0].bend);
        for (int i = 0; i < 3; i++) {
            struct lens found;
            const struct lens *truth = &s->rig.lens[i];
            assert_int_equal(division_fit(&out[i], s->frame[i], &found), OK);
            const double error = bend_error(truth, out[i].bend, 190);
            const double ratio = out[i].focal / out[0].focal / (truth->fx / s->rig.lens[0].fx);
            print_message("seed %u lens %d: %.1f %% off, focal %.1f, true %.1f\n", seed, i, error,
                          out[i].focal, truth->fx);
            assert_int_equal(found.model, i == 2 ? LENS_OPENCV_FISHEYE : LENS_RADIAL);
            assert_true(error < 15);
            assert_true(fabs(log(ratio)) < 0.1); // all look at one point: more is not known
            assert_true(fabs(log(out[i].focal / s->focal[i])) < 1);
        }
        set_free(s);
    }
}

/* Pinholes, of one and of two focal lengths, stay what they are expected to be; also where so many
 * matches are wrong that each new draw of samples finds a little more. */
static void straight_lenses_stay_straight(void **unused)
{
    (void)unused;
    for (uint32_t seed = 11; seed < 15; seed++) {
        struct set *s = calloc(1, sizeof *s);
        struct division_lens out[SCENE_LENSES];
        s->rig.n_lenses = 1 + (int)(seed % 2);
        s->rig.wrong = seed > 12 ? 0.8 : 0.33;
        s->rig.lens[0] = lens_make(LENS_PINHOLE, 381, 0, 0);
        s->rig.lens[1] = lens_make(LENS_PINHOLE, 500, 0, 0);
        set_make(s, seed);
        find_lenses(s, 2, out);
        for (int i = 0; i < s->rig.n_lenses; i++)
            assert_true(out[i].bend == 0 && out[i].focal == s->focal[i]);
        set_free(s);
    }
}

static void too_little_to_tell(void **unused)
{
    (void)unused;
    struct set *s = calloc(1, sizeof *s);
    struct division_lens out[SCENE_LENSES];
    s->rig.n_lenses = 1;
    s->rig.lens[0] = lens_make(LENS_SIMPLE_RADIAL, 300, -0.2, 0);
    set_make(s, 5);
    const struct division_views all = s->views;
    for (int i = 0; i < PAIRS; i++)
        s->pair[i].n = 10;
    find_lenses(s, 2, out);
    assert_true(out[0].bend == 0 && out[0].focal == 388);
    s->views.n_pairs = 0;
    find_lenses(s, 1, out);
    assert_true(out[0].bend == 0 && out[0].focal == 388);

    s->views = all;
    for (int i = 0; i < PAIRS; i++) { // all in one place
        s->pair[i].n = 100;
        for (int k = 0; k < 100; k++)
            s->match[i][k] = (struct epipolar_match){{0, 0}, {0, 0}};
    }
    find_lenses(s, 2, out);
    assert_true(out[0].bend == 0 && out[0].focal == 388);
    atomic_bool stop = true;
    const struct run cancelled = {.tmp = &s->tmp, .cancel = &stop};
    assert_int_equal(division_run(&cancelled, &s->views, out), ERR_CANCELLED);
    assert_true(out[0].bend == 0 && s->tmp.used == 0);
    struct arena small;
    assert_int_equal(arena_init(&small, "small", 64), OK);
    const struct run cramped = {.tmp = &small};
    assert_int_equal(division_run(&cramped, &s->views, out), ERR_NOMEM);
    arena_free(&small);
    set_free(s);
}

/* The models agree with the division model over the frame, as far as there are rays. */
static void fits_are_near(void **unused)
{
    (void)unused;
    const double frame = 300;
    for (int i = -12; i <= 4; i++) {
        const struct division_lens d = {i * 0.05 / (frame * frame), 320};
        struct lens l;
        assert_int_equal(division_fit(&d, frame, &l), OK);
        assert_true((l.model == LENS_PINHOLE) == (i == 0));
        assert_true(l.fx == 320);
        for (double r = 10; r < frame; r += 10) {
            const double ray[3] = {r, 0, 320 * (1 + d.bend * r * r)};
            double px[2];
            if (atan2(r, ray[2]) > (l.model == LENS_OPENCV_FISHEYE ? 1.4 : 1.0))
                break;
            assert_true(lens_project(&l, ray, px));
            assert_true(fabs(px[0] - r) < (i < -8 ? 17 : 8));
        }
    }
    struct lens l;
    assert_int_equal(division_fit(&(struct division_lens){-1e-5, 0}, frame, &l), ERR_ARG);
}

/* Sampson's distance is that to the nearest points that fit: the error over its gradient. */
static void distance_is_to_the_curve(void **unused)
{
    (void)unused;
    const double f[9] = {1e-6, 2e-5, -3e-3, -4e-5, 3e-6, 6e-3, 2e-3, -7e-3, 0.4};
    const struct epipolar_bend bend = {-4e-6, 2e-6};
    const float step = 0.25f;
    for (int i = 0; i < 20; i++) {
        const struct epipolar_match m = {{-150.0f + (float)(17 * i), 90.0f - (float)(8 * i)},
                                         {140.0f - (float)(13 * i), -120.0f + (float)(11 * i)}};
        double value[9];
        for (int k = 0; k < 9; k++) {
            float x[4] = {m.a[0], m.a[1], m.b[0], m.b[1]};
            if (k < 8)
                x[k / 2] += k % 2 ? step : -step;
            const double a[3] = {(double)x[0], (double)x[1],
                                 1 + bend.a * (double)(x[0] * x[0] + x[1] * x[1])};
            const double b[3] = {(double)x[2], (double)x[3],
                                 1 + bend.b * (double)(x[2] * x[2] + x[3] * x[3])};
            double l[3];
            lin_apply(f, a, l);
            value[k] = lin_dot(b, l);
        }
        double square = 0;
        for (int k = 0; k < 4; k++)
            square += pow((value[2 * k + 1] - value[2 * k]) / (2 * (double)step), 2);
        const double expected = value[8] * value[8] / square;
        assert_true(fabs(epipolar_distance(f, bend, &m) - expected) < 1e-4 * expected + 1e-9);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(three_lenses_are_told_apart),
        cmocka_unit_test(straight_lenses_stay_straight), cmocka_unit_test(too_little_to_tell),
        cmocka_unit_test(fits_are_near), cmocka_unit_test(distance_is_to_the_curve)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
