/* Exposure codes; the fusion of appearances against core/net/README.md 2.6 to 2.8 in double, also
 * where all attention goes to tokens that are dropped and where all views are the same; the same
 * bytes for any number of threads; memory as planned. */
#include "core/net/appearance.h"

#include "tests/unit/core/net/heads_ref.h"

enum {
    M = REF_GRID * REF_GRID,
    N = REF_VIEWS * M,
    KEYS = REF_VIEWS * (M + NET_SPECIAL),
    D_MAX = 16
};

static const char head[] = "hdr_head";

/* ---- exposures ---- */

static void check_values_of_the_code(void **state)
{
    float e[128];
    (void)state;
    appearance_code(-4, 128, e);
    assert_float_equal(e[0], -1, 1e-6); // core/net/README.md 2.6
    assert_float_equal(e[1], 0, 1e-6);
    assert_float_equal(e[126], -0.0338, 5e-5);
    assert_float_equal(e[127], -0.9994, 5e-5);
    appearance_code(0, 128, e);
    for (int i = 0; i < 128; i++)
        assert_true(e[i] == (float)(i % 2));
}

/* Times of 2^-26.6 (the floor of prep) to 2^26. */
static void extreme_exposures(void **state)
{
    float e[128];
    (void)state;
    for (float stops = -27; stops <= 27; stops += 0.25f) {
        appearance_code(stops, 128, e);
        for (int i = 0; i < 128; i += 2) {
            double a = stops * 0.39269908169872414 * pow(2, i / 128.0);
            assert_float_equal(e[i], sin(a), 1e-7);
            assert_float_equal(e[i + 1], cos(a), 1e-7);
        }
    }
}

static void ranges(void **state)
{
    float log2t[] = {3, -26, 26, 0};
    struct views v = {.n = 4, .log2t = log2t};
    (void)state;
    assert_true(appearance_range(&v) == 52);
    log2t[1] = log2t[2] = 3.25f;
    v.n = 3;
    assert_true(appearance_range(&v) == 0.5f);
    v.n = 1;
    assert_true(appearance_range(&v) == 0.5f);
}

/* ---- the reference ---- */

static double code_of(int view, int c)
{
    double a = (ref.views.log2t[view] - ref.views.mid_log2t) * 0.39269908169872414;
    a *= pow(2, 2.0 * (c / 2) / ref.net.d.hdr);
    return c % 2 == 0 ? sin(a) : cos(a);
}

static struct ref_map patch_tokens(void)
{
    struct ref_map all = ref_new(N, 1, ref.net.d.hdr);
    for (int v = 0; v < REF_VIEWS; v++) {
        struct ref_map picture = ref_new(REF_SIZE, REF_SIZE, 3);
        for (int i = 0; i < 3 * REF_SIZE * REF_SIZE; i++)
            picture.px[i] = ref.views.rgb[3 * REF_SIZE * REF_SIZE * v + i] / 255.0;
        struct ref_map x = ref_conv(&picture, head, ".patch_embed", NET_PATCH, 0);
        memcpy(ref_at(&all, v * M, 0), x.px, (size_t)(M * x.c) * sizeof *x.px);
    }
    return all;
}

/* Gains and offsets, (views, 2 d). */
static struct ref_map modulation(const struct ref_map *xn)
{
    int d = xn->c;
    struct ref_map in = ref_new(REF_VIEWS, 1, 3 * d);
    for (int v = 0; v < REF_VIEWS; v++)
        for (int c = 0; c < d; c++) {
            ref_at(&in, v, 0)[c] = code_of(v, c);
            for (int i = 0; i < N; i++) {
                ref_at(&in, v, 0)[d + c] += i / M == v ? xn->px[i * d + c] / M : 0;
                ref_at(&in, v, 0)[2 * d + c] += xn->px[i * d + c] / N;
            }
        }
    in = ref_relu(ref_conv(&in, head, ".regression.exp_film.0", 1, 0));
    return ref_conv(&in, head, ".regression.exp_film.2", 1, 0);
}

static double logit(int j, int row, int key)
{
    int width = ref.net.d.embed / ref.net.d.heads;
    const float *q = ref.tokens.q + (j * KEYS + row) * width;
    const float *k = ref.tokens.k + (j * KEYS + key) * width;
    double sum = 0;
    for (int i = 0; i < width; i++)
        sum += (double)q[i] * k[i];
    return sum / 8;
}

static int token(int patch)
{
    return patch / M * (M + NET_SPECIAL) + NET_SPECIAL + patch % M;
}

