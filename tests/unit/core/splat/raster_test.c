/* The rasteriser against the double-precision reference, its gradients against finite differences
 * of that reference, and what it does at the extremes; on every instruction set of this machine. */
#include "core/splat/raster.h"

#include "core/base/cpu.h"
#include "core/base/rotation.h"
#include "tests/unit/core/splat/raster_ref.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>

#include <cmocka.h>

enum { W = 40, H = 36, PX = W * H, NMAX = 6000 };

static const unsigned masks[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2,
                                 CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};
enum { N_MASKS = sizeof masks / sizeof *masks };
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
};

static struct rig R;

/* Number of the next instruction set that this machine has, N_MASKS after the last; -1 starts. */
static int next_isa(int m)
{
    unsigned have = cpu_detect();
    do
        m++;
    while (m < N_MASKS && (masks[m] & have) != masks[m]);
    return m;
}

static void rig_open(int cap, int degree, unsigned cpu)
{
    memset(&R, 0, sizeof R);
    assert_int_equal(arena_init(&R.a, "test", ((size_t)64 << 20) + raster_plan(cap, W, H, true)),
                     OK);
    assert_int_equal(raster_init(&R.rs, &R.a, cap, W, H, true), OK);
    R.g.cap = (cap + 15) / 16 * 16;
    R.g.degree = degree;
    for (int p = 0; p < gaussians_planes(degree); p++)
        assert_int_equal(arena_zalloc(&R.a, (size_t)R.g.cap, 4, &R.g.plane[p]), OK);
    kernels_init(&R.k, cpu);
    R.r.k = &R.k;
    R.cam = (struct camera){W, H, 44, 41, 19.3f, 17.1f, {0}, {.1f, -.2f, .3f}};
    const double q[4] = {.96, .1, -.2, .12}, len = sqrt(.96 * .96 + .01 + .04 + .0144);
    for (int i = 0; i < 4; i++)
        R.cam.q[i] = (float)(q[i] / len);
    memcpy(R.bg, (float[]){.7f, .2f, 1.3f}, sizeof R.bg);
}

static void rig_close(void)
{
    arena_free(&R.a);
}

/* Put a splat at camera coordinates x/z, y/z, z. */
static void place_splat(int i, double x, double y, double z)
{
    float r[9], p[3] = {(float)(x * z), (float)(y * z), (float)z};
    rotation_from_unit(R.cam.q, r);
    for (int k = 0; k < 3; k++)
        R.g.plane[G_MU + k][i] = r[k] * (p[0] - R.cam.t[0]) + r[3 + k] * (p[1] - R.cam.t[1]) +
                                 r[6 + k] * (p[2] - R.cam.t[2]);
}

