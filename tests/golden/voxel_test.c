/* Voxel fusion and Gaussian adapter against the golden set unit_voxel (the released code in
 * float32; core/splat/README.md 6). No point of the set is nearer than 5e-5 cell to a border. */
#include "core/splat/voxel.h"
#include "tests/golden/npy.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

enum { VIEWS = 3, PX = 32 * 32, N = VIEWS * PX, CELLS = 1526 };

static const float CELL = 0.08f;

static void *load(const char *name, size_t want)
{
    char path[64];
    size_t n;
    snprintf(path, sizeof path, "unit_voxel/%s.npy", name);
    void *p = npy_load(path, &n);
    assert_int_equal(n, want);
    return p;
}

/* Largest difference in units of |want| + mean |want|, which must stay below 1e-5: means of values
 * of both signs cancel, so that the error of a small one is that of its terms. */
struct worst {
    double diff, scale;
};

static struct worst worst_start(const float *want, size_t n)
{
    struct worst w = {0, 0};
    for (size_t i = 0; i < n; i++)
        w.scale += fabs((double)want[i]) / (double)n;
    return w;
}

static void worst_add(struct worst *w, double got, float want)
{
    double d = fabs(got - (double)want) / (fabs((double)want) + w->scale);
    w->diff = d <= w->diff ? w->diff : d; // takes NaN
}

static void worst_check(const struct worst *w, const char *what)
{
    print_message("  %-12s %.1e\n", what, w->diff);
    assert_true(w->diff < 1e-5);
}

struct fixture {
    struct arena keep, tmp;
    struct run r;
    float *points, *views, *features,
        *confidence; // features: (87, N), out of the views' (V, 87, PX)
    struct voxels v;
};

static void merge(struct fixture *f)
{
    memset(f, 0, sizeof *f);
    struct plan plan = plan_begin(1);
    voxel_plan(&plan, N);
    assert_int_equal(arena_init(&f->keep, "keep", plan.keep.peak), OK);
    assert_int_equal(arena_init(&f->tmp, "tmp", plan.tmp.peak), OK);
    f->r = (struct run){.keep = &f->keep, .tmp = &f->tmp};
    f->points = load("in.points", 3 * N);
    f->views = load("in.features87", VOXEL_FEATURES * N);
    f->confidence = load("in.confidence_logit", N);
    f->features = malloc(sizeof(float) * VOXEL_FEATURES * N);
    assert_non_null(f->features);
    for (size_t v = 0; v < VIEWS; v++)
        for (size_t c = 0; c < VOXEL_FEATURES; c++)
            memcpy(f->features + c * N + v * PX, f->views + (v * VOXEL_FEATURES + c) * PX,
                   sizeof(float) * PX);
    struct voxel_input in = {N, f->points, f->features, f->confidence};
    assert_int_equal(voxel_merge(&f->r, &in, CELL, &f->v), OK);
    assert_int_equal(f->v.n, CELLS);
}

static void free_fixture(struct fixture *f)
{
    free(f->points), free(f->views), free(f->features), free(f->confidence);
    arena_free(&f->keep);
    arena_free(&f->tmp);
}

static void test_merge(void **state)
{
    (void)state;
    static struct fixture f;
    merge(&f);
    int32_t *key = load("out.voxel_index", 3 * CELLS), *count = load("out.count", CELLS);
    float *points = load("out.points", 3 * CELLS);
    float *features = load("out.features87", VOXEL_FEATURES * CELLS);
    assert_memory_equal(f.v.key, key, sizeof(int32_t) * 3 * CELLS);
    assert_memory_equal(f.v.count, count, sizeof(int32_t) * CELLS);
    struct worst p = worst_start(points, 3 * CELLS);
    struct worst q = worst_start(features, VOXEL_FEATURES * CELLS);
    for (size_t i = 0; i < CELLS; i++) {
        for (size_t k = 0; k < 3; k++)
            worst_add(&p, (double)f.v.points[k * (size_t)f.v.cap + i], points[3 * i + k]);
        for (size_t k = 0; k < VOXEL_FEATURES; k++)
            worst_add(&q, (double)f.v.features[k * (size_t)f.v.cap + i],
                      features[VOXEL_FEATURES * i + k]);
    }
    worst_check(&p, "points");
    worst_check(&q, "features");
    free(key), free(count), free(points), free(features);
    free_fixture(&f);
}

static void test_adapt(void **state)
{
    (void)state;
    static struct fixture f;
    struct gaussians g;
    merge(&f);
    assert_int_equal(voxel_adapt(&f.r, &f.v, &g), OK);
    assert_int_equal(g.n, CELLS);
    assert_int_equal(g.degree, 4);
    float *opacity = load("out.opacities", CELLS), *scale = load("out.scales", 3 * CELLS);
    float *quat = load("out.rotations", 4 * CELLS), *sh = load("out.harmonics", 75 * CELLS);
    float *points = load("out.points", 3 * CELLS);
    struct worst p = worst_start(points, 3 * CELLS), o = worst_start(opacity, CELLS);
    struct worst s = worst_start(scale, 3 * CELLS), q = worst_start(quat, 4 * CELLS);
    struct worst h = worst_start(sh, 75 * CELLS);
    for (size_t i = 0; i < CELLS; i++) {
        worst_add(&o, 1 / (1 + exp(-(double)g.plane[G_LOGIT][i])), opacity[i]);
        for (size_t k = 0; k < 4; k++) // the set has x,y,z,w
            worst_add(&q, (double)g.plane[G_QUAT + (k + 1) % 4][i], quat[4 * i + k]);
        for (size_t k = 0; k < 3; k++) {
            worst_add(&p, (double)g.plane[G_MU + k][i], points[3 * i + k]);
            worst_add(&s, exp((double)g.plane[G_LOG_SCALE + k][i]), scale[3 * i + k]);
            for (size_t b = 0; b < 25; b++)
                worst_add(&h, (double)g.plane[G_SH + 3 * b + k][i], sh[75 * i + 25 * k + b]);
        }
    }
    worst_check(&p, "centres");
    worst_check(&o, "opacities");
    worst_check(&s, "scales");
    worst_check(&q, "quaternions");
    worst_check(&h, "harmonics");
    free(opacity), free(scale), free(quat), free(sh), free(points);
    free_fixture(&f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_merge),
        cmocka_unit_test(test_adapt),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
