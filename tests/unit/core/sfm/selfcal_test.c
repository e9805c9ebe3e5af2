/* Lenses found from tracks against those that the tracks were made with. */
#include "core/sfm/selfcal.h"

#include "tests/unit/core/sfm/bundle_job.h"
#include "tests/unit/some_of.h"

/* Largest distance, px, between where two lenses have the same ray, over the view. */
static double lens_distance(const struct lens *truth, const struct lens *found)
{
    double most = 0;
    for (int i = 0; i < 17 * 17; i++) {
        const double px[2] = {(i % 17 - 8) * SCENE_SIZE / 16.0, (i / 17 - 8) * SCENE_SIZE / 16.0};
        double ray[3], to[2] = {1e9, 1e9};
        if (!lens_unproject(truth, px, ray))
            continue;
        (void)lens_project(found, ray, to);
        most = fmax(most, hypot(to[0] - px[0], to[1] - px[1]));
    }
    return most;
}

static struct lens make_lens(enum lens_model m, double focal, double k1, double k2)
{
    struct lens l = {m, focal, focal, 0, 0, {k1, k2}, 0};
    assert_int_equal(lens_init(&l), OK);
    return l;
}

static void lenses_of(const struct scene_rig *s, struct bundle_lens lens[SCENE_LENSES],
                      int lens_of[SCENE_VIEWS], struct bundle_config *cfg)
{
    memset(lens, 0, SCENE_LENSES * sizeof *lens);
    for (int v = 0; v < s->n_views; v++)
        lens_of[v] = v % s->n_lenses;
    *cfg = (struct bundle_config){
        .n_lenses = s->n_lenses, .lens = lens, .lens_of = lens_of, .find_distortion = true};
}

/* All views through one lens, with which the search begins if it is `known`. */
static void run_through(struct job *j, struct lens l, bool known)
{
    struct bundle_lens lens[SCENE_LENSES];
    struct bundle_config cfg;
    int of[SCENE_VIEWS];
    j->rig.n_lenses = 1;
    j->rig.lens[0] = l;
    scene_make(&j->rig, &j->tracks);
    lenses_of(&j->rig, lens, of, &cfg);
    if (known)
        lens[0].start = l;
    run_ok(j, &cfg);
}

/* A lens without distortion gets no term. */
static void perfect_lens_stays_perfect(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1000, 381, 0.3, 15)};
    scene_grid(&j.rig);
    run_through(&j, make_lens(LENS_PINHOLE, 381, 0, 0), false);
    assert_right(&j, 0.1, 0.01, 0.02);
    assert_int_equal(j.out.lenses[0].model, LENS_PINHOLE);
    assert_int_equal(j.out.selfcal[0].stop, SELFCAL_ENOUGH);
    assert_true(j.out.selfcal[0].held > 200);
    assert_true(j.out.selfcal[0].deviation[0] > 1e-4 && j.out.selfcal[0].deviation[0] < 0.02);
    job_free(&j);
}

/* Barrel distortion of 9 px in the corners of 448; the standard error is a true one. */
static void barrel_is_found(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1000, 381, 0.3, 25)};
    scene_arc(&j.rig, 18, 80);
    run_through(&j, make_lens(LENS_SIMPLE_RADIAL, 381, -0.1, 0), false);
    print_message("k1 %g +- %g f %g, %g px, %g > %g\n", j.out.lenses[0].term[0],
                  j.out.selfcal[0].deviation[1], j.out.lenses[0].fx,
                  lens_distance(&j.rig.lens[0], &j.out.lenses[0]), j.out.selfcal[0].error_before,
                  j.out.selfcal[0].error);
    assert_true(j.out.n_placed == 18);
    assert_true(j.out.lenses[0].model != LENS_PINHOLE);
    assert_true(fabs(j.out.lenses[0].term[0] + 0.1) < 4 * j.out.selfcal[0].deviation[1] + 0.003);
    assert_true(lens_distance(&j.rig.lens[0], &j.out.lenses[0]) < 1);
    assert_true(j.out.selfcal[0].error < 0.95 * j.out.selfcal[0].error_before);
    job_free(&j);
}

