/* How far estimated cameras are from true ones; finding them is tested end to end. */
#include "core/sfm/similarity.h"
#include "firmware/recon/testcams.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

enum { TRAIN = 4, TEST = 5, SIDE = 100 }; // five test pictures show three views

static struct shot train[TRAIN], real[TEST], found[TEST];
static struct camera scene[TRAIN];
static char scene_names[TRAIN][NAME_CAP];
static struct job_result job;
static struct arena tmp;
static struct run r = {.tmp = &tmp};

static struct camera camera(int i)
{
    float a = 0.2f * (float)i;
    return (struct camera){
        SIDE, SIDE, 90, 90, 50, 50, {cosf(a), sinf(a), 0, 0}, {(float)i, (float)(i * i % 3), 0.5f}};
}

static int setup(void **state)
{
    static const char *const names[TEST] = {"test_0_0.png", "test_0_1.png", "test_1_0.png",
                                            "test_2_0.png", "test_2_1.png"};
    const struct similarity w = {0.25, {0.5, 0.5, -0.5, 0.5}, {3, 2, 1}};
    (void)state;
    for (int i = 0; i < TRAIN; i++) {
        train[i].cam = camera(i);
        scene[i] = similarity_apply(&w, &train[i].cam);
        snprintf(train[i].name, NAME_CAP, "train_%d.png", i);
        snprintf(scene_names[i], NAME_CAP, "train_%d.png", i);
    }
    for (int i = 0; i < TEST; i++) {
        int view = names[i][5] - '0';
        snprintf(found[i].name, NAME_CAP, "%s", names[i]);
        real[i] = found[i];
        real[i].cam = camera(TRAIN + view);
        found[i].cam = similarity_apply(&w, &real[i].cam);
    }
    job.scene.size = SIDE;
    job.scene.n_views = TRAIN;
    job.scene.cams = scene;
    job.scene.names = scene_names;
    return arena_init(&tmp, "tmp", pose_error_plan(TRAIN + TEST)) == OK ? 0 : -1;
}

static int teardown(void **state)
{
    (void)state;
    arena_free(&tmp);
    return 0;
}

static struct pose_error measure(void)
{
    struct pose_error e;
    const struct capture a = {TRAIN, train}, b = {TEST, real}, c = {TEST, found};
    assert_int_equal(testcams_measure(&r, &job, &a, &b, &c, &e), OK);
    assert_int_equal(e.n, 7);
    return e;
}

static void another_world_is_no_error(void **state)
{
    (void)state;
    struct pose_error e = measure();
    assert_true(e.rot_deg < 0.01 && e.trans < 1e-4 && e.focal < 1e-6);
}

/* Every camera turned about its own axis by 2 degrees, to and fro; half of the focal lengths. */
static void errors_are_those_of_the_cameras(void **state)
{
    (void)state;
    struct camera *cams[TRAIN + TEST];
    for (int i = 0; i < TRAIN + TEST; i++)
        cams[i] = i < TRAIN ? &scene[i] : &found[i - TRAIN].cam;
    for (int i = 0; i < TRAIN + TEST; i++) {
        float *q = cams[i]->q, a = (i % 2 ? -1.0f : 1.0f) * 0.01745329f, s = sinf(a), c = cosf(a);
        const float p[4] = {q[0], q[1], q[2], q[3]}, *t = cams[i]->t, u[3] = {t[0], t[1], t[2]};
        q[0] = c * p[0] - s * p[3]; // (c, 0, 0, s) q
        q[1] = c * p[1] - s * p[2];
        q[2] = c * p[2] + s * p[1];
        q[3] = c * p[3] + s * p[0];
        cams[i]->t[0] = cosf(2 * a) * u[0] - sinf(2 * a) * u[1]; // the centre stays
        cams[i]->t[1] = sinf(2 * a) * u[0] + cosf(2 * a) * u[1];
        cams[i]->fx *= 1.1f;
    }
    struct pose_error e = measure();
    assert_true(e.rot_deg > 1.5 && e.rot_deg < 2.5);
    assert_true(e.trans < 0.03);
    assert_true(fabs(e.focal - 0.1) < 1e-4);
    found[2].cam.t[0] += 100; // one is lost: medians do not mind
    e = measure();
    assert_true(e.rot_deg < 2.5);
    assert_true(e.trans > 0.05);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(another_world_is_no_error, setup, teardown),
        cmocka_unit_test_setup_teardown(errors_are_those_of_the_cameras, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
