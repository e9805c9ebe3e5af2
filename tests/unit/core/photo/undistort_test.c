/* A pattern of rays, photographed through every kind of lens and undistorted, is the pattern
 * through the pinhole. */
#include "core/base/num.h"
#include "core/base/splitmix.h"
#include "core/photo/undistort.h"
#include "tests/unit/expect.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { W = 320, H = 240, FINE = 4, REFERENCE = 8 };

static const struct {
    const char *name;
    enum lens_model model;
    double f, term[LENS_TERMS];
} lenses[] = {{"simple barrel", LENS_SIMPLE_RADIAL, 260, {-0.35}},
              {"simple cushion", LENS_SIMPLE_RADIAL, 260, {0.1}},
              {"radial", LENS_RADIAL, 240, {-0.28, 0.07}},
              {"opencv", LENS_OPENCV, 250, {-0.2, 0.03, 2e-3, -3e-3}},
              {"fisheye, 150 degrees", LENS_OPENCV_FISHEYE, 122, {0.02, -0.005, 0, 0}},
              {"pinhole", LENS_PINHOLE, 250, {0}}};
enum { LENSES = sizeof lenses / sizeof lenses[0] };

static struct lens lens_of(int i)
{
    struct lens l = {lenses[i].model, lenses[i].f, lenses[i].f, W / 2 + 6, H / 2 - 4, {0}, 0};
    memcpy(l.term, lenses[i].term, sizeof l.term);
    expect_ok(lens_init(&l));
    return l;
}

/* Display value of a ray, 28..228; waves of about nine pixels. */
static double pattern(const double ray[3], double f)
{
    const double x = atan2(ray[0], ray[2]) * f, y = atan2(ray[1], ray[2]) * f;
    return 128 + 100 * sin(0.7 * x) * sin(0.6 * y + 1);
}

static void photograph(const struct lens *l, struct image8 *out)
{
    for (int i = 0; i < W * H; i++) {
        double sum = 0, ray[3];
        for (int k = 0; k < FINE * FINE; k++) {
            const double p[2] = {i % W + (k % FINE + 0.5) / FINE, i / W + (k / FINE + 0.5) / FINE};
            if (lens_unproject(l, p, ray))
                sum += pattern(ray, l->fx) / (FINE * FINE);
        }
        for (int c = 0; c < 3; c++)
            out->px[3 * i + c] = (uint8_t)lrint(c == 1 ? 255 - sum : sum);
    }
}

static double through_pinhole(const struct camera *p, int x, int y, double f)
{
    double sum = 0;
    for (int k = 0; k < FINE * FINE; k++) {
        const double u = x + (k % FINE + 0.5) / FINE, v = y + (k / FINE + 0.5) / FINE;
        const double ray[3] = {(u - (double)p->cx) / (double)p->fx,
                               (v - (double)p->cy) / (double)p->fy, 1};
        sum += pattern(ray, f) / (FINE * FINE);
    }
    return sum;
}

static void pattern_through_the_pinhole(void **state)
{
    (void)state;
    static uint8_t px[3 * W * H];
    struct image8 photo = {W, H, 3, px};
    for (int i = 0; i < LENSES; i++) {
        const struct lens l = lens_of(i);
        struct camera p;
        photograph(&l, &photo);
        expect_ok(undistort_camera("test", &l, W, H, &p));
        uint8_t *out = malloc(3 * (size_t)p.w * (size_t)p.h);
        expect_ok(undistort_image8(NULL, &l, &photo, &p, out));
        double square = 0, worst = 0;
        for (int k = 0; k < p.w * p.h; k++) {
            const double want = through_pinhole(&p, k % p.w, k / p.w, l.fx);
            const double e = out[3 * k] - want;
            assert_true(abs(out[3 * k] + out[3 * k + 1] - 255) <= 1);
            square += e * e / (p.w * p.h);
            worst = fmax(worst, fabs(e));
        }
        const struct undistort_field field = undistort_field(&l, W, H, &p);
        print_message("  %s: %d x %d px, %.0f x %.0f of %.0f x %.0f degrees, rms %.2f, worst %.1f "
                      "of 255\n",
                      lenses[i].name, p.w, p.h, field.kept_deg[0], field.kept_deg[1],
                      field.given_deg[0], field.given_deg[1], sqrt(square), worst);
        assert_true(sqrt(square) < 2);
        if (l.model == LENS_PINHOLE)
            assert_memory_equal(out, px, sizeof px);
        free(out);
    }
}

