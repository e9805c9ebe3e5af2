/* The rasteriser and the tone curve against the golden sets unit_render and unit_tonemap (gsplat
 * 1.4.0 and the released tone mapper, see core/splat/README.md 2 and 3 and
 * core/photo/README.md 2.1). */
#include "core/base/cpu.h"
#include "core/photo/tonemap.h"
#include "core/splat/raster.h"
#include "tests/golden/npy.h"
#include "tests/unit/core/splat/raster_ref.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>

#include <cmocka.h>

enum { N = 500, S = 64, PX = S * S };

static float *load(const char *name, size_t want)
{
    size_t n;
    float *p = npy_load(name, &n);
    assert_int_equal(n, want);
    return p;
}

static void set_camera(struct camera *c, const float *w2c, const float *k)
{
    /* quaternion of the rotation; the golden pose has a positive trace */
    float w = 0.5f * sqrtf(1 + w2c[0] + w2c[5] + w2c[10]);
    assert_true(w > 0.1f);
    *c = (struct camera){
        S,
        S,
        k[0],
        k[4],
        k[2],
        k[5],
        {w, (w2c[9] - w2c[6]) / (4 * w), (w2c[2] - w2c[8]) / (4 * w), (w2c[4] - w2c[1]) / (4 * w)},
        {w2c[3], w2c[7], w2c[11]}};
}

struct fixture {
    struct arena a;
    struct raster rs;
    struct gaussians g;
    struct camera cam;
    struct kernels k;
    struct run r;
    float radiance[3 * PX], depth[PX], alpha[PX];
};

static void open_fixture(struct fixture *f, unsigned cpu)
{
    memset(f, 0, sizeof *f);
    assert_int_equal(arena_init(&f->a, "golden", raster_plan(N, S, S, false) + (1 << 22)), OK);
    assert_int_equal(raster_init(&f->rs, &f->a, N, S, S, false), OK);
    f->g = (struct gaussians){.n = N, .cap = 512, .degree = 4};
    for (int p = 0; p < gaussians_planes(4); p++)
        assert_int_equal(arena_zalloc(&f->a, 512, 4, &f->g.plane[p]), OK);
    float *mu = load("unit_render/in.means.npy", 3 * N),
          *s = load("unit_render/in.scales.npy", 3 * N);
    float *q = load("unit_render/in.rotations_xyzw.npy", 4 * N),
          *o = load("unit_render/in.opacities.npy", N);
    float *sh = load("unit_render/in.harmonics.npy", 75 * N),
          *w2c = load("unit_render/in.w2c.npy", 16);
    float *k = load("unit_render/in.K.npy", 9);
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < 3; j++) {
            f->g.plane[G_MU + j][i] = mu[3 * i + j];
            f->g.plane[G_LOG_SCALE + j][i] = logf(s[3 * i + j]);
            f->g.plane[G_QUAT + 1 + j][i] = q[4 * i + j];
            for (int b = 0; b < 25; b++)
                f->g.plane[G_SH + 3 * b + j][i] = sh[75 * i + 25 * j + b];
        }
        f->g.plane[G_QUAT][i] = q[4 * i + 3];
        double p = fmin(fmax((double)o[i], 1e-12), 1 - 1e-12);
        f->g.plane[G_LOGIT][i] = (float)log(p / (1 - p));
    }
    set_camera(&f->cam, w2c, k);
    free(mu), free(s), free(q), free(o), free(sh), free(w2c), free(k);
    kernels_init(&f->k, cpu);
    f->r.k = &f->k;
    struct raster_input in = {&f->g, &f->cam, {1, 1, 1}};
    struct render out = {0, 0, f->radiance, f->depth, f->alpha};
    assert_int_equal(raster_run(&f->r, &f->rs, &in, &out), OK);
}

/* The formulas in double precision, splats that reach `reach` deviations behind the camera left
 * out; gsplat leaves out none (0).
 * maps: radiance (3, h, w) if planes, else (h, w, 3); depth and alpha (h, w). */
