/* The rasteriser against the double-precision reference, its gradients against finite differences of that
 * reference, and what it does at the extremes; on every instruction set of this machine. */
#include "core/splat/raster.h"

#include "core/base/cpu.h"
#include "tests/unit/raster_ref.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>

#include <cmocka.h>

enum { W = 40, H = 36, PX = W * H, NMAX = 6000 };

static const unsigned masks[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2, CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};
static uint32_t seed;

static double uniform(double lo, double hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (double)(seed >> 8) / 16777216.0;
}

struct rig {
    struct arena a;
    struct raster rs;
    struct gaussians g;
    struct kernels k;
    struct run r;
    struct camera cam;
    float bg[3], radiance[3 * PX], depth[PX], alpha[PX];
    struct ref_splat ref[NMAX];
};

static struct rig R;

static void rig_open(int cap, int degree, unsigned cpu)
{
    memset(&R, 0, sizeof R);
    assert_int_equal(arena_init(&R.a, "test", ((size_t)64 << 20) + raster_plan(cap, W, H, true)), OK);
    assert_int_equal(raster_init(&R.rs, &R.a, cap, W, H, true), OK);
    R.g.cap = (cap + 15) / 16 * 16;
    R.g.degree = degree;
    for (int p = 0; p < gaussians_planes(degree); p++)
        assert_int_equal(arena_zalloc(&R.a, (size_t)R.g.cap, 4, &R.g.plane[p]), OK);
    kernels_init(&R.k, cpu);
    R.r.k = &R.k;
    const double q[4] = {.96, .1, -.2, .12};
    double m[9];
    ref_rotation(q, m);
    R.cam = (struct camera){W, H, 44, 41, 19.3f, 17.1f, {0}, {.1f, -.2f, .3f}};
    double len = sqrt(.96 * .96 + .01 + .04 + .0144);
    for (int i = 0; i < 4; i++)
        R.cam.q[i] = (float)(q[i] / len);
    R.bg[0] = .7f;
    R.bg[1] = .2f;
    R.bg[2] = 1.3f;
}

static void rig_close(void)
{
    arena_free(&R.a);
}

/* Put a splat at camera coordinates x/z, y/z, z. */
static void place(int i, double x, double y, double z)
{
    float r[9], p[3] = {(float)(x * z), (float)(y * z), (float)z};
    raster_rotation(R.cam.q, r);
    for (int k = 0; k < 3; k++)
        R.g.plane[G_MU + k][i] = r[k] * (p[0] - R.cam.t[0]) + r[3 + k] * (p[1] - R.cam.t[1]) +
                                 r[6 + k] * (p[2] - R.cam.t[2]);
}

static void random_splat(int i, double log_scale)
{
    place(i, uniform(-.5, .5), uniform(-.5, .5), uniform(1, 4));
    for (int k = 0; k < 3; k++)
        R.g.plane[G_LOG_SCALE + k][i] = (float)(log_scale + uniform(-1, 1));
    for (int k = 0; k < 4; k++)
        R.g.plane[G_QUAT + k][i] = (float)uniform(-2, 2);
    R.g.plane[G_LOGIT][i] = (float)uniform(-2.5, -.5);
    for (int p = G_SH; p < gaussians_planes(R.g.degree); p++)
        R.g.plane[p][i] = (float)uniform(-1, 1) * (p < G_SH + 3 ? 3.0f : .4f);
}

static void random_scene(int n, double log_scale)
{
    R.g.n = n;
    for (int i = 0; i < n; i++)
        random_splat(i, log_scale);
}

static struct ref_camera ref_cam(void)
{
    struct ref_camera c = {.fx = (double)R.cam.fx, .fy = (double)R.cam.fy, .cx = (double)R.cam.cx,
                           .cy = (double)R.cam.cy, .w = R.cam.w, .h = R.cam.h};
    double q[4];
    for (int k = 0; k < 4; k++)
        q[k] = (double)R.cam.q[k];
    ref_rotation(q, c.r);
    for (int k = 0; k < 3; k++)
        c.t[k] = (double)R.cam.t[k];
    return c;
}

