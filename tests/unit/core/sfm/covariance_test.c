/* Covariances of poses against the errors that simulated rigs have: over many of them the squared
 * error over its covariance is 1 for each unknown. What fixes the world; threads; known poses. */
#include "core/sfm/covariance.h"

#include "tests/unit/core/sfm/bundle_job.h"

enum { TWIST = 6 };

/* Twist from camera a to b: the turn about b's axes, and what it shifts the centre along them. */
static void twist_between(const struct camera *a, const struct camera *b, double out[TWIST])
{
    double ra[9], rb[9], turn[9], ca[3], cb[3];
    rotation_of_camera(a, ra);
    rotation_of_camera(b, rb);
    lin_product_t(rb, ra, turn);
    rotation_log(turn, out);
    rotation_centre(a, ca);
    rotation_centre(b, cb);
    for (int k = 0; k < 3; k++)
        ca[k] -= cb[k];
    lin_apply(rb, ca, out + 3);
}

/* Takes out of twists what moves all cameras. */
static void fix_twists(const struct covariance_gauge *g, double *twist)
{
    double fixed[TWIST][COVARIANCE_GAUGE], moves[TWIST][COVARIANCE_GAUGE],
        sum[COVARIANCE_GAUGE] = {0};
    for (int i = 0; i < TWIST * COVARIANCE_GAUGE * g->n; i++) {
        const int row = i / COVARIANCE_GAUGE, k = i % COVARIANCE_GAUGE;
        covariance_gauge_rows(g, row / TWIST, fixed, moves);
        sum[k] += fixed[row % TWIST][k] * twist[row];
    }
    for (int i = 0; i < TWIST * COVARIANCE_GAUGE * g->n; i++) {
        const int row = i / COVARIANCE_GAUGE, k = i % COVARIANCE_GAUGE;
        covariance_gauge_rows(g, row / TWIST, fixed, moves);
        twist[row] -= moves[row % TWIST][k] * sum[k];
    }
}

static void poses_of(const struct camera *cams, int n, double *pose)
{
    for (int i = 0; i < n; i++) {
        rotation_of_camera(&cams[i], pose + ADJUST_POSE * i);
        for (int k = 0; k < 3; k++)
            pose[ADJUST_POSE * i + 9 + k] = (double)cams[i].t[k];
    }
}

/* Errors of all cameras, in the world of the result. */
static void find_errors(struct job *j, double *error)
{
    const int n = j->rig.n_views;
    struct camera at[SCENE_VIEWS];
    double pose[SCENE_VIEWS * ADJUST_POSE];
    struct similarity w;
    struct arena tmp;
    assert_int_equal(arena_init(&tmp, "tmp", similarity_plan(n)), OK);
    const struct run r = {.tmp = &tmp};
    assert_int_equal(similarity_fit(&r, j->rig.cams, j->out.cams, n, &w), OK);
    arena_free(&tmp);
    for (int i = 0; i < n; i++) {
        at[i] = similarity_apply(&w, &j->rig.cams[i]);
        twist_between(&at[i], &j->out.cams[i], error + TWIST * i);
    }
    poses_of(at, n, pose);
    const struct covariance_gauge g = covariance_find_gauge(pose, NULL, n, true);
    fix_twists(&g, error);
}

/* Mean of e^T C^-1 e / 6 over the cameras. */
static double normalised_error(struct job *j)
{
    double error[SCENE_VIEWS * TWIST], sum = 0;
    find_errors(j, error);
    for (int i = 0; i < j->rig.n_views; i++) {
        const double *c = j->out.pose_covariance + COVARIANCE_POSE * i;
        double factor[COVARIANCE_POSE], x[TWIST];
        for (int k = 0; k < COVARIANCE_POSE; k++) // symmetric
            assert_true(fabs(c[k] - c[TWIST * (k % TWIST) + k / TWIST]) <=
                        1e-6 * sqrt(c[7 * (k / TWIST)] * c[7 * (k % TWIST)]));
        memcpy(factor, c, sizeof factor);
        memcpy(x, error + TWIST * i, sizeof x);
        assert_true(lin_cholesky(factor, TWIST));
        lin_solve(factor, TWIST, x);
        for (int k = 0; k < TWIST; k++)
            sum += x[k] * error[TWIST * i + k] / TWIST;
    }
    return sum / j->rig.n_views;
}