/* A barrel that the search begins with, as photographs that were drawn again through it do. */
static void terms_that_stay_have_errors(void **unused)
{
    (void)unused;
    for (unsigned seed = 11; seed < 17; seed++) {
        struct job j = {.rig = make_room(500, 381, 0.3, 25)};
        j.rig.seed = seed;
        scene_arc(&j.rig, 6, 60);
        run_through(&j, make_lens(LENS_RADIAL, 381, -0.1, 0.02), true);
        for (int k = 0; k < 3; k++)
            assert_true(j.out.selfcal[0].deviation[k] > 1e-4);
        job_free(&j);
    }
}

/* Five photographs: they leave out too few observations to tell by these alone. Barrel distortion,
 * and none. */
static void few_photographs_tell(void **unused)
{
    (void)unused;
    static const double distortion[2] = {-0.05, 0};
    for (int k = 0; k < 8; k++) {
        struct job j = {.rig = make_room(500, 381, 0.3, 40)};
        j.rig.seed = (unsigned)(11 + k / 2);
        j.rig.noise = 0.3;
        scene_arc(&j.rig, 5, 60);
        run_through(&j, make_lens(LENS_SIMPLE_RADIAL, 381, distortion[k % 2], 0), false);
        const struct lens *l = &j.out.lenses[0];
        print_message("%s f %g k1 %g +- %g, %d left out\n", lens_name(l->model), l->fx, l->term[0],
                      j.out.selfcal[0].deviation[1], j.out.selfcal[0].held);
        assert_int_equal(l->model, k % 2 ? LENS_PINHOLE : LENS_SIMPLE_RADIAL);
        assert_true(fabs(l->fx / 381 - 1) < 0.006);
        job_free(&j);
    }
}

/* Three kinds of camera, each with its own focal length and terms. */
static void kinds_are_told_apart(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1500, 381, 0.2, 30)};
    struct bundle_lens lens[SCENE_LENSES];
    struct bundle_config cfg;
    int of[SCENE_VIEWS];
    j.rig.n_lenses = 3;
    j.rig.lens[0] = make_lens(LENS_SIMPLE_RADIAL, 381, -0.15, 0);
    j.rig.lens[1] = make_lens(LENS_PINHOLE, 450, 0, 0);
    j.rig.lens[2] = make_lens(LENS_RADIAL, 340, -0.2, 0.05);
    scene_arc(&j.rig, 18, 80);
    scene_make(&j.rig, &j.tracks);
    lenses_of(&j.rig, lens, of, &cfg);
    run_ok(&j, &cfg);
    for (int i = 0; i < 3; i++) {
        const struct lens *l = &j.out.lenses[i];
        print_message("%s f %g k %g %g: %g px\n", lens_name(l->model), l->fx, l->term[0],
                      l->term[1], lens_distance(&j.rig.lens[i], l));
        assert_true(lens_distance(&j.rig.lens[i], l) < 1.5);
        assert_true(fabs(l->fx / j.rig.lens[i].fx - 1) < 0.02);
    }
    assert_int_equal(j.out.n_placed, 18);
    assert_int_equal(j.out.lenses[1].model, LENS_PINHOLE);
    job_free(&j);
}

/* Of two kinds of camera one is far from what the search begins with: 80 degrees, -0.3 and 0.08;
 * then a fisheye of 110 degrees. */
static void unusual_kinds_are_placed(void **unused)
{
    (void)unused;
    const struct lens unusual[] = {make_lens(LENS_RADIAL, 267, -0.3, 0.08),
                                   make_lens(LENS_OPENCV_FISHEYE, 230, 0.01, 0)};
    for (int k = 0; k < 2; k++) {
        struct job j = {.rig = make_room(1500, 381, 0.2, 30)};
        struct bundle_lens lens[SCENE_LENSES];
        struct bundle_config cfg;
        int of[SCENE_VIEWS];
        j.rig.n_lenses = 2;
        j.rig.lens[0] = make_lens(LENS_PINHOLE, 400, 0, 0);
        j.rig.lens[1] = unusual[k];
        scene_arc(&j.rig, 12, 60);
        scene_make(&j.rig, &j.tracks);
        lenses_of(&j.rig, lens, of, &cfg);
        run_ok(&j, &cfg);
        assert_int_equal(j.out.n_placed, 12);
        for (int i = 0; i < 2; i++) {
            const struct lens *l = &j.out.lenses[i];
            print_message("%s f %g k %g: %g px\n", lens_name(l->model), l->fx, l->term[0],
                          lens_distance(&j.rig.lens[i], l));
            assert_true(fabs(l->fx / j.rig.lens[i].fx - 1) < 0.02);
            assert_true(lens_distance(&j.rig.lens[i], l) < 3);
        }
        job_free(&j);
    }
}