static void random_splat(int i, double log_scale)
{
    place_splat(i, uniform(-.5, .5), uniform(-.5, .5), uniform(1, 4));
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

/* --- the reference of the scene in R --- */

static struct {
    struct ref_splat splat[NMAX];
    struct ref_camera cam;
    double bg[3], picture[PX * 5];
} ref;

static void ref_picture(void)
{
    ref_render(ref.splat, R.g.n, R.g.degree, &ref.cam, ref.bg, ref.picture);
}

static void ref_take(void)
{
    ref.cam = ref_camera_of(&R.cam, (double)RASTER_REACH);
    for (int k = 0; k < 3; k++)
        ref.bg[k] = (double)R.bg[k];
    ref_splats_of(&R.g, ref.splat);
    ref_picture();
}

static double image_value(int px, int c)
{
    if (c < 3)
        return (double)R.radiance[c * PX + px];
    return (double)(c == 3 ? R.depth[px] : R.alpha[px]);
}

/* Largest deviation from the reference relative to the largest value of the channel; a few pixels
 * next to a threshold (1/255, stop) may fall on its other side and are counted apart. */
static double deviation(int *flips)
{
    double worst = 0;
    *flips = 0;
    for (int k = 0; k < 5; k++) {
        double top = 1e-30;
        for (int i = 0; i < PX; i++)
            top = fmax(top, fabs(ref.picture[5 * i + k]));
        for (int i = 0; i < PX; i++) {
            double v = image_value(i, k), d = fabs(v - ref.picture[5 * i + k]) / top;
            assert_true(isfinite(v));
            if (d > 1e-4 && d < 1.1 / 255)
                (*flips)++;
            else
                worst = fmax(worst, d);
        }
    }
    return worst;
}

static void equals_reference(int degree)
{
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m)) {
        seed = 7 + (uint32_t)degree;
        rig_open(300, degree, masks[m]);
        random_scene(300, -2.5);
        if (m == 0)
            ref_take();
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

static void test_equals_reference(void **state)
{
    (void)state;
    for (int degree = 0; degree <= 4; degree++)
        equals_reference(degree);
}

/* --- gradients --- */

static float w_rgb[3 * PX], w_depth[PX], w_alpha[PX];

static double ref_loss(void)
{
    ref_picture();
    double sum = 0;
    for (int i = 0; i < PX; i++) {
        const double *px = ref.picture + (ptrdiff_t)5 * i;
        for (int k = 0; k < 3; k++)
            sum += (double)w_rgb[k * PX + i] * px[k];
        sum += (double)w_depth[i] * px[3] + (double)w_alpha[i] * px[4];
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

static void random_weights(void)
{
    for (int i = 0; i < PX; i++) {
        for (int k = 0; k < 3; k++)
            w_rgb[k * PX + i] = (float)uniform(-1, 1);
        w_depth[i] = (float)uniform(-.3, .3);
        w_alpha[i] = (float)uniform(-1, 1);
    }
}

/* The step is so small that hardly ever a pixel crosses a threshold within it. */
static double derivative(double *x)
{
    const double x0 = *x, h = 1e-7;
    *x = x0 + h;
    double above = ref_loss();
    *x = x0 - h;
    double below = ref_loss();
    *x = x0;
    return (above - below) / (2 * h);
}

enum { MEAN, SCALE, ROTATION, OPACITY, SH, POSE, FOCAL, BACKGROUND, N_GROUPS };
static const char *const group_names[] = {"mean", "scale", "rotation", "opacity",
                                          "sh",   "pose",  "focal",    "background"};

static int group_of(int plane)
{
    return plane < 3 ? MEAN : plane < 6 ? SCALE : plane < 10 ? ROTATION : plane < 11 ? OPACITY : SH;
}

/* Each splat checks a third of the harmonics, so that a third of the splats checks each one. */
static bool is_checked(int splat, int plane)
{
    return group_of(plane) != SH || (splat + plane) % 3 == 0;
}

/* The derivatives of the scene in `ref`, found once for all instruction sets. */
enum { N_GRAD = 40 };
static double want[N_GRAD][G_PLANES_MAX], want_pose[POSE_GRAD], want_bg[3];

static void ref_gradients(void)
{
    for (int i = 0; i < R.g.n; i++)
        for (int p = 0; p < gaussians_planes(R.g.degree); p++)
            want[i][p] = is_checked(i, p) ? derivative(&ref.splat[i].p[p]) : 0;
    double *pose[POSE_GRAD] = {[12] = &ref.cam.fx, &ref.cam.fy, &ref.cam.cx, &ref.cam.cy};
    for (int k = 0; k < 12; k++)
        pose[k] = k < 9 ? &ref.cam.r[k] : &ref.cam.t[k - 9];
    for (int k = 0; k < POSE_GRAD; k++)
        want_pose[k] = derivative(pose[k]);
    for (int k = 0; k < 3; k++)
        want_bg[k] = derivative(&ref.bg[k]);
}

struct group {
    double num, den; // sums of squares: difference, reference
};

static void compare(struct group *g, float got, double wanted)
{
    g->num += ((double)got - wanted) * ((double)got - wanted);
    g->den += wanted * wanted;
}

static void check_gradients(double bound, const char *what)
{
    float pose[POSE_GRAD], bg[3];
    struct group g[N_GROUPS] = {0};
    draw();
    backward(pose, bg);
    for (int i = 0; i < R.g.n; i++)
        for (int p = 0; p < gaussians_planes(R.g.degree); p++)
            if (is_checked(i, p))
                compare(&g[group_of(p)], grads[p][i], want[i][p]);
    for (int k = 0; k < POSE_GRAD; k++)
        compare(&g[k < 12 ? POSE : FOCAL], pose[k], want_pose[k]);
    for (int k = 0; k < 3; k++)
        compare(&g[BACKGROUND], bg[k], want_bg[k]);
    for (int k = 0; k < N_GROUPS; k++) {
        double rel = sqrt(g[k].num / (g[k].den + 1e-30));
        print_message("  %s, %s: %-10s relative difference %.1e\n", what, R.k.name, group_names[k],
                      rel);
        assert_true(rel < bound || g[k].num < 1e-14);
    }
}

static void each_isa_gradients(void (*scene)(void), int degree, double bound, const char *what)
{
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m)) {
        rig_open(N_GRAD, degree, masks[m]);
        seed = 3;
        scene();
        if (m == 0) {
            random_weights();
            ref_take();
            ref_gradients();
        }
        check_gradients(bound, what);
        rig_close();
    }
}

static void scene_small(void)
{
    random_scene(N_GRAD, -2);
}

/* Splats beyond the field of view, where the Jacobian's clamp is active, and large near ones. */
static void scene_clamped(void)
{
    random_scene(12, -1);
    for (int i = 0; i < 12; i++)
        place_splat(i, (i & 1 ? 1 : -1) * (.75 + .02 * i), i & 2 ? .8 : -.1, 1.6 + .1 * i);
}

static void scene_thin(void)
{
    random_scene(10, -2);
    for (int i = 0; i < 10; i++) { // needles and plates
        R.g.plane[G_LOG_SCALE][i] = i & 1 ? -18.4f : -1.0f;
        R.g.plane[G_LOG_SCALE + 1][i] = -18.4f;
    }
}

static void test_gradients(void **state)
{
    (void)state;
    each_isa_gradients(scene_small, 4, 5e-5, "random");
    each_isa_gradients(scene_clamped, 1, 5e-5, "clamped");
    each_isa_gradients(scene_thin, 0, 5e-5, "thin");
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
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m)) {
        float pose[POSE_GRAD], bg[3];
        rig_open(NMAX, 2, masks[m]);
        seed = 21;
        scene();
        if (m == 0) {
            random_weights();
            ref_take();
        }
        draw();
        int flips;
        double d = deviation(&flips);
        print_message("  %s, %s: deviation %.1e, %d threshold pixels\n", what, R.k.name, d, flips);
        assert_true(d < bound);
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
    const float bad[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 60; i++)
        R.g.plane[i % gaussians_planes(2)][i * 3] = bad[i % 3];
}