static void draw_formulas(const struct fixture *f, double reach, bool planes, float *const maps[3])
{
    static struct ref_splat splats[N];
    static double out[5 * PX];
    const double white[3] = {1, 1, 1};
    const struct ref_camera c = ref_camera_of(&f->cam, reach);
    ref_splats_of(&f->g, splats);
    ref_render(splats, N, 4, &c, white, out);
    for (int i = 0; i < PX; i++) {
        for (int k = 0; k < 3; k++)
            maps[0][planes ? k * PX + i : 3 * i + k] = (float)out[5 * i + k];
        maps[1][i] = (float)out[5 * i + 3];
        maps[2][i] = (float)out[5 * i + 4];
    }
}

/* Relative rms below 2e-5 and no pixel off by more than 2e-4 of the largest value, except pixels
 * that the golden set marks as near a threshold: there one splat at alpha 1/255 may be in or out
 * (tests/golden/README.md 3). */
static void compare(const char *what, const float *got, const float *want, const int32_t *mask,
                    int channels)
{
    double sum = 0, ref = 0, top = 0, worst = 0;
    for (int i = 0; i < PX * channels; i++)
        top = fmax(top, fabs((double)want[i]));
    for (int p = 0; p < PX; p++)
        for (int c = 0; c < channels; c++) {
            double d = fabs((double)got[c * PX + p] - (double)want[p * channels + c]);
            assert_true(isfinite(d));
            assert_true(d <= top * (mask[p] ? 1.01 / 255 : 2e-4));
            if (mask[p])
                continue;
            sum += d * d;
            ref += (double)want[p * channels + c] * (double)want[p * channels + c];
            worst = fmax(worst, d / top);
        }
    print_message("  %-8s relative rms %.1e, largest %.1e of the maximum\n", what, sqrt(sum / ref),
                  worst);
    assert_true(sqrt(sum / ref) < 2e-5);
}

/* The formulas are gsplat's, and each kernel draws what they do under our rule about splats that
 * reach behind the camera. */
static void test_render(void **state)
{
    (void)state;
    const unsigned masks[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2, CPU_SSE41 | CPU_AVX2 | CPU_AVX512,
                              CPU_NEON};
    const char *names[] = {"radiance", "depth", "alpha"};
    static float radiance[3 * PX], depth[PX], alpha[PX];
    float *const maps[] = {radiance, depth, alpha};
    size_t n;
    int32_t *mask = npy_load("unit_render/out.near_threshold_mask.npy", &n);
    float *golden[] = {load("unit_render/out.hdr.npy", 3 * PX),
                       load("unit_render/out.depth.npy", PX),
                       load("unit_render/out.alpha.npy", PX)};
    static struct fixture f;
    open_fixture(&f, 0);
    draw_formulas(&f, 0, true, maps);
    print_message("formulas\n");
    for (int k = 0; k < 3; k++)
        compare(names[k], maps[k], golden[k], mask, k ? 1 : 3);
    draw_formulas(&f, (double)RASTER_REACH, false, maps);
    arena_free(&f.a);
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++) {
        if ((cpu_detect() & masks[m]) != masks[m])
            continue;
        open_fixture(&f, masks[m]);
        print_message("%s\n", f.k.name);
        compare(names[0], f.radiance, radiance, mask, 3);
        compare(names[1], f.depth, depth, mask, 1);
        compare(names[2], f.alpha, alpha, mask, 1);
        arena_free(&f.a);
    }
    for (int k = 0; k < 3; k++)
        free(golden[k]);
    free(mask);
}