/* Two photographs of a fisheye of 150 degrees beside six of a narrow lens, which show only what is
 * near the middle of the former: k1 of a perspective lens explains that as well, but would leave
 * the corners without light. */
static void wide_lens_covers_its_frame(void **unused)
{
    (void)unused;
    struct job j = {.rig = make_room(1500, 381, 0.2, 40)};
    struct bundle_lens lens[SCENE_LENSES];
    struct bundle_config cfg;
    int of[SCENE_VIEWS];
    j.rig.n_lenses = 4;
    j.rig.lens[0] = j.rig.lens[1] = j.rig.lens[2] = make_lens(LENS_PINHOLE, 450, 0, 0);
    j.rig.lens[3] = make_lens(LENS_OPENCV_FISHEYE, 171, -0.02, 0);
    scene_arc(&j.rig, 8, 50);
    scene_make(&j.rig, &j.tracks);
    lenses_of(&j.rig, lens, of, &cfg);
    cfg.n_lenses = 2;
    for (int v = 0; v < j.rig.n_views; v++)
        of[v] = v % 4 == 3;
    run_ok(&j, &cfg);
    const struct lens *l = &j.out.lenses[1];
    print_message("%s f %g k1 %g of 171 and -0.02, %d placed: %g px\n", lens_name(l->model), l->fx,
                  l->term[0], j.out.n_placed, lens_distance(&j.rig.lens[3], l));
    assert_int_equal(j.out.n_placed, 8);
    assert_int_equal(l->model, LENS_OPENCV_FISHEYE);
    assert_true(lens_distance(&j.rig.lens[3], l) < 6);
    job_free(&j);
}

/* Principal points 9 and -6 px from the middle: of a barrel, of a pinhole, of a fisheye; each
 * looked for. In the middle it stays there, and nothing else is found. */
static void principal_points_are_found(void **unused)
{
    (void)unused;
    struct lens truth[] = {
        make_lens(LENS_SIMPLE_RADIAL, 381, -0.15, 0), make_lens(LENS_PINHOLE, 381, 0, 0),
        make_lens(LENS_OPENCV_FISHEYE, 300, 0.01, 0), make_lens(LENS_PINHOLE, 381, 0, 0)};
    for (int k = 0; k < 4; k += some_of(2)) {
        struct job j = {.rig = make_room(1500, 381, 0.2, 30)};
        struct bundle_lens lens[SCENE_LENSES];
        struct bundle_config cfg;
        int of[SCENE_VIEWS];
        truth[k].cx = k < 3 ? 9 : 0;
        truth[k].cy = k < 3 ? -6 : 0;
        j.rig.n_lenses = 1;
        j.rig.lens[0] = truth[k];
        scene_arc(&j.rig, 18, 80);
        scene_make(&j.rig, &j.tracks);
        lenses_of(&j.rig, lens, of, &cfg);
        cfg.find_principal = true;
        if (truth[k].model == LENS_OPENCV_FISHEYE)
            lens[0].start.model = LENS_OPENCV_FISHEYE;
        run_ok(&j, &cfg);
        const struct lens *l = &j.out.lenses[0];
        const double *error = j.out.selfcal[0].deviation + ADJUST_CENTRE;
        print_message("%s f %g k1 %g, at %g +- %g, %g +- %g: %g px\n", lens_name(l->model), l->fx,
                      l->term[0], l->cx, error[0], l->cy, error[1], lens_distance(&truth[k], l));
        assert_true(lens_distance(&truth[k], l) < 2);
        assert_true(fabs(l->cx - truth[k].cx) < 4 * error[0] + 0.1);
        assert_true(fabs(l->cy - truth[k].cy) < 4 * error[1] + 0.1);
        assert_true(k < 3 ? error[0] > 0 && error[0] < 1 : l->model == LENS_PINHOLE);
        job_free(&j);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(perfect_lens_stays_perfect),  cmocka_unit_test(barrel_is_found),
        cmocka_unit_test(terms_that_stay_have_errors), cmocka_unit_test(few_photographs_tell),
        cmocka_unit_test(kinds_are_told_apart),        cmocka_unit_test(unusual_kinds_are_placed),
        cmocka_unit_test(wide_lens_covers_its_frame),  cmocka_unit_test(principal_points_are_found),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