static void to_ref(void)
{
    for (int i = 0; i < R.g.n; i++)
        for (int p = 0; p < gaussians_planes(R.g.degree); p++)
            R.ref[i].p[p] = (double)R.g.plane[p][i];
}

static struct raster_input input(void)
{
    return (struct raster_input){&R.g, &R.cam, {R.bg[0], R.bg[1], R.bg[2]}};
}

static void draw(void)
{
    struct raster_input in = input();
    struct render out = {0, 0, R.radiance, R.depth, R.alpha};
    assert_int_equal(raster_run(&R.r, &R.rs, &in, &out), OK);
    assert_int_equal(out.w, W);
}

static double image_value(int px, int c)
{
    return c < 3 ? (double)R.radiance[c * PX + px] : c == 3 ? (double)R.depth[px] : (double)R.alpha[px];
}

/* Largest deviation from the reference relative to the largest value of the channel; a few pixels next to a
 * threshold (1/255, stop) may fall on its other side and are counted apart. */
static double deviation(int *flips)
{
    static double ref[PX * 5];
    struct ref_camera c = ref_cam();
    const double bg[3] = {(double)R.bg[0], (double)R.bg[1], (double)R.bg[2]};
    to_ref();
    ref_render(R.ref, R.g.n, R.g.degree, &c, bg, ref);
    double worst = 0;
    *flips = 0;
    for (int k = 0; k < 5; k++) {
        double top = 1e-30;
        for (int i = 0; i < PX; i++)
            top = fmax(top, fabs(ref[5 * i + k]));
        for (int i = 0; i < PX; i++) {
            double v = image_value(i, k), d = fabs(v - ref[5 * i + k]) / top;
            assert_true(isfinite(v));
            if (d > 1e-4 && d < 1.1 / 255)
                (*flips)++;
            else
                worst = fmax(worst, d);
        }
    }
    return worst;
}

static bool available(unsigned mask)
{
    return (cpu_detect() & mask) == mask;
}

static void test_equals_reference(void **state)
{
    (void)state;
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++)
        for (int degree = 0; degree <= 4; degree++) {
            if (!available(masks[m]))
                continue;
            seed = 7 + (uint32_t)degree;
            rig_open(300, degree, masks[m]);
            random_scene(300, -2.5);
            draw();
            int flips;
            double d = deviation(&flips);
            if (degree == 4)
                print_message("%s: deviation %.1e, %d threshold pixels\n", R.k.name, d, flips);
            assert_true(d < 5e-5);
            assert_true(flips < 40);
            rig_close();
        }
}

/* --- gradients --- */

static float w_rgb[3 * PX], w_depth[PX], w_alpha[PX];

static double ref_loss(const struct ref_camera *c, const double bg[3])
{
    static double ref[PX * 5];
    ref_render(R.ref, R.g.n, R.g.degree, c, bg, ref);
    double sum = 0;
    for (int i = 0; i < PX; i++) {
        for (int k = 0; k < 3; k++)
            sum += (double)w_rgb[k * PX + i] * ref[5 * i + k];
        sum += (double)w_depth[i] * ref[5 * i + 3] + (double)w_alpha[i] * ref[5 * i + 4];
    }
    return sum;
}

static float grads[G_PLANES_MAX][NMAX], seen_all[NMAX];

static void keep_grads(void *ctx, int first, int count, const float *grad, const float *seen)
{
    (void)ctx;
    for (int i = 0; i < count; i++) {
        seen_all[first + i] = seen[i];
        for (int p = 0; p < gaussians_planes(R.g.degree); p++)
            grads[p][first + i] = grad[p * SPLAT_BLOCK + i];
    }
}