static void test_projection(void **state)
{
    (void)state;
    static struct fixture f;
    open_fixture(&f, cpu_detect());
    float *radii = load("unit_render/out.radii.npy", N),
          *uv = load("unit_render/out.means2d.npy", 2 * N);
    float *conic = load("unit_render/out.conics.npy", 3 * N),
          *log_rad = load("unit_render/out.log_radiance.npy", 3 * N);
    float *opacity = load("unit_render/in.opacities.npy", N);
    int drawn = 0;
    for (int i = 0; i < N; i++) {
        const struct splat2d *s = &f.rs.splats[i];
        if (s->x1 < s->x0) // culled there, or so faint or far outside that no pixel can reach 1/255
            continue;
        drawn++;
        assert_true(radii[i] > 0 && opacity[i] > 1 / 255.f);
        const double ln2 = 0.6931471805599453; // the record holds log2 alpha
        const double a = 2 * ln2 * (double)s->across, b = -a * (double)s->shear;
        const double c = 2 * ln2 * (double)s->along - b * (double)s->shear;
        const double got[] = {(double)s->u,           (double)s->v,          a, b, c,
                              log((double)s->rgb[0]), log((double)s->rgb[2])};
        const float want[] = {uv[2 * i],        uv[2 * i + 1],  conic[3 * i],      conic[3 * i + 1],
                              conic[3 * i + 2], log_rad[3 * i], log_rad[3 * i + 2]};
        for (int k = 0; k < 7; k++)
            assert_true(fabs(got[k] - (double)want[k]) < 1e-4 * (1 + fabs((double)want[k])));
    }
    assert_true(drawn > 350);
    free(radii), free(uv), free(conic), free(log_rad), free(opacity);
    arena_free(&f.a);
}

static void test_ldr(void **state)
{
    (void)state;
    const float exposures[] = {0.125f, 1, 8}, mid = -0.5f; // index.json of the set
    size_t n;
    int32_t *mask = npy_load("unit_render/out.near_threshold_mask.npy", &n);
    float *params = load("unit_render/in.tone_params.npy", 1926);
    float *hdr = load("unit_render/out.hdr.npy", 3 * PX);
    struct tonemap t = {.mid_log2t = mid};
    struct tonemap_table table;
    memcpy(t.p, params, sizeof t.p);
    tonemap_table_init(&table, &t);
    for (int e = 0; e < 3; e++) {
        char name[64];
        static float plane[PX], ldr[3 * PX];
        snprintf(name, sizeof name, "unit_render/out.ldr%d.npy", e);
        float *want = load(name, 3 * PX);
        for (int c = 0; c < 3; c++) {
            for (int i = 0; i < PX; i++)
                plane[i] = hdr[3 * i + c];
            tonemap_run(&table.c[c], plane, log2f(exposures[e]) - mid, PX, ldr + c * PX);
        }
        compare(name + 16, ldr, want, mask, 3);
        free(want);
    }
    free(params), free(mask), free(hdr);
}

static void test_tonemap(void **state)
{
    (void)state;
    enum { M = 512 };
    float *x = load("unit_tonemap/in.log2_radiance.npy", 3 * M),
          *params = load("unit_tonemap/in.tone_params.npy", 1926);
    float *want = load("unit_tonemap/out.ldr.npy", 3 * M), worst = 0;
    struct tonemap t = {.mid_log2t = 0};
    struct tonemap_table table;
    memcpy(t.p, params, sizeof t.p);
    tonemap_table_init(&table, &t);
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < M; i++) {
            /* the set is given after the logarithm: the segment table itself is what is tested */
            int s = tonemap_segment(&table.c[c], x[c * M + i]);
            float got = 1 / (1 + expf(-(table.c[c].a[s] * x[c * M + i] + table.c[c].b[s])));
            worst = fmaxf(worst, fabsf(got - want[c * M + i]));
        }
    print_message("  tone curve: largest difference %.1e\n", (double)worst);
    assert_true(worst < 2e-6f);
    free(x), free(params), free(want);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_render),
                                       cmocka_unit_test(test_projection),
                                       cmocka_unit_test(test_ldr), cmocka_unit_test(test_tonemap)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
