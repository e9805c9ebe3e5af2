/* Similarities between worlds that hold the same cameras. */
#include "core/base/rotation.h"
#include "core/sfm/similarity.h"
#include "tests/unit/random_camera.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void scale_of_worlds(void **state)
{
    (void)state;
    struct arena tmp;
    struct camera a[6], b[6];
    float s;
    assert_int_equal(arena_init(&tmp, "tmp", similarity_plan(6)), OK);
    struct run r = {.tmp = &tmp};
    rng = 3;
    for (int i = 0; i < 6; i++) {
        a[i] = b[i] = random_camera();
        for (int k = 0; k < 3; k++)
            b[i].t[k] *= 2.5f;
    }
    assert_int_equal(similarity_scale(&r, a, b, 6, &s), OK);
    assert_float_equal(s, 2.5f, 1e-5f);
    b[5].t[0] += 100; // one camera is wrong
    assert_int_equal(similarity_scale(&r, a, b, 6, &s), OK);
    assert_true(s > 1.5f && s < 4.5f);
    for (int i = 0; i < 6; i++) { // they only turned
        memset(b[i].t, 0, sizeof b[i].t);
        memcpy(b[i].q, a[i].q, sizeof b[i].q);
    }
    assert_int_equal(similarity_scale(&r, a, b, 6, &s), OK);
    assert_float_equal(s, 1, 0);
    assert_int_equal(similarity_scale(&r, b, a, 6, &s), OK);
    assert_float_equal(s, 1, 0);
    a[0].t[0] = NAN;
    assert_int_equal(similarity_scale(&r, b, a, 2, &s), OK);
    assert_float_equal(s, 1, 0);
    assert_int_equal(similarity_scale(&r, a, b, 1, &s), OK);
    assert_float_equal(s, 1, 0);
    arena_free(&tmp);
}

/* One world is the other turned, moved and 2.5 times as large. */
static void a_world_is_found_again(void **state)
{
    (void)state;
    struct arena tmp;
    struct camera a[5], b[5], c;
    struct similarity w = {2.5, {0.5, -0.5, 0.5, 0.5}, {1, -2, 3}}, found;
    double x[3], y[3];
    assert_int_equal(arena_init(&tmp, "tmp", similarity_plan(5)), OK);
    struct run r = {.tmp = &tmp};
    rng = 9;
    for (int i = 0; i < 5; i++) {
        a[i] = random_camera();
        b[i] = similarity_apply(&w, &a[i]);
        for (int k = 0; k < 4 && i % 2; k++)
            b[i].q[k] = -b[i].q[k]; // the same rotation
    }
    rotation_centre(&a[0], x);
    rotation_centre(&b[0], y); // (x, y, z) -> (-y, z, -x) is this quaternion's rotation
    assert_float_equal((float)y[0], (float)(1 + 2.5 * -x[1]), 1e-4f);
    assert_float_equal((float)y[1], (float)(-2 + 2.5 * x[2]), 1e-4f);
    assert_float_equal((float)y[2], (float)(3 + 2.5 * -x[0]), 1e-4f);
    assert_int_equal(similarity_fit(&r, a, b, 5, &found), OK);
    assert_float_equal((float)found.scale, 2.5f, 1e-5f);
    for (int i = 0; i < 5; i++) {
        float p[9], q[9];
        c = similarity_apply(&found, &a[i]);
        rotation_from_unit(c.q, p);
        rotation_from_unit(b[i].q, q);
        for (int k = 0; k < 9; k++)
            assert_float_equal(p[k], q[k], 1e-5f);
        for (int k = 0; k < 3; k++)
            assert_float_equal(c.t[k], b[i].t[k], 1e-4f);
    }
    arena_free(&tmp);
}

/* Two cameras of nine are wrong. */
static void wrong_cameras_do_not_count(void **state)
{
    (void)state;
    struct arena tmp;
    struct camera a[9], b[9];
    struct similarity w = {1, {0.5, -0.5, 0.5, 0.5}, {1, -2, 3}}, found;
    assert_int_equal(arena_init(&tmp, "tmp", similarity_plan(9)), OK);
    struct run r = {.tmp = &tmp};
    rng = 11;
    for (int i = 0; i < 9; i++) {
        a[i] = random_camera();
        b[i] = similarity_apply(&w, &a[i]);
    }
    b[2] = b[5] = random_camera();
    b[5].t[1] += 20;
    assert_int_equal(similarity_fit(&r, a, b, 9, &found), OK);
    for (int i = 0; i < 9; i++) {
        const struct camera c = similarity_apply(&found, &a[i]);
        double x[3], y[3];
        rotation_centre(&c, x);
        rotation_centre(&b[i], y);
        for (int k = 0; k < 3 && i != 2 && i != 5; k++)
            assert_float_equal((float)x[k], (float)y[k], 0.01f);
    }
    arena_free(&tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scale_of_worlds),
        cmocka_unit_test(a_world_is_found_again),
        cmocka_unit_test(wrong_cameras_do_not_count),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