static void backward(float pose[POSE_GRAD], float bg[3])
{
    struct raster_input in = input();
    struct render_grad up = {w_rgb, w_depth, w_alpha};
    struct raster_sink sink = {keep_grads, NULL, pose, bg};
    assert_int_equal(raster_grad_run(&R.r, &R.rs, &in, &up, &sink), OK);
}

struct group {
    const char *name;
    double num, den; // sums of squares: difference, reference
};

static void compare(struct group *g, double got, double want)
{
    g->num += (got - want) * (got - want);
    g->den += want * want;
}

static double richardson(double *x, double h, const struct ref_camera *c, const double bg[3])
{
    double x0 = *x, d[2];
    for (int i = 0; i < 2; i++) {
        double s = i ? h / 2 : h;
        *x = x0 + s;
        double a = ref_loss(c, bg);
        *x = x0 - s;
        d[i] = (a - ref_loss(c, bg)) / (2 * s);
    }
    *x = x0;
    return (4 * d[1] - d[0]) / 3;
}

static void random_weights(void)
{
    for (int i = 0; i < PX; i++) {
        for (int k = 0; k < 3; k++)
            w_rgb[k * PX + i] = (float)uniform(-1, 1);
        w_depth[i] = (float)uniform(-.3, .3);
        w_alpha[i] = (float)uniform(-1, 1);
    }
}

static void check_groups(const struct group *g, int n, double bound, const char *what)
{
    for (int i = 0; i < n; i++) {
        double rel = sqrt(g[i].num / (g[i].den + 1e-30));
        print_message("  %s %-10s relative difference %.1e\n", what, g[i].name, rel);
        assert_true(rel < bound || g[i].num < 1e-14);
    }
}

static void check_gradients(double bound, const char *what)
{
    struct ref_camera c = ref_cam();
    double bg[3] = {(double)R.bg[0], (double)R.bg[1], (double)R.bg[2]};
    float pose[POSE_GRAD], bg_grad[3];
    draw();
    random_weights();
    backward(pose, bg_grad);
    to_ref();
    struct group g[] = {{"mean", 0, 0}, {"scale", 0, 0}, {"rotation", 0, 0}, {"opacity", 0, 0},
                        {"sh", 0, 0},   {"pose", 0, 0},  {"focal", 0, 0},    {"background", 0, 0}};
    for (int i = 0; i < R.g.n; i++)
        for (int p = 0; p < gaussians_planes(R.g.degree); p++) {
            int k = p < 3 ? 0 : p < 6 ? 1 : p < 10 ? 2 : p < 11 ? 3 : 4;
            double h = 1e-6 * fmax(1e-3, fmin(1, fabs(R.ref[i].p[p])));
            compare(&g[k], (double)grads[p][i], richardson(&R.ref[i].p[p], h, &c, bg));
        }
    for (int k = 0; k < 12; k++)
        compare(&g[5], (double)pose[k], richardson(k < 9 ? &c.r[k] : &c.t[k - 9], 1e-6, &c, bg));
    double *intr[4] = {&c.fx, &c.fy, &c.cx, &c.cy};
    for (int k = 0; k < 4; k++)
        compare(&g[6], (double)pose[12 + k], richardson(intr[k], 1e-5, &c, bg));
    for (int k = 0; k < 3; k++)
        compare(&g[7], (double)bg_grad[k], richardson(&bg[k], 1e-5, &c, bg));
    check_groups(g, 8, bound, what);
}

static void test_gradients(void **state)
{
    (void)state;
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++) {
        if (!available(masks[m]))
            continue;
        rig_open(40, 4, masks[m]);
        seed = 3;
        random_scene(40, -2);
        check_gradients(2e-4, R.k.name);
        rig_close();
    }
}

/* Splats beyond the field of view, where the Jacobian's clamp is active, and large near ones. */
static void test_gradients_clamped(void **state)
{
    (void)state;
    rig_open(12, 1, cpu_detect());
    seed = 5;
    random_scene(12, -1);
    for (int i = 0; i < 12; i++)
        place(i, (i & 1 ? 1 : -1) * (.75 + .02 * i), i & 2 ? .8 : -.1, .6 + .1 * i);
    check_gradients(5e-4, "clamped");
    rig_close();
}

