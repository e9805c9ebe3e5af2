/* Derivatives of the least squares against differences; points that have no end. */
#include "core/base/rotation.h"
#include "core/sfm/adjust.h"
#include "core/sfm/triangulate.h"
#include "tests/unit/core/sfm/bundle_job.h"

enum { SMALL = 4 };

static void small_problem(struct adjust *a, double pose[SMALL][ADJUST_POSE], bool *placed)
{
    static const int lens_of[SMALL] = {0, 1, 2, 1};
    static struct adjust_lens lens[3];
    lens[0].lens = (struct lens){.model = LENS_PINHOLE, .fx = 400, .fy = 400};
    lens[1].lens = (struct lens){LENS_OPENCV, 400, 400, 8, -3, {-0.05, 0.01, 0.004, -0.003}, 0};
    lens[2].lens =
        (struct lens){LENS_OPENCV_FISHEYE, 300, 300, 0, 0, {0.02, -0.01, 0.003, 0.001}, 0};
    for (int i = 0; i < 3; i++)
        assert_int_equal(lens_init(&lens[i].lens), OK);
    *a = (struct adjust){.n_views = SMALL,
                         .n_lenses = 3,
                         .lens = lens,
                         .lens_of = lens_of,
                         .pose = pose[0],
                         .placed = placed};
    for (int v = 0; v < SMALL; v++) {
        const double w[3] = {scene_uniform(-1, 1), scene_uniform(-1, 1), scene_uniform(-1, 1)};
        rotation_exp(w, pose[v]);
        for (int k = 0; k < 3; k++)
            pose[v][9 + k] = scene_uniform(-0.5, 0.5);
        placed[v] = true;
    }
}

/* Errors after unknown i (6 of the pose, 3 of the point, those of the lens) has moved by `by`. */
static void moved_error(struct adjust *a, const double point[4], const struct adjust_observation *s,
                        int i, double by, double out[2])
{
    double *pose = a->pose + ADJUST_POSE * (size_t)s->view, own[ADJUST_POSE], p[4], move[6] = {0};
    struct lens *lens = &a->lens[a->lens_of[s->view]].lens;
    const struct lens old = *lens;
    struct adjust_jacobian d;
    memcpy(own, pose, sizeof own);
    memcpy(p, point, sizeof p);
    move[i < 6 ? i : i % 3] = by;
    if (i < 6)
        adjust_move_pose(pose, move);
    else if (i < 9)
        adjust_move_point(p, move);
    else if (i == 9)
        lens->fx = lens->fy = lens->fx * exp(by);
    else if (i < 9 + ADJUST_CENTRE)
        lens->term[i - 10] += by;
    else if (lens->model != LENS_PINHOLE)
        *(i == 9 + ADJUST_CENTRE ? &lens->cx : &lens->cy) += by;
    assert_true(adjust_jacobian(a, p, s, &d));
    memcpy(out, d.error, sizeof d.error);
    memcpy(pose, own, sizeof own);
    *lens = old;
}

static void slopes_are_differences(void **unused)
{
    (void)unused;
    const double h = 1e-6;
    double pose[SMALL][ADJUST_POSE], point[4], up[2], down[2];
    bool placed[SMALL];
    struct adjust a;
    struct adjust_jacobian d;
    int checked = 0;
    scene_state = 4;
    for (int trial = 0; trial < 500; trial++) {
        struct adjust_observation s = {5, -7, 1.7f, trial % SMALL};
        double length = 0;
        small_problem(&a, pose, placed);
        for (int k = 0; k < 4; k++) {
            point[k] = k == 3 && trial % 5 == 0 ? 0 : scene_uniform(-1, 1);
            length += point[k] * point[k];
        }
        for (int k = 0; k < 4; k++)
            point[k] /= sqrt(length);
        if (!adjust_jacobian(&a, point, &s, &d) ||
            adjust_depth(&a, s.view, point) * fabs(point[3]) < 0.2)
            continue;
        double e2 = d.error[0] * d.error[0] + d.error[1] * d.error[1];
        assert_float_equal(e2, adjust_error(&a, point, &s), 1e-6 * e2);
        checked++;
        for (int i = 0; i < 2 * (9 + ADJUST_LENS); i++) {
            const int u = i / 2, k = i % 2;
            moved_error(&a, point, &s, u, h, up);
            moved_error(&a, point, &s, u, -h, down);
            double slope = u < 6 ? d.pose[k][u] : u < 9 ? d.point[k][u - 6] : d.lens[k][u - 9];
            double obs = (up[k] - down[k]) / (2 * h);
            assert_float_equal(slope, obs, 1e-4 * (fabs(obs) + 100));
        }
    }
    assert_true(checked > 40);
}

static void far_points_have_no_end(void **unused)
{
    (void)unused;
    double pose[SMALL][ADJUST_POSE] = {{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0},
                                       {1, 0, 0, 0, 1, 0, 0, 0, 1, -1, 0, 0}};
    bool placed[2] = {true, true}, in[4] = {false};
    double point[8] = {0};
    const struct adjust_observation obs[4] = {{100, 50, 1, 0},
                                              {100, 50, 1, 1}, // parallel rays
                                              {100, 50, 1, 0},
                                              {100.5, 50, 1, 1}}; // rays that part
    const int first[3] = {0, 2, 4};
    struct adjust a = {.n_views = 2,
                       .n_tracks = 2,
                       .first = first,
                       .obs = obs,
                       .n_lenses = 1,
                       .lens = &(struct adjust_lens){.lens = {.fx = 400, .fy = 400}},
                       .lens_of = (int[2]){0, 0},
                       .pose = pose[0],
                       .placed = placed,
                       .point = point,
                       .in = in};
    struct run r = {.pool = NULL};
    assert_int_equal(triangulate_points(&r, &a, 3), OK);
    for (int i = 0; i < 4; i++)
        assert_true(in[i]);
    assert_true(adjust_depth(&a, 0, point) > 1e6 || adjust_depth(&a, 0, point) < -1e6);
    assert_true(adjust_error(&a, point, &obs[0]) < 1e-6);
    assert_true(adjust_error(&a, point + 4, &obs[2]) < 0.1);
    const double ahead[4] = {0, 0, 1, 0}, behind[4] = {0, 0, -1, 0};
    assert_true(isinf(adjust_depth(&a, 0, ahead)) && adjust_depth(&a, 0, ahead) > 0);
    assert_true(isinf(adjust_depth(&a, 0, behind)) && adjust_depth(&a, 0, behind) < 0);
    assert_true(adjust_error(&a, behind, &obs[0]) > 1e20);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(slopes_are_differences),
        cmocka_unit_test(far_points_have_no_end),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
