/* Gaussian head and hypernetwork against core/net/README.md 2.9 and 2.10 in double, with and
 * without the appearance branch; planes as voxel_merge takes them; the same bytes for any number of
 * threads; memory as planned. */
#include "core/net/gausshead.h"

#include "core/net/metanet.h"
#include "core/splat/voxel.h"
#include "tests/unit/core/net/heads_ref.h"

enum { PX = REF_SIZE * REF_SIZE, M = REF_GRID * REF_GRID, HDR_MAX = 16, RAW = 88 };

static const char head[] = "hdr_head", mapper[] = "generate_tonemapper";

/* ---- the stage ---- */

static struct {
    struct irradiance irr;
    struct prediction p;
    float summary[REF_VIEWS * 2 * HDR_MAX];
} t;

/* Numbers of every reader of the tap that come by. */
static void count_tap(void *ctx, const struct tap_tensor *x)
{
    int *n = ctx;
    *n += x->parts > 0;
}

static void run(const struct net_dims *d, enum precision precision, int threads, bool tapped)
{
    size_t keep, tmp, n = (size_t)(REF_VIEWS * M * d->hdr);
    int taps = 0;
    const struct tap tap = {count_tap, &taps};
    memset(&t, 0, sizeof t);
    ref_open(d, precision, threads);
    ref.r.tap = tapped ? &tap : NULL;
    t.irr = (struct irradiance){ref_random((size_t)(REF_VIEWS * d->hdr), 1), ref_random(n, 1),
                                ref_random(n, 1)};
    const struct gausshead_in in = {&ref.views, &ref.tokens, d->appearance ? &t.irr : NULL};
    struct plan plan = plan_begin(threads);
    gausshead_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    struct plan last = plan_begin(threads);
    if (d->appearance)
        metanet_plan(&last, &ref.net);
    ref_arenas(keep, tmp > last.tmp.peak ? tmp : last.tmp.peak);
    assert_int_equal(gausshead_run(&ref.r, &ref.net, &in, &t.p, t.summary), OK);
    assert_int_equal(ref.keep.used, keep);
    assert_int_equal(ref.tmp.used, 0);
    assert_int_equal(t.p.n, REF_VIEWS * PX);
    assert_true(t.p.linear == !d->appearance);
    if (d->appearance)
        assert_int_equal(metanet_run(&ref.r, &ref.net, t.summary, REF_VIEWS, 0.5f, &t.p), OK);
    assert_int_equal(ref.tmp.used, 0);
    assert_true((taps > 0) == tapped);
}

/* ---- the reference ---- */

static struct ref_map picture_of(int view)
{
    struct ref_map m = ref_new(REF_SIZE, REF_SIZE, 3);
    for (int i = 0; i < 3 * PX; i++)
        m.px[i] = ref.views.rgb[3 * PX * view + i] / 255.0;
    return m;
}

static struct ref_map trunk_of(int view)
{
    struct ref_map m = ref_trunk("gaussian_param_head", view);
    return ref_resize(&m, REF_SIZE, true);
}

static struct ref_map tokens_of(const float *x, int view)
{
    int d = ref.net.d.hdr;
    return ref_floats(x + view * M * d, REF_GRID, REF_GRID, d);
}

static struct ref_map upsampled(const struct ref_map *guide, int view)
{
    struct ref_map low = ref_resize(guide, REF_GRID / 2, false);
    struct ref_map fine = ref_new(guide->h, guide->w, guide->c);
    low = ref_resize(&low, REF_SIZE, false);
    ref_add(&fine, guide, 1);
    ref_add(&fine, &low, -1);
    fine = ref_relu(ref_conv(&fine, head, ".hdr_upsample.proj_guide.0", 1, 3));
    struct ref_map z = tokens_of(t.irr.scene, view);
    z = ref_relu(ref_conv(&z, head, ".scene_conv.0", 1, 1));
    z = ref_resize(&z, REF_SIZE, false);
    ref_add(&fine, &z, 1);
    return ref_relu(ref_conv(&fine, head, ".hdr_upsample.proj_out.0", 1, 3));
}

static struct ref_map side_by_side(const struct ref_map *parts, int n)
{
    int c = 0, at = 0;
    for (int i = 0; i < n; i++)
        c += parts[i].c;
    struct ref_map out = ref_new(parts[0].h, parts[0].w, c);
    for (int k = 0; k < n; at += parts[k++].c)
        for (int i = 0; i < out.h * out.w; i++)
            memcpy(out.px + i * c + at, parts[k].px + i * parts[k].c,
                   (size_t)parts[k].c * sizeof *out.px);
    return out;
}

