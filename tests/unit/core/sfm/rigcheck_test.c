/* Cameras of a rig against its calibration: still ones are not accused, moved ones are named with
 * how far; several; too few; broken input. */
#include "core/sfm/rigcheck.h"

#include "core/sfm/pose.h"
#include "tests/unit/core/sfm/bundle_job.h"

enum { TRIALS = 100 };

struct setup {
    struct scene_rig rig;
    struct scene_tracks tracks;
    struct rigcheck_camera found[SCENE_VIEWS];
};

/* A rig on an arc, 12 degrees apart or all around, whose tracks are half a pixel of noise off. */
static void make(struct setup *s, int n, int points, uint32_t seed)
{
    s->rig = (struct scene_rig){
        .n_points = points, .focal = 388, .noise = 0.5, .wrong = 0.1, .reach = 40, .seed = seed};
    scene_arc(&s->rig, n, fmin(12 * (n - 1), 357));
    scene_make(&s->rig, &s->tracks);
}

/* The calibration has the camera elsewhere: turned by `degrees` about a random axis, shifted by
 * `metres`. */
static void misplace(struct camera *c, double degrees, double metres)
{
    double w[3], v[3];
    float twist[6];
    for (int k = 0; k < 3; k++) {
        w[k] = scene_normal();
        v[k] = scene_normal();
    }
    lin_normalise(w);
    lin_normalise(v);
    for (int k = 0; k < 3; k++) {
        twist[k] = (float)(w[k] * degrees * DEGREE);
        twist[3 + k] = (float)(v[k] * metres);
    }
    pose_move(c, twist);
}

static err_t check(struct setup *s, const struct camera *cams, int threads)
{
    struct plan plan = plan_begin(threads);
    struct arena tmp;
    struct pool *pool = NULL;
    rigcheck_plan(&plan, s->rig.n_views, &s->tracks.t);
    assert_int_equal(arena_init(&tmp, "tmp", plan.tmp.peak), OK);
    if (threads > 1)
        assert_int_equal(pool_open(&pool, threads), OK);
    const struct run r = {.tmp = &tmp, .pool = pool};
    const struct views v = views_of(s->rig.n_views);
    err_t e = rigcheck_run(&r, &v, &s->tracks.t, cams, s->found);
    assert_int_equal(tmp.used, 0);
    assert_true(e != OK || tmp.peak <= plan.tmp.peak);
    pool_close(pool);
    arena_free(&tmp);
    return e;
}

static int count_moved(const struct setup *s)
{
    int n = 0;
    for (int i = 0; i < s->rig.n_views; i++)
        n += s->found[i].moved;
    return n;
}

static void still_cameras_are_not_accused(void **state)
{
    static const int sizes[] = {3, 4, 8, 16}, most[] = {3, 1, 1, 1};
    (void)state;
    for (int k = 0; k < 4; k++) {
        int wrong = 0;
        for (uint32_t seed = 1; seed <= TRIALS; seed++) {
            static struct setup s;
            make(&s, sizes[k], 60 * sizes[k], seed);
            assert_int_equal(check(&s, s.rig.cams, 1), OK);
            wrong += count_moved(&s) > 0;
            scene_free(&s.tracks);
        }
        if (wrong > most[k])
            print_error("%d cameras: %d of %d\n", sizes[k], wrong, TRIALS);
        assert_true(wrong <= most[k]);
    }
}

/* 0.3 degrees are found, and it is that camera alone that is named. */
static void turned_camera_is_named(void **state)
{
    static const int sizes[] = {4, 8, 16}, least[] = {93, 99, 99};
    (void)state;
    for (int k = 0; k < 3; k++) {
        int named = 0;
        double off = 0;
        for (uint32_t seed = 1; seed <= TRIALS; seed++) {
            static struct setup s;
            struct camera cams[SCENE_VIEWS];
            const int which = (int)seed % sizes[k];
            make(&s, sizes[k], 60 * sizes[k], seed);
            memcpy(cams, s.rig.cams, sizeof cams);
            misplace(&cams[which], 0.3, 0);
            assert_int_equal(check(&s, cams, 1), OK);
            const bool right = s.found[which].moved && count_moved(&s) == 1;
            named += right;
            off += right ? rotation_between(&s.found[which].cam, &s.rig.cams[which]) : 0;
            scene_free(&s.tracks);
        }
        if (named < least[k])
            print_error("%d cameras: named %d of %d\n", sizes[k], named, TRIALS);
        assert_true(named >= least[k]);
        assert_true(off / named < 0.15 * DEGREE); // where it is now, too
    }
}

static void far_moves(void **state)
{
    static struct setup s;
    struct camera cams[SCENE_VIEWS];
    (void)state;
    make(&s, 9, 700, 5);
    memcpy(cams, s.rig.cams, sizeof cams);
    misplace(&cams[2], 8, 0.2);
    misplace(&cams[7], 0, 0.1);
    assert_int_equal(check(&s, cams, 1), OK);
    assert_int_equal(count_moved(&s), 2);
    assert_true(s.found[2].moved && s.found[7].moved);
    assert_float_equal(s.found[2].turned_deg, 8, 0.3);
    assert_true(s.found[7].shift > 0.02f && s.found[7].shift < 0.06f); // 0.1 of about 3 m
    assert_true(rotation_between(&s.found[2].cam, &s.rig.cams[2]) < 0.2 * DEGREE);
    struct rigcheck_camera one[SCENE_VIEWS];
    memcpy(one, s.found, sizeof one);
    assert_int_equal(check(&s, cams, 4), OK);
    assert_memory_equal(one, s.found, 9 * sizeof one[0]);
    scene_free(&s.tracks);
}

/* Those that moved are named, and no other. */
static void a_hundred_cameras(void **state)
{
    static const int moved[] = {3, 77, 99};
    static struct setup s;
    struct camera cams[SCENE_VIEWS];
    (void)state;
    make(&s, 100, 3000, 5);
    memcpy(cams, s.rig.cams, sizeof cams);
    for (int k = 0; k < 3; k++)
        misplace(&cams[moved[k]], 0.5, 0);
    assert_int_equal(check(&s, cams, 2), OK);
    assert_int_equal(count_moved(&s), 3);
    for (int k = 0; k < 3; k++)
        assert_true(s.found[moved[k]].moved);
    for (int i = 0; i < 100; i++)
        assert_true(s.found[i].known);
    scene_free(&s.tracks);
}

/* Few points, or none, tell nothing; two cameras are refused. */
static void too_little(void **state)
{
    static struct setup s;
    (void)state;
    make(&s, 5, 12, 5);
    misplace(&s.rig.cams[1], 5, 0);
    assert_int_equal(check(&s, s.rig.cams, 1), OK);
    assert_int_equal(count_moved(&s), 0);
    for (int i = 0; i < 5; i++)
        assert_false(s.found[i].known);
    s.tracks.t.n = s.tracks.t.n_tracks = 0;
    assert_int_equal(check(&s, s.rig.cams, 1), OK);
    assert_int_equal(count_moved(&s), 0);
    s.rig.n_views = 2;
    assert_int_equal(check(&s, s.rig.cams, 1), ERR_ARG);
    scene_free(&s.tracks);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(still_cameras_are_not_accused),
        cmocka_unit_test(turned_camera_is_named),
        cmocka_unit_test(far_moves),
        cmocka_unit_test(a_hundred_cameras),
        cmocka_unit_test(too_little),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