static void make(struct job *j, int views, double noise, uint32_t seed)
{
    *j = (struct job){.rig = {.n_points = 60 * views,
                              .focal = 388,
                              .noise = noise,
                              .wrong = 0.1,
                              .reach = 40,
                              .seed = seed}};
    scene_arc(&j->rig, views, 12 * (views - 1));
    scene_make(&j->rig, &j->tracks);
}

static void covariances_are_those_of_the_errors(void **state)
{
    static const struct {
        int views, seeds;
        double noise; // 0.5 is expected
        bool known;   // the focal length
        double least, most;
    } rigs[] = {{4, 20, 0.5, true, 0.8, 1.3},
                {4, 20, 0.25, true, 0.8, 1.3},
                {8, 10, 0.5, false, 0.8, 1.3},
                {8, 10, 1, false, 1, 1.8}, // gates cut off errors that large
                {16, 4, 0.5, false, 0.8, 1.3}};
    (void)state;
    for (size_t k = 0; k < sizeof rigs / sizeof *rigs; k++) {
        double sum = 0;
        for (int i = 0; i < rigs[k].seeds; i++) {
            struct job j;
            make(&j, rigs[k].views, rigs[k].noise, (uint32_t)i + 1);
            const struct bundle_config cfg = {.focal_known = rigs[k].known,
                                              .find_distortion = !rigs[k].known,
                                              .measure_poses = true,
                                              KNOWN_LENS(388)};
            assert_int_equal(run_on(&j, &cfg, 1), OK);
            assert_int_equal(j.out.n_placed, rigs[k].views);
            sum += normalised_error(&j) / rigs[k].seeds;
            job_free(&j);
        }
        print_message("%d cameras, noise of %g px: squared error over its covariance %.2f\n",
                      rigs[k].views, rigs[k].noise, sum);
        assert_true(sum > rigs[k].least && sum < rigs[k].most);
    }
}

/* All views see what lies in one part of the first view that has it off by the same. */
static void share_errors(struct scene_tracks *t, int n_views, double px)
{
    enum { PARTS = 8 };
    int part = 0;
    float(*off)[2] =
        calloc((size_t)(n_views * PARTS * PARTS * n_views), sizeof *off); // (parts, views)
    for (int i = 0; i < n_views * PARTS * PARTS * n_views; i++) {
        off[i][0] = (float)(px * scene_normal());
        off[i][1] = (float)(px * scene_normal());
    }
    for (int i = 0; i < t->t.n; i++) {
        struct match_observation *o = &t->t.obs[i];
        const float u = fmaxf(0, fminf(o->u, SCENE_SIZE - 1)),
                    v = fmaxf(0, fminf(o->v, SCENE_SIZE - 1));
        if (i == 0 || o->track != o[-1].track)
            part = (o->view * PARTS + (int)(v * PARTS / SCENE_SIZE)) * PARTS +
                   (int)(u * PARTS / SCENE_SIZE);
        o->u += off[part * n_views + o->view][0];
        o->v += off[part * n_views + o->view][1];
    }
    free(off);
}

/* Neighbouring points that are matched wrongly together tell less than as many others. */
static void shared_errors_count(void **state)
{
    double sum = 0;
    (void)state;
    for (uint32_t seed = 1; seed <= 4; seed++) {
        struct job j;
        make(&j, 8, 0.2, seed);
        j.rig.n_points = 1500;
        scene_free(&j.tracks);
        scene_make(&j.rig, &j.tracks);
        share_errors(&j.tracks, 8, 0.4);
        const struct bundle_config cfg = {.find_distortion = true, .measure_poses = true};
        assert_int_equal(run_on(&j, &cfg, 1), OK);
        assert_int_equal(j.out.n_placed, 8);
        sum += normalised_error(&j) / 4;
        job_free(&j);
    }
    print_message("shared errors: squared error over its covariance %.2f\n", sum);
    assert_true(sum > 0.7 && sum < 2.5);
}