/* The 88 raw channels of a view and, in *summary, its mean and maximum. */
static struct ref_map want_hdr(int view, double *summary)
{
    int d = ref.net.d.hdr;
    struct ref_map guide = picture_of(view), o = trunk_of(view);
    guide = ref_relu(ref_conv(&guide, head, ".guide_encoder.0", 1, 3));
    struct ref_map u = upsampled(&guide, view);
    ref_add_code(&o);
    ref_add(&o, &u, 1);
    o = ref_relu(ref_conv(&o, "hdr_conv", ".0", 1, 1));
    o = ref_conv(&o, "hdr_conv", ".2", 1, 0);
    struct ref_map s = tokens_of(t.irr.sens, view);
    s = ref_relu(ref_conv(&s, head, ".sensitivity_conv.0", 1, 1));
    s = ref_conv(&s, head, ".sensitivity_conv.2", 1, 0);
    s = ref_resize(&s, REF_SIZE, false);
    struct ref_map y = side_by_side((const struct ref_map[]){o, s}, 2);
    struct ref_map code = ref_floats(t.irr.code + view * d, 1, 1, d);
    code = ref_conv(&code, mapper, ".exp_proj", 1, 0);
    code = ref_resize(&code, REF_SIZE, true);
    struct ref_map x = side_by_side((const struct ref_map[]){guide, y, code}, 3);
    x = ref_relu(ref_conv(&x, mapper, ".enc.0", NET_PATCH, 0));
    x = ref_relu(ref_conv(&x, mapper, ".enc.2", 2, 1));
    for (int c = 0; c < d; c++) {
        summary[c] = 0;
        summary[d + c] = -INFINITY;
        for (int i = 0; i < x.h * x.w; i++) {
            summary[c] += x.px[i * d + c] / (x.h * x.w);
            summary[d + c] = fmax(summary[d + c], x.px[i * d + c]);
        }
    }
    return y;
}

static struct ref_map want_plain(int view)
{
    const char *gs = "gaussian_param_head";
    struct ref_map o = trunk_of(view), merged = picture_of(view), zero;
    merged = ref_relu(ref_conv(&merged, gs, ".input_merger.0", 1, 3));
    ref_add(&o, &merged, 1);
    ref_add_code(&o);
    o = ref_relu(ref_conv(&o, gs, ".scratch.output_conv2.0", 1, 1));
    o = ref_conv(&o, gs, ".scratch.output_conv2.2", 1, 0);
    zero = ref_new(REF_SIZE, REF_SIZE, NET_SENSITIVITY);
    return side_by_side((const struct ref_map[]){o, zero}, 2);
}

static void want_theta(const double *summary, double *out)
{
    int n = 2 * ref.net.d.hdr;
    struct ref_map z = ref_new(1, 1, 2 * n);
    for (int c = 0; c < n; c++) {
        z.px[n + c] = -INFINITY;
        for (int v = 0; v < REF_VIEWS; v++) {
            z.px[c] += summary[v * n + c] / REF_VIEWS;
            z.px[n + c] = fmax(z.px[n + c], summary[v * n + c]);
        }
    }
    z = ref_relu(ref_conv(&z, mapper, ".out.0", 1, 0));
    z = ref_conv(&z, mapper, ".out.2", 1, 0);
    memcpy(out, z.px, NET_THETA * sizeof *out);
}

/* Planes of *t.p against the raw channels of a view. */
static double planes_apart(const struct ref_map *y, int view)
{
    static float got[PX * RAW];
    for (int i = 0; i < PX; i++)
        for (int c = 0; c < RAW; c++) {
            int plane = c < 83 ? c : c - 1; // 83 is the confidence
            const float *from =
                c == 83 ? t.p.confidence : t.p.features + (size_t)plane * (size_t)t.p.n;
            got[i * RAW + c] = from[view * PX + i];
        }
    return ref_apart(got, y->px, PX * RAW);
}

/* ---- tests ---- */

static struct net_dims with_hdr(int hdr)
{
    struct net_dims d = ref_dims;
    d.hdr = hdr;
    d.gs_feat = 2 * hdr;
    return d;
}

static void hdr_as_specified(void **state)
{
    static const double bounds[] = {
        [PRECISION_F32] = 5e-6, [PRECISION_BF16] = 1e-2, [PRECISION_S8] = 5e-2};
    static double theta[NET_THETA];
    double summary[REF_VIEWS * 2 * HDR_MAX];
    (void)state;
    for (int i = 0; i < 6; i++) {
        const struct net_dims d = with_hdr(i % 2 ? 16 : 12); // through Fourier space, and not
        run(&d, (enum precision)(i / 2), 2, false);
        for (int v = 0; v < REF_VIEWS; v++) {
            struct ref_map y = want_hdr(v, summary + v * 2 * d.hdr);
            assert_true(planes_apart(&y, v) < bounds[i / 2]);
        }
        want_theta(summary, theta);
        assert_true(ref_apart(t.summary, summary, (size_t)(REF_VIEWS * 2 * d.hdr)) < bounds[i / 2]);
        assert_true(ref_apart(t.p.theta, theta, TONE_PARAMS) < bounds[i / 2]);
        assert_memory_equal(t.p.tone.p, t.p.theta, sizeof t.p.tone.p);
        assert_true(t.p.tone.mid_log2t == 0.5f);
        for (int k = TONE_PARAMS; k < NET_THETA; k++)
            assert_true(t.p.theta[k] == 0);
        ref_close();
    }
}