static void near_splats(const double z[3])
{
    random_scene(300, -2.5);
    for (int i = 0; i < 150; i++) {
        double x = uniform(-1, 1), y = uniform(-1, 1), zi = z[i % 3];
        double s = i % 2 ? 1 / fmax(fabs(zi), 1e-3) : 1;
        place_splat(i, x * s, y * s, zi * (1 + .02 * i)); // order must not hang on rounding
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
    const float scales[] = {-18.42f, 6.91f, -4.61f}; // ln 1e-8, 1e3, 1e-2
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        for (int k = 0; k < 3; k++)
            R.g.plane[G_LOG_SCALE + k][i] = scales[(i + k) % 3];
}

static void scene_opacity(void)
{
    const float logits[] = {30, -30, 80, 0};
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        R.g.plane[G_LOGIT][i] = logits[i % 4];
}

static void scene_radiance(void)
{
    const float sh[] = {400, -400, 40};
    random_scene(200, -2.5);
    for (int i = 0; i < 200; i++)
        for (int k = 0; k < 3; k++)
            R.g.plane[G_SH + k][i] = sh[i % 3];
}

static void scene_crowd(void)
{
    R.g.n = NMAX;
    for (int i = 0; i < NMAX; i++) {
        random_splat(i, -4);
        place_splat(i, .01, .02, uniform(1, 4));
        R.g.plane[G_LOGIT][i] = -5.0f;
    }
}

static void scene_rotations(void)
{
    const float factors[] = {0, 1e-25f, 1e18f};
    random_scene(100, -2.5);
    for (int i = 0; i < 100; i++)
        for (int k = 0; k < 4; k++)
            R.g.plane[G_QUAT + k][i] *= factors[i % 3];
}

/* A splat whose deviation along the view is a third of its depth is the largest that is drawn; one
 * beside the picture that reaches behind the camera would be a fog all over it. */
static void test_behind(void **state)
{
    (void)state;
    const struct {
        double x, z, deviation;
        bool drawn;
    } cases[] = {{0, 1, .33, true}, {0, 1, .34, false}, {1.07, .0081, .0475, false}};
    for (int k = 0; k < 3; k++) {
        rig_open(1, 0, cpu_detect());
        random_scene(1, 0);
        place_splat(0, cases[k].x, 0, cases[k].z);
        for (int i = 0; i < 3; i++)
            R.g.plane[G_LOG_SCALE + i][0] = (float)log(cases[k].deviation);
        R.g.plane[G_LOGIT][0] = 3;
        draw();
        assert_int_equal(R.alpha[PX / 2] > 0, cases[k].drawn);
        rig_close();
    }
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

/* A splat is hidden where a distinctly nearer one lets less than a tenth of it through; its
 * gradient is that of the picture all the same. */
static void test_hidden(void **state)
{
    (void)state;
    const struct {
        double x, z; // of a small splat
        float front; // logit of a large one at x = 0, z = 1
        float seen;
    } cases[] = {
        {0, 2, 6, 0},  {0, 1.05, 6, 1}, {.45, 2, 6, 1},
        {0, 2, -1, 1}, {0, .5, 6, 1},   {0, 2, 1.6f, 1},
    };
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m))
        for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
            float pose[POSE_GRAD], bg[3];
            rig_open(2, 0, masks[m]);
            random_scene(2, 0);
            place_splat(0, 0, 0, 1);
            place_splat(1, cases[k].x, 0, cases[k].z);
            for (int i = 0; i < 3; i++) {
                R.g.plane[G_LOG_SCALE + i][0] = (float)log(.2);
                R.g.plane[G_LOG_SCALE + i][1] = (float)log(.02);
            }
            R.g.plane[G_LOGIT][0] = cases[k].front;
            R.g.plane[G_LOGIT][1] = 2;
            draw();
            random_weights();
            backward(pose, bg);
            assert_true(seen_all[0] == 1 && seen_all[1] == cases[k].seen);
            assert_true(grads[G_SH][1] != 0);
            rig_close();
        }
}

/* Lists that do not fit the planned memory: the picture is made in groups and keeps every bit. */
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
    R.rs.cap_pairs = 600;
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
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_equals_reference),
                                       cmocka_unit_test(test_gradients),
                                       cmocka_unit_test(test_behind),
                                       cmocka_unit_test(test_hidden),
                                       cmocka_unit_test(test_extremes),
                                       cmocka_unit_test(test_groups),
                                       cmocka_unit_test(test_threads_same_bytes),
                                       cmocka_unit_test(test_refuses)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