static void test_gradients_thin(void **state)
{
    (void)state;
    rig_open(10, 0, cpu_detect());
    seed = 11;
    random_scene(10, -2);
    for (int i = 0; i < 10; i++) { // needles and plates
        R.g.plane[G_LOG_SCALE][i] = i & 1 ? -18.4f : -1.0f;
        R.g.plane[G_LOG_SCALE + 1][i] = -18.4f;
    }
    check_gradients(5e-4, "thin");
    rig_close();
}

/* --- extremes --- */

static void assert_all_finite(void)
{
    for (int i = 0; i < PX; i++)
        for (int k = 0; k < 5; k++)
            assert_true(isfinite(image_value(i, k)));
    for (int i = 0; i < R.g.n; i++)
        for (int p = 0; p < gaussians_planes(R.g.degree); p++)
            assert_true(isfinite(grads[p][i]));
}

static void each_isa(void (*scene)(void), const char *what, double bound)
{
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++) {
        if (!available(masks[m]))
            continue;
        float pose[POSE_GRAD], bg[3];
        rig_open(NMAX, 2, masks[m]);
        seed = 21;
        scene();
        draw();
        int flips;
        double d = deviation(&flips);
        print_message("  %s, %s: deviation %.1e, %d threshold pixels\n", what, R.k.name, d, flips);
        assert_true(d < bound);
        random_weights();
        backward(pose, bg);
        assert_all_finite();
        for (int k = 0; k < POSE_GRAD; k++)
            assert_true(isfinite(pose[k]));
        rig_close();
    }
}

static void scene_nan(void)
{
    random_scene(200, -2.5);
    for (int i = 0; i < 60; i++)
        R.g.plane[i % gaussians_planes(2)][i * 3] = i % 3 == 0 ? NAN : i % 3 == 1 ? INFINITY : -INFINITY;
}

static void near_splats(const double z[3])
{
    random_scene(300, -2.5);
    for (int i = 0; i < 150; i++) {
        double x = uniform(-1, 1), y = uniform(-1, 1), s = i % 2 ? 1 / fmax(fabs(z[i % 3]), 1e-3) : 1;
        place(i, x * s, y * s, z[i % 3] * (1 + .02 * i)); // distinct depths: order must not hang on rounding
    }
}

static void scene_grazing(void)
{
    near_splats((const double[3]){-1, 1e-3, 1e-2});
}

/* Which of these are in front of the camera is below the rounding of their float positions. */
static void scene_on_plane(void)
{
    near_splats((const double[3]){0, 1e-9, -1e-9});
}

static void scene_scales(void)
{
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        for (int k = 0; k < 3; k++)
            R.g.plane[G_LOG_SCALE + k][i] = (float)log((i + k) % 3 == 0 ? 1e-8 : (i + k) % 3 == 1 ? 1e3 : 1e-2);
}

static void scene_opacity(void)
{
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        R.g.plane[G_LOGIT][i] = i % 4 == 0 ? 30.0f : i % 4 == 1 ? -30.0f : i % 4 == 2 ? 80.0f : 0.0f;
}

static void scene_radiance(void)
{
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        for (int k = 0; k < 3; k++)
            R.g.plane[G_SH + k][i] = i % 3 == 0 ? 400.0f : i % 3 == 1 ? -400.0f : 40.0f;
}

static void scene_crowd(void)
{
    R.g.n = NMAX;
    for (int i = 0; i < NMAX; i++) {
        random_splat(i, -4);
        place(i, .01, .02, uniform(1, 4));
        R.g.plane[G_LOGIT][i] = -5.0f;
    }
}

static void scene_rotations(void)
{
    random_scene(100, -2.5);
    for (int i = 0; i < 100; i++)
        for (int k = 0; k < 4; k++)
            R.g.plane[G_QUAT + k][i] *= i % 3 == 0 ? 0.0f : i % 3 == 1 ? 1e-25f : 1e18f;
}