/* All pixels have a source, and a slightly larger frame would have some without. */
static void crop(void **state)
{
    (void)state;
    for (int i = 0; i + 1 < LENSES; i++) {
        const struct lens l = lens_of(i);
        struct camera p;
        int outside[2] = {0, 0};
        expect_ok(undistort_camera("test", &l, W, H, &p));
        for (int larger = 0; larger < 2; larger++)
            for (int k = 0; k < (p.w + 1) * (p.h + 1); k++) {
                const double f = larger ? 0.98 : 1;
                const double ray[3] = {(k % (p.w + 1) - (double)p.cx) / (double)p.fx / f,
                                       (k / (p.w + 1) - (double)p.cy) / (double)p.fy / f, 1};
                double u[2];
                outside[larger] += !lens_project(&l, ray, u) || u[0] < -0.01 || u[1] < -0.01 ||
                                   u[0] > W + 0.01 || u[1] > H + 0.01;
            }
        assert_int_equal(outside[0], 0);
        if (i != 0 && l.model != LENS_OPENCV_FISHEYE) // stretched no further
            assert_true(outside[1] > 0);
    }
}

/* Where the photograph has more pixels than the picture, they are averaged. */
static void footprint(void **state)
{
    (void)state;
    static uint8_t px[3 * W * H];
    struct image8 photo = {W, H, 3, px};
    uint64_t rng = 3;
    for (int i = 0; i < 3 * W * H; i++)
        px[i] = (uint8_t)splitmix_next(&rng);
    struct lens l = {LENS_SIMPLE_RADIAL, 160, 160, W / 2, H / 2, {0.6}, 0};
    struct camera p;
    expect_ok(lens_init(&l));
    expect_ok(undistort_camera("test", &l, W, H, &p));
    uint8_t *out = malloc(3 * (size_t)p.w * (size_t)p.h);
    expect_ok(undistort_image8(NULL, &l, &photo, &p, out));
    double square[2] = {0, 0};
    for (int k = 0; k < p.w * p.h; k++) {
        double mean = 0, u[2];
        for (int s = 0; s < REFERENCE * REFERENCE; s++) {
            const double at[2] = {k % p.w + (s % REFERENCE + 0.5) / REFERENCE,
                                  k / p.w + (s / REFERENCE + 0.5) / REFERENCE};
            const double ray[3] = {(at[0] - (double)p.cx) / (double)p.fx,
                                   (at[1] - (double)p.cy) / (double)p.fy, 1};
            assert_true(lens_project(&l, ray, u));
            const int x = num_min((int)fmax(u[0], 0), W - 1),
                      y = num_min((int)fmax(u[1], 0), H - 1);
            mean += (double)px[3 * (y * W + x)] / (REFERENCE * REFERENCE);
        }
        square[0] += pow(out[3 * k] - mean, 2) / (p.w * p.h);
        square[1] += pow(mean - 127.5, 2) / (p.w * p.h);
    }
    print_message("  %d x %d px: noise of rms %.1f, off the mean of its pixels by %.1f\n", p.w, p.h,
                  sqrt(square[1]), sqrt(square[0]));
    assert_true(square[0] < 0.25 * square[1]);
    free(out);
}

static void radiance(void **state)
{
    (void)state;
    static float px[3 * W * H];
    struct image photo = {W, H, 3, px};
    const struct lens l = lens_of(0);
    struct camera p;
    for (int i = 0; i < 3 * W * H; i++)
        px[i] = i % W == W / 2 ? 1000 : (float)(i / (W * H)) + 0.5f; // a lamp on three colours
    expect_ok(undistort_camera("test", &l, W, H, &p));
    const size_t plane = (size_t)p.w * (size_t)p.h;
    float *out = malloc(3 * plane * sizeof *out);
    expect_ok(undistort_image(NULL, &l, &photo, &p, out));
    for (size_t i = 0; i < 3 * plane; i++) {
        const float low = (float)(i / plane) + 0.5f;
        assert_true(out[i] > low - 1e-4f && out[i] < 1000.1f);
        if (i % (size_t)p.w < (size_t)p.w / 4)
            assert_true(fabsf(out[i] - low) < 1e-4f);
    }
    free(out);
}

static void threads(void **state)
{
    (void)state;
    static uint8_t px[3 * W * H];
    struct image8 photo = {W, H, 3, px};
    const struct lens l = lens_of(3);
    struct camera p;
    struct pool *pool;
    photograph(&l, &photo);
    expect_ok(undistort_camera("test", &l, W, H, &p));
    const size_t bytes = 3 * (size_t)p.w * (size_t)p.h;
    uint8_t *one = malloc(bytes), *many = malloc(bytes);
    expect_ok(undistort_image8(NULL, &l, &photo, &p, one));
    expect_ok(pool_open(&pool, 5));
    expect_ok(undistort_image8(pool, &l, &photo, &p, many));
    pool_close(pool);
    assert_memory_equal(one, many, bytes);
    free(one);
    free(many);
}

