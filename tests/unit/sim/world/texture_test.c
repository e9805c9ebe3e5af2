/* Every kind of texture: bounds, determinism, detail that fades with the footprint. */
#include "sim/world/texture.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

static struct texture sample(int kind, uint32_t seed)
{
    return (struct texture){
        .kind = (enum texture_kind)kind,
        .seed = seed,
        .scale = 0.3f,
        .contrast = 0.8f,
        .colour = {{0.7f, 0.6f, 0.5f}, {0.2f, 0.05f, 0.1f}, {0.1f, 0.3f, 0.6f}}};
}

/* Mean and variance of green over a wall of 6 x 6 m. */
static void moments(const struct texture *t, float footprint, double out[2])
{
    enum { SIDE = 90 };
    double sum = 0.0, square = 0.0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        const float p[3] = {0.0667f * (float)(i % SIDE) + 0.011f, 0.37f,
                            0.0667f * (float)(i / SIDE) + 0.017f};
        float c[3];
        texture_eval(t, p, (const float[]){0, 1, 0}, footprint, c);
        sum += (double)c[1];
        square += (double)c[1] * (double)c[1];
    }
    out[0] = sum / (SIDE * SIDE);
    out[1] = square / (SIDE * SIDE) - out[0] * out[0];
}

static void bounds(void **state)
{
    (void)state;
    static const float ODD[] = {0.0f,  -0.0f,  1e-30f,   -0.13f,    0.7f, 1e6f, -1e6f,
                                3e38f, -3e38f, INFINITY, -INFINITY, NAN,  1e4f, -9999.9f};
    enum { N = sizeof ODD / sizeof ODD[0] };
    for (int kind = 0; kind < TEXTURE_KINDS; kind++)
        for (int i = 0; i < N * N * N; i++) {
            struct texture t = sample(kind, (uint32_t)i * 7919u);
            t.scale = i % 5 == 0 ? ODD[i % N] : 0.01f * (float)(i % 100 + 1);
            t.contrast = i % 7 == 0 ? ODD[i / N % N] : 1.0f;
            const float p[3] = {ODD[i % N], ODD[i / N % N], ODD[i / N / N]};
            const float n[3] = {ODD[i / N / N], ODD[i % N], ODD[i / N % N]};
            float c[3];
            texture_eval(&t, p, n, ODD[(i + kind) % N], c);
            for (int k = 0; k < 3; k++)
                assert_true(c[k] >= 0.005f && c[k] <= 0.95f);
        }
}

static void colours_out_of_range(void **state)
{
    (void)state;
    for (int kind = 0; kind < TEXTURE_KINDS; kind++) {
        struct texture t = sample(kind, 5);
        for (int k = 0; k < 9; k++)
            t.colour[k / 3][k % 3] = k % 2 ? 40.0f : -NAN;
        float c[3];
        texture_eval(&t, (const float[]){0.2f, 0.3f, 0.4f}, (const float[]){0, 0, 1}, 0.01f, c);
        for (int k = 0; k < 3; k++)
            assert_true(c[k] >= 0.005f && c[k] <= 0.95f);
    }
}

/* An unknown kind is flat colour, which neither contrast nor place changes. */
static void flat_is_flat(void **state)
{
    (void)state;
    for (int kind = -1; kind <= TEXTURE_KINDS; kind += TEXTURE_KINDS + 1) {
        struct texture t = sample(kind, 9), plain = sample(TEXTURE_FLAT, 3);
        for (int i = 0; i < 50; i++) {
            const float p[3] = {0.1f * (float)i, -0.3f * (float)i, 1.0f};
            float a[3], b[3];
            texture_eval(&t, p, (const float[]){1, 0, 0}, 0.001f, a);
            texture_eval(&plain, p, (const float[]){0, 0, 1}, 1.0f, b);
            assert_memory_equal(a, b, sizeof a);
            assert_memory_equal(a, t.colour[0], sizeof a);
        }
    }
}

static void detail_fades(void **state)
{
    (void)state;
    for (int kind = 1; kind < TEXTURE_KINDS; kind++)
        for (uint32_t seed = 0; seed < 12; seed++) {
            struct texture t = sample(kind, seed);
            double fine[2], coarse[2];
            moments(&t, 0.002f, fine);
            moments(&t, 6.0f, coarse);
            assert_true(fine[1] > 3e-4);
            assert_true(coarse[1] < 1e-5);
            assert_true(fabs(coarse[0] - fine[0]) < 0.13); // what is left is about the mean
        }
}

/* Neighbours within a footprint differ little: no aliasing. */
static void smooth_at_footprint(void **state)
{
    (void)state;
    for (int kind = 1; kind < TEXTURE_KINDS; kind++) {
        double rough = 0.0;
        for (int i = 0; i < 4000; i++) {
            struct texture t = sample(kind, (uint32_t)i % 10);
            const float width = 0.05f, p[3] = {0.013f * (float)i, 0.2f, 0.0031f * (float)i};
            const float near[3] = {p[0] + 0.05f * width, p[1], p[2] + 0.05f * width};
            float a[3], b[3];
            texture_eval(&t, p, (const float[]){0, 1, 0}, width, a);
            texture_eval(&t, near, (const float[]){0, 1, 0}, width, b);
            rough += fabs((double)a[1] - (double)b[1]) / 4000;
        }
        assert_true(rough < 0.012);
    }
}

static void seeds_and_sides_differ(void **state)
{
    (void)state;
    for (int kind = 1; kind < TEXTURE_KINDS; kind++) {
        struct texture t = sample(kind, 1), other = sample(kind, 2);
        int seeds = 0, sides = 0;
        for (int i = 0; i < 200; i++) {
            const float p[3] = {0.037f * (float)i, 0.2f, 0.021f * (float)i};
            float a[3], again[3], b[3], c[3];
            texture_eval(&t, p, (const float[]){0, 1, 0}, 0.004f, a);
            texture_eval(&t, p, (const float[]){0, 1, 0}, 0.004f, again);
            texture_eval(&other, p, (const float[]){0, 1, 0}, 0.004f, b);
            texture_eval(&t, p, (const float[]){0, -1, 0}, 0.004f, c);
            assert_memory_equal(a, again, sizeof a);
            seeds += memcmp(a, b, sizeof a) != 0;
            sides += memcmp(a, c, sizeof a) != 0;
        }
        assert_true(seeds > 150);
        assert_true(kind == TEXTURE_NOISE ? sides == 0 : sides > 60); // noise is solid
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bounds),
        cmocka_unit_test(colours_out_of_range),
        cmocka_unit_test(flat_is_flat),
        cmocka_unit_test(detail_fades),
        cmocka_unit_test(smooth_at_footprint),
        cmocka_unit_test(seeds_and_sides_differ),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