/* Nothing without being asked; nothing of poses that are known; not by threads; in any world. */
static void what_it_depends_on(void **state)
{
    struct job j;
    double first[8 * COVARIANCE_POSE];
    (void)state;
    make(&j, 8, 0.5, 3);
    struct bundle_config cfg = {.measure_poses = true, KNOWN_LENS(388)};
    assert_int_equal(run_on(&j, &cfg, 1), OK);
    memcpy(first, j.out.pose_covariance, sizeof first);
    for (int i = 0; i < 8; i++)
        assert_true(j.out.depth[i] > 0);
    assert_int_equal(run_on(&j, &cfg, 4), OK);
    assert_memory_equal(first, j.out.pose_covariance, sizeof first);

    int turned[8] = {1, 0, 3}; // of no use to geometry, but which axis is which
    cfg.turned = turned;
    for (int i = 0; i < j.tracks.t.n; i++) {
        struct match_observation *o = &j.tracks.t.obs[i];
        const float u = o->u, v = o->v;
        o->u = turned[o->view] == 1 ? SCENE_SIZE - v : turned[o->view] == 3 ? v : u;
        o->v = turned[o->view] == 1 ? u : turned[o->view] == 3 ? SCENE_SIZE - u : v;
    }
    assert_int_equal(run_on(&j, &cfg, 1), OK);
    const double quarter[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1}; // of view 0
    for (int i = 0; i < COVARIANCE_POSE; i++) {
        const int row = i / TWIST, column = i % TWIST;
        double expected = 0;
        for (int k = 0; k < 9; k++) {
            const int u = row / 3 * 3 + k / 3, v = column / 3 * 3 + k % 3;
            expected += quarter[row % 3 * 3 + k / 3] * quarter[column % 3 * 3 + k % 3] *
                        first[TWIST * u + v];
        }
        const double *c = j.out.pose_covariance;
        assert_true(fabs(c[i] - expected) < 0.05 * sqrt(c[7 * row] * c[7 * column]));
    }

    cfg.measure_poses = false;
    assert_int_equal(run_on(&j, &cfg, 1), OK);
    for (int i = 0; i < 8 * COVARIANCE_POSE; i++)
        assert_true(j.out.pose_covariance[i] == 0);
    cfg = (struct bundle_config){
        .start = j.rig.cams, .rig_known = true, .measure_poses = true, KNOWN_LENS(388)};
    assert_int_equal(run_on(&j, &cfg, 1), OK);
    for (int i = 0; i < 8 * COVARIANCE_POSE; i++)
        assert_true(j.out.pose_covariance[i] == 0);
    job_free(&j);
}

/* A motion of the world is nothing once the gauge is fixed, and what is fixed stays so. */
static void motions_of_the_world_do_not_count(void **state)
{
    struct scene_rig rig = {.focal = 388};
    double pose[5 * ADJUST_POSE], twist[5 * TWIST], once[5 * TWIST];
    double fixed[TWIST][COVARIANCE_GAUGE], moves[TWIST][COVARIANCE_GAUGE];
    (void)state;
    scene_arc(&rig, 5, 80);
    poses_of(rig.cams, 5, pose);
    const struct covariance_gauge g = covariance_find_gauge(pose, NULL, 5, true);
    for (int k = 0; k < COVARIANCE_GAUGE; k++) {
        struct similarity w = {.scale = k == 6 ? 1.0001 : 1, .q = {1, 0, 0, 0}};
        w.q[1 + k % 3] = k < 3 ? 5e-5 : 0;
        w.t[k % 3] = k >= 3 && k < 6 ? 1e-4 : 0;
        for (int i = 0; i < 5; i++) {
            const struct camera moved = similarity_apply(&w, &rig.cams[i]);
            twist_between(&rig.cams[i], &moved, twist + TWIST * i);
        }
        fix_twists(&g, twist);
        for (int i = 0; i < 5 * TWIST; i++)
            assert_true(fabs(twist[i]) < 2e-6);
    }
    for (int i = 0; i < 5 * TWIST; i++)
        twist[i] = once[i] = sin(3.0 * i);
    fix_twists(&g, once);
    memcpy(twist, once, sizeof twist);
    fix_twists(&g, twist);
    for (int i = 0; i < 5 * TWIST; i++)
        assert_float_equal(twist[i], once[i], 1e-12);
    const bool some[5] = {true, true, false, true, true};
    const struct covariance_gauge part = covariance_find_gauge(pose, some, 5, false);
    covariance_gauge_rows(&part, 2, fixed, moves);
    for (int i = 0; i < TWIST * COVARIANCE_GAUGE; i++)
        assert_true(fixed[i / COVARIANCE_GAUGE][i % COVARIANCE_GAUGE] == 0 &&
                    moves[i / COVARIANCE_GAUGE][i % COVARIANCE_GAUGE] == 0);
    covariance_gauge_rows(&part, 1, fixed, moves);
    assert_true(fixed[3][6] == 0 && fixed[0][0] != 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(covariances_are_those_of_the_errors),
        cmocka_unit_test(shared_errors_count),
        cmocka_unit_test(what_it_depends_on),
        cmocka_unit_test(motions_of_the_world_do_not_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