static void extremes(void **state)
{
    (void)state;
    struct camera p;
    uint8_t in[3 * 200], out[3 * 800];
    memset(in, 77, sizeof in);
    struct lens narrow = {LENS_SIMPLE_RADIAL, 100, 100, 0.5, 100, {-0.2}, 0};
    expect_ok(lens_init(&narrow));
    expect_ok(undistort_camera("test", &narrow, 1, 200, &p)); // one column
    assert_true(p.w == 1 && p.h > 200 && p.h <= 400);
    expect_ok(undistort_image8(NULL, &narrow, &(struct image8){1, 200, 3, in}, &p, out));
    for (int i = 0; i < 3 * p.w * p.h; i++)
        assert_int_equal(out[i], 77);

    /* an image circle of 95 px in a frame of 320 x 240 */
    struct lens circle = {LENS_SIMPLE_RADIAL, 100, 100, W / 2, H / 2, {-0.165}, 0};
    const double edge[2] = {W / 2 + 96, H / 2}, within[2] = {W / 2 + 94, H / 2};
    double ray[3];
    expect_ok(lens_init(&circle));
    assert_true(lens_unproject(&circle, within, ray) && !lens_unproject(&circle, edge, ray));
    expect_ok(undistort_camera("test", &circle, W, H, &p));
    assert_true(hypot((double)p.w / (double)p.fx, (double)p.h / (double)p.fy) / 2 < circle.limit);

    struct lens wrong = {LENS_SIMPLE_RADIAL, 100, 100, -5, H / 2, {-0.1}, 0};
    expect_ok(lens_init(&wrong));
    expect_err(undistort_camera("a.png", &wrong, W, H, &p), ERR_FORMAT,
               "a.png: principal point -5, 120 outside");
    wrong.cx = W / 2;
    wrong.term[0] = -5000;
    expect_ok(lens_init(&wrong));
    expect_err(undistort_camera("a.png", &wrong, W, H, &p), ERR_FORMAT, "cannot be right");
}

/* The pinhole with the photograph's longer edge: its border has pixels, and one a little wider has
 * not, or stretches them; a barrel leaves the shorter edge shorter. */
static void frame_of_the_photograph(void **state)
{
    (void)state;
    for (int i = 0; i < LENSES; i++) {
        struct lens l = lens_of(i);
        int outside = 0;
        l.cx = W / 2 + (i == 1 ? 9 : 0);
        l.cy = H / 2 - (i == 1 ? 5 : 0);
        int size[2];
        const double f = undistort_frame(&l, W, H, size);
        assert_true(size[0] == W && size[1] <= H && size[1] > H / 2);
        if (l.model == LENS_RADIAL) // the stretch leaves room
            assert_true(size[1] < H);
        for (int k = 0; k < 4 * 32; k++) {
            const double x = k % 2 ? k / 128.0 : k / 2 % 2, y = k % 2 ? k / 2 % 2 : k / 128.0;
            const double ray[3] = {(x - 0.5) * size[0] / f, (y - 0.5) * size[1] / f, 1};
            const double wide[3] = {1.02 * ray[0], 1.02 * ray[1], 1};
            double px[2];
            assert_true(lens_project(&l, ray, px));
            assert_true(px[0] > -1 && px[0] < W + 1 && px[1] > -1 && px[1] < H + 1);
            outside +=
                !lens_project(&l, wide, px) || px[0] < 0 || px[0] > W || px[1] < 0 || px[1] > H;
        }
        if (l.model == LENS_PINHOLE)
            assert_true(fabs(f - l.fx) < 1e-5 * f);
        if (l.model != LENS_OPENCV_FISHEYE) // that is bound by the stretch
            assert_true(outside > 0);
    }
    const struct lens nothing = {LENS_SIMPLE_RADIAL, 100, 100, 0, 0, {0}, 0}; // no limit: no ray
    int size[2];
    assert_true(undistort_frame(&nothing, W, H, size) >= 0);
    assert_true(size[0] == W && size[1] >= 1 && size[1] <= H);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pattern_through_the_pinhole),
        cmocka_unit_test(crop),
        cmocka_unit_test(footprint),
        cmocka_unit_test(radiance),
        cmocka_unit_test(frame_of_the_photograph),
        cmocka_unit_test(threads),
        cmocka_unit_test(extremes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