/* Row of the attention map, (N). */
static void attention(int patch, double *out)
{
    double total = 0;
    memset(out, 0, N * sizeof *out);
    for (int j = 0; j < ref.net.d.heads; j++) {
        double top = -INFINITY, sum = 0;
        for (int key = 0; key < KEYS; key++)
            top = fmax(top, logit(j, token(patch), key));
        for (int key = 0; key < KEYS; key++)
            sum += exp(logit(j, token(patch), key) - top);
        for (int i = 0; i < N; i++)
            out[i] += exp(logit(j, token(patch), token(i)) - top) / sum / ref.net.d.heads;
    }
    for (int i = 0; i < N; i++)
        total += out[i];
    for (int i = 0; i < N; i++)
        out[i] /= total + 1e-6;
}

/* Mean and variance of query `patch`, (d) each. */
static void combine(int patch, const struct ref_map *vm, const struct ref_map *vv, double *mean,
                    double *var)
{
    double a[N], w[REF_VIEWS] = {0}, sum = 0, u[REF_VIEWS];
    attention(patch, a);
    for (int i = 0; i < N; i++) {
        w[i / M] += a[i];
        sum += a[i];
    }
    for (int v = 0; v < REF_VIEWS; v++)
        w[v] /= sum + 1e-6;
    for (int c = 0; c < vm->c; c++) {
        double centre = 0;
        memset(u, 0, sizeof u);
        mean[c] = var[c] = 0;
        for (int i = 0; i < N; i++) {
            mean[c] += a[i] * w[i / M] * vm->px[i * vm->c + c];
            u[i / M] += a[i] * vv->px[i * vm->c + c];
        }
        for (int v = 0; v < REF_VIEWS; v++)
            centre += w[v] * u[v];
        for (int v = 0; v < REF_VIEWS; v++)
            var[c] += w[v] * (u[v] - centre) * (u[v] - centre) / appearance_range(&ref.views);
    }
}

static struct ref_map head_out(const struct ref_map *in, const char *name)
{
    char norm[REF_NAMES], a[REF_NAMES], b[REF_NAMES];
    snprintf(norm, sizeof norm, ".regression.%s.0", name);
    snprintf(a, sizeof a, ".regression.%s.1", name);
    snprintf(b, sizeof b, ".regression.%s.3", name);
    struct ref_map x = ref_norm(in, head, norm);
    x = ref_relu(ref_conv(&x, head, a, 1, 0));
    return ref_conv(&x, head, b, 1, 0);
}

static void reference_tokens(struct ref_map *scene, struct ref_map *sens)
{
    *scene = patch_tokens();
    int d = scene->c;
    struct ref_map xn = ref_norm(scene, head, ".regression.ln");
    struct ref_map film = modulation(&xn), mean = ref_new(N, 1, d), var = ref_new(N, 1, d);
    struct ref_map vm = ref_conv(&xn, head, ".regression.v_mean_proj", 1, 0);
    struct ref_map vv = ref_conv(&xn, head, ".regression.v_var_proj", 1, 0);
    for (int i = 0; i < N * d; i++) {
        const double *f = ref_at(&film, i / d / M, 0);
        vm.px[i] = vm.px[i] * (1 + f[i % d]) + f[d + i % d];
    }
    for (int i = 0; i < N; i++)
        combine(i, &vm, &vv, ref_at(&mean, i, 0), ref_at(&var, i, 0));
    mean = head_out(&mean, "mean_out");
    ref_add(scene, &mean, 1);
    *sens = head_out(&var, "var_out");
}

/* ---- the stage ---- */

static struct irradiance irr;

static void run(const struct net_dims *d, int threads, void (*change)(void))
{
    size_t keep, tmp;
    ref_open(d, PRECISION_F32, threads);
    if (change)
        change();
    struct plan plan = plan_begin(threads);
    appearance_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
    assert_int_equal(appearance_run(&ref.r, &ref.net, &ref.views, &ref.tokens, &irr), OK);
    assert_int_equal(ref.keep.used, keep);
    assert_int_equal(ref.tmp.used, 0);
    assert_int_equal(ref.tmp.peak, tmp);
}

static void compare(const struct net_dims *d, void (*change)(void))
{
    struct ref_map scene, sens;
    run(d, 2, change);
    reference_tokens(&scene, &sens);
    for (int i = 0; i < REF_VIEWS * d->hdr; i++)
        assert_float_equal(irr.code[i], code_of(i / d->hdr, i % d->hdr), 1e-6);
    assert_true(ref_finite(irr.scene, (size_t)(N * d->hdr)));
    assert_true(ref_finite(irr.sens, (size_t)(N * d->hdr)));
    assert_true(ref_apart(irr.scene, scene.px, (size_t)(N * d->hdr)) < 2e-6);
    assert_true(ref_apart(irr.sens, sens.px, (size_t)(N * d->hdr)) < 2e-5);
    ref_close();
}