static void test_extremes(void **state)
{
    (void)state;
    each_isa(scene_nan, "NaN and infinity", 1e-4);
    each_isa(scene_grazing, "behind and grazing the camera", 2e-3);
    each_isa(scene_on_plane, "on the camera plane (finite only)", INFINITY);
    each_isa(scene_scales, "scales 1e-8 and 1e3", 2e-3);
    each_isa(scene_opacity, "opacity 0 and 1", 1e-4);
    each_isa(scene_radiance, "radiance e^+-113", 1e-4);
    each_isa(scene_crowd, "6000 on one pixel", 1e-3);
    each_isa(scene_rotations, "degenerate rotations", 1e-4);
}

/* Lists that do not fit the planned memory: the picture is made in groups and must not change by a bit. */
static void test_groups(void **state)
{
    (void)state;
    static float once[3 * PX], g_once[G_PLANES_MAX][NMAX];
    float pose[POSE_GRAD], pose_once[POSE_GRAD], bg[3];
    rig_open(500, 1, cpu_detect());
    seed = 9;
    random_scene(500, -.5);
    draw();
    random_weights();
    backward(pose_once, bg);
    assert_int_equal(R.rs.n_groups, 1);
    memcpy(once, R.radiance, sizeof once);
    memcpy(g_once, grads, sizeof grads);
    R.rs.cap_places = 600;
    draw();
    backward(pose, bg);
    assert_true(R.rs.n_groups > 3);
    assert_memory_equal(once, R.radiance, sizeof once);
    for (int p = 0; p < gaussians_planes(1); p++)
        for (int i = 0; i < 500; i++)
            assert_true(fabsf(grads[p][i] - g_once[p][i]) <= 1e-4f * fabsf(g_once[p][i]) + 1e-4f);
    rig_close();
}

static void test_threads_same_bytes(void **state)
{
    (void)state;
    static float once[3 * PX], g_once[G_PLANES_MAX][NMAX];
    for (int threads = 1; threads <= 7; threads += 3) {
        float pose[POSE_GRAD], bg[3];
        rig_open(3000, 1, cpu_detect());
        assert_int_equal(pool_open(&R.r.pool, threads), OK);
        seed = 13;
        random_scene(3000, -3);
        draw();
        random_weights();
        backward(pose, bg);
        if (threads == 1) {
            memcpy(once, R.radiance, sizeof once);
            memcpy(g_once, grads, sizeof grads);
        }
        assert_memory_equal(once, R.radiance, sizeof once);
        assert_memory_equal(g_once, grads, sizeof grads);
        pool_close(R.r.pool);
        rig_close();
    }
}

static void test_refuses(void **state)
{
    (void)state;
    rig_open(10, 0, 0);
    random_scene(10, -2);
    struct raster_input in = input();
    struct render out = {0, 0, R.radiance, R.depth, R.alpha};
    R.cam.fx = NAN;
    assert_int_equal(raster_run(&R.r, &R.rs, &in, &out), ERR_ARG);
    R.cam.fx = 40;
    R.cam.w = 4000;
    assert_int_equal(raster_run(&R.r, &R.rs, &in, &out), ERR_ARG);
    R.cam.w = W;
    R.g.n = 11;
    assert_int_equal(raster_run(&R.r, &R.rs, &in, &out), ERR_ARG);
    R.g.n = 0;
    draw(); // no splat at all: background
    assert_float_equal(R.radiance[5], R.bg[0], 0);
    rig_close();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_equals_reference), cmocka_unit_test(test_gradients),
        cmocka_unit_test(test_gradients_clamped), cmocka_unit_test(test_gradients_thin),
        cmocka_unit_test(test_extremes),         cmocka_unit_test(test_groups),
        cmocka_unit_test(test_threads_same_bytes), cmocka_unit_test(test_refuses)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