static void plain_as_specified(void **state)
{
    struct net_dims d = ref_dims;
    (void)state;
    d.appearance = false;
    run(&d, PRECISION_F32, 2, false);
    for (int v = 0; v < REF_VIEWS; v++) {
        struct ref_map y = want_plain(v);
        assert_true(planes_apart(&y, v) < 5e-6);
    }
    for (int i = 0; i < NET_SENSITIVITY * t.p.n; i++)
        assert_true(t.p.features[VOXEL_EXTRA * t.p.n + i] == 0);
    ref_close();
}

/* Whether taps are read or not changes nothing but the parameters that no image needs. */
static void taps_change_nothing(void **state)
{
    static float features[VOXEL_FEATURES * REF_VIEWS * PX], theta[TONE_PARAMS];
    (void)state;
    run(&ref_dims, PRECISION_S8, 2, false);
    memcpy(features, t.p.features, sizeof features);
    memcpy(theta, t.p.theta, sizeof theta);
    ref_close();
    run(&ref_dims, PRECISION_S8, 2, true);
    assert_memory_equal(features, t.p.features, sizeof features);
    assert_memory_equal(theta, t.p.theta, sizeof theta);
    assert_true(t.p.theta[TONE_PARAMS] != 0);
    ref_close();
}

static void any_number_of_threads(void **state)
{
    static const int threads[] = {2, 7};
    static float features[VOXEL_FEATURES * REF_VIEWS * PX], confidence[REF_VIEWS * PX];
    static float theta[NET_THETA];
    const struct net_dims d = with_hdr(16);
    (void)state;
    for (int p = PRECISION_F32; p <= PRECISION_S8; p += PRECISION_S8) {
        run(&d, (enum precision)p, 1, false);
        memcpy(features, t.p.features, sizeof features);
        memcpy(confidence, t.p.confidence, sizeof confidence);
        memcpy(theta, t.p.theta, sizeof theta);
        ref_close();
        for (int i = 0; i < 2; i++) {
            run(&d, (enum precision)p, threads[i], false);
            assert_memory_equal(features, t.p.features, sizeof features);
            assert_memory_equal(confidence, t.p.confidence, sizeof confidence);
            assert_memory_equal(theta, t.p.theta, sizeof theta);
            ref_close();
        }
    }
}

/* Rotate the inputs of the hypernetwork's first layer by blocks of 4. */
static void rotate_first_layer(void)
{
    struct weight *w = &ref.net.meta.enc0;
    float *px = (float *)(uintptr_t)w->panels;
    for (int p = 0; p < (w->n + PANEL - 1) / PANEL * weight_k(w) / 4; p++, px += 4 * PANEL)
        for (int j = 0; j < PANEL; j++) {
            float x[4] = {px[j], px[PANEL + j], px[2 * PANEL + j], px[3 * PANEL + j]};
            ref.kernels.net.hadamard(x, 4, 4);
            for (int i = 0; i < 4; i++)
                px[i * PANEL + j] = x[i];
        }
    w->rotate = 4;
}

/* Blocks that straddle the parts of its inputs cannot be taken apart; smaller ones change nothing
 * but the last digits. */
static void rotated_first_layer(void **state)
{
    double want[REF_VIEWS * 2 * HDR_MAX];
    size_t n = REF_VIEWS * 2 * (size_t)ref_dims.hdr;
    struct metanet m;
    (void)state;
    run(&ref_dims, PRECISION_F32, 2, false);
    for (size_t i = 0; i < n; i++)
        want[i] = t.summary[i];
    const struct gausshead_in in = {&ref.views, &ref.tokens, &t.irr};
    rotate_first_layer();
    arena_reset(&ref.keep, 0);
    memset(t.summary, 0, sizeof t.summary);
    assert_int_equal(gausshead_run(&ref.r, &ref.net, &in, &t.p, t.summary), OK);
    assert_true(ref_apart(t.summary, want, n) < 1e-5);
    ref.net.meta.enc0.rotate = 8; // 12 channels are no multiple
    assert_int_equal(metanet_init(&ref.r, &ref.net, &m), ERR_FORMAT);
    ref_close();
}

static void cancelled(void **state)
{
    size_t keep, tmp;
    const struct gausshead_in in = {&ref.views, &ref.tokens, NULL};
    struct net_dims d = ref_dims;
    (void)state;
    d.appearance = false;
    ref_open(&d, PRECISION_F32, 2);
    struct plan plan = plan_begin(2);
    gausshead_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
    atomic_store(&ref.cancel, true);
    assert_int_equal(gausshead_run(&ref.r, &ref.net, &in, &t.p, NULL), ERR_CANCELLED);
    assert_int_equal(ref.tmp.used, 0);
    ref_close();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hdr_as_specified),    cmocka_unit_test(plain_as_specified),
        cmocka_unit_test(taps_change_nothing), cmocka_unit_test(any_number_of_threads),
        cmocka_unit_test(rotated_first_layer), cmocka_unit_test(cancelled),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
