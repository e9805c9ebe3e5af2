/* A whole job on three threads, small enough for TSan: every step that uses the pool, with progress
 * and cancel as in the tool; the same bytes as on one thread. */
#include "core/base/gaussians.h"
#include "firmware/base/engine.h"
#include "firmware/recon/job.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIZE = 112, VIEWS = 3, STEPS = 10, CAP = 20000 };

/* A wavy pattern on a plane 3 units away, seen from places side by side at different exposures. */
static void photograph(int i, struct shot *s)
{
    double eye = 0.2 * (i - 1);
    memset(s, 0, sizeof *s);
    snprintf(s->name, sizeof s->name, "view_%d.png", i);
    s->exposure = i == 0 ? 0.25 : i == 1 ? 1 : 4;
    s->has_camera = true;
    s->cam = (struct camera){SIZE, SIZE, SIZE, SIZE, SIZE / 2, SIZE / 2, {1, 0, 0, 0}, {0, 0, 0}};
    s->cam.t[0] = (float)-eye;
    s->image = (struct image8){SIZE, SIZE, 3, malloc(SIZE * SIZE * 3)};
    assert_non_null(s->image.px);
    for (int k = 0; k < SIZE * SIZE * 3; k++) {
        double x = eye + 3 * ((k / 3 % SIZE + 0.5) / SIZE - 0.5);
        double y = 3 * ((k / 3 / SIZE + 0.5) / SIZE - 0.5);
        double wave = sin(9 * x + 4 * sin(5 * y)) * sin(7 * y + k % 3) * cos(23 * x - 17 * y);
        s->image.px[k] = (uint8_t)(255 * fmin(1, pow(s->exposure * exp2(2 * wave - 2), 1 / 2.2)));
    }
}

/* Planes of the scene one after another; returns their number of floats. */
static size_t run_job(const struct capture *c, int threads, float *out)
{
    static struct job_result result;
    const struct job_config cfg = {
        .size = SIZE, .refine = {.steps = STEPS, .degree_max = 1, .gaussians_max = CAP, .seed = 5}};
    struct engine engine;
    struct job_memory need;
    assert_int_equal(engine_open(&engine, threads), OK);
    assert_int_equal(job_plan(c, &cfg, threads, false, NULL, &need), OK);
    assert_int_equal(engine_reserve(&engine, need.pictures, need.keep, need.tmp, 1000), OK);
    assert_int_equal(job_run(&engine.run, c, &cfg, &result), OK);
    const struct gaussians *g = &result.scene.g;
    int planes = gaussians_planes(g->degree);
    assert_int_equal(result.refine.steps, STEPS);
    assert_in_range(g->n, 100, CAP);
    for (int p = 0; p < planes; p++)
        memcpy(out + (size_t)p * (size_t)g->n, g->plane[p], (size_t)g->n * sizeof *out);
    size_t n = (size_t)planes * (size_t)g->n;
    engine_close(&engine);
    return n;
}

static void three_threads_make_the_scene_of_one(void **state)
{
    (void)state;
    struct shot shots[VIEWS];
    struct capture c = {VIEWS, shots};
    size_t most = (size_t)gaussians_planes(1) * CAP * sizeof(float);
    float *one = malloc(most), *three = malloc(most);
    assert_true(one && three);
    for (int i = 0; i < VIEWS; i++)
        photograph(i, &shots[i]);
    size_t n = run_job(&c, 1, one);
    assert_int_equal(run_job(&c, 3, three), n);
    assert_memory_equal(one, three, n * sizeof *one);
    for (int i = 0; i < VIEWS; i++)
        free(shots[i].image.px);
    free(one);
    free(three);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(three_threads_make_the_scene_of_one)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