static struct net_dims with_hdr(int hdr)
{
    struct net_dims d = ref_dims;
    d.hdr = hdr;
    d.gs_feat = 2 * hdr;
    return d;
}

static void as_specified(void **state)
{
    const struct net_dims even = with_hdr(16);
    (void)state;
    compare(&ref_dims, NULL);
    compare(&even, NULL);
}

/* Keys of all patches turned away from all queries by so much that their weight is 0 in floats, or
 * by so little that the sum of a row is of the size of the epsilon. */
static float repelled;

static void repel_keys(void)
{
    int width = ref.net.d.embed / ref.net.d.heads;
    for (int i = 0; i < ref.net.d.heads * KEYS; i++) {
        bool patch = i % KEYS % (M + NET_SPECIAL) >= NET_SPECIAL;
        for (int c = 0; c < width; c++) {
            ref.tokens.q[i * width + c] = c == 0 ? 8 : 0;
            ref.tokens.k[i * width + c] = c == 0 && patch ? -repelled : 0.01f * (float)(i % 7);
        }
    }
}

static void all_weight_on_dropped_tokens(void **state)
{
    static const float logits[] = {5, 12, 14, 20, 60, 200};
    (void)state;
    for (int i = 0; i < 6; i++) {
        repelled = logits[i];
        compare(&ref_dims, repel_keys);
    }
}

/* One view again and again: what remains of the variance is noise of the arithmetic. */
static void repeat_view(void)
{
    static float same[REF_VIEWS] = {1, 1, 1};
    int width = ref.net.d.embed / ref.net.d.heads;
    size_t px = 3 * REF_SIZE * REF_SIZE;
    for (size_t i = px; i < REF_VIEWS * px; i++)
        ref.views.rgb[i] = ref.views.rgb[i - px];
    for (int i = 0; i < ref.net.d.heads * KEYS * width; i++)
        if (i / width % KEYS >= M + NET_SPECIAL) {
            ref.tokens.q[i] = ref.tokens.q[i - (M + NET_SPECIAL) * width];
            ref.tokens.k[i] = ref.tokens.k[i - (M + NET_SPECIAL) * width];
        }
    ref.views.log2t = same;
    ref.views.mid_log2t = 1;
}

static void one_view_repeated(void **state)
{
    (void)state;
    compare(&ref_dims, repeat_view);
    run(&ref_dims, 2, repeat_view);
    size_t n = (size_t)M * (size_t)ref.net.d.hdr;
    for (int v = 1; v < REF_VIEWS; v++) {
        assert_memory_equal(irr.scene, irr.scene + (size_t)v * n, n * sizeof(float));
        assert_memory_equal(irr.sens, irr.sens + (size_t)v * n, n * sizeof(float));
    }
    ref_close();
}

static void any_number_of_threads(void **state)
{
    static const int threads[] = {2, 7};
    static float scene[N * D_MAX], sens[N * D_MAX];
    size_t n = (size_t)(N * ref_dims.hdr) * sizeof(float);
    (void)state;
    run(&ref_dims, 1, NULL);
    memcpy(scene, irr.scene, n);
    memcpy(sens, irr.sens, n);
    ref_close();
    for (int i = 0; i < 2; i++) {
        run(&ref_dims, threads[i], NULL);
        assert_memory_equal(scene, irr.scene, n);
        assert_memory_equal(sens, irr.sens, n);
        ref_close();
    }
}

static void cancelled(void **state)
{
    size_t keep, tmp;
    (void)state;
    ref_open(&ref_dims, PRECISION_F32, 2);
    struct plan plan = plan_begin(2);
    appearance_plan(&plan, &ref.net, REF_VIEWS, REF_SIZE);
    keep = plan.keep.peak;
    tmp = plan.tmp.peak;
    ref_arenas(keep, tmp);
    atomic_store(&ref.cancel, true);
    assert_int_equal(appearance_run(&ref.r, &ref.net, &ref.views, &ref.tokens, &irr),
                     ERR_CANCELLED);
    assert_true(!irr.scene && ref.keep.used == 0 && ref.tmp.used == 0);
    ref_close();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(check_values_of_the_code),
        cmocka_unit_test(extreme_exposures),
        cmocka_unit_test(ranges),
        cmocka_unit_test(as_specified),
        cmocka_unit_test(all_weight_on_dropped_tokens),
        cmocka_unit_test(one_view_repeated),
        cmocka_unit_test(any_number_of_threads),
        cmocka_unit_test(cancelled),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
