/* The completion branch against core/net/README.md 2.14 in double, on squares and rectangles of
 * any size; the same bytes for any number of threads; memory as planned; overflow. */
#include "core/net/complete.h"

#include "tests/unit/core/net/heads_ref.h"

enum { PX_MAX = 90 * 70 };

static const char head[] = "complete";

static float got[PX_MAX * NET_COMPLETE_OUT], again[PX_MAX * NET_COMPLETE_OUT];
static struct complete_in in;
static size_t planned; // bytes

/* A network with the branch, a map of (h, w), memory as planned. */
static void open_branch(enum precision precision, int h, int w, int threads)
{
    struct net_dims d = ref_dims;
    d.complete = true;
    ref_open(&d, precision, threads);
    in = (struct complete_in){h, w, ref_random((size_t)(h * w * NET_COMPLETE_IN), 1)};
    struct plan plan = plan_begin(threads);
    complete_plan(&plan, &ref.net, &in);
    assert_int_equal(plan.keep.peak, 0);
    assert_int_equal(plan.tmp.used, 0);
    planned = plan.tmp.peak;
    ref_arenas(0, planned);
}

static void run(enum precision precision, int h, int w, int threads, float *out)
{
    open_branch(precision, h, w, threads);
    assert_int_equal(complete_run(&ref.r, &ref.net, &in, out), OK);
    assert_int_equal(ref.tmp.used, 0);
    assert_int_equal(ref.tmp.peak, planned);
}

static struct ref_map layer(const struct ref_map *x, const char *name, int l, int stride)
{
    char full[2 * REF_NAMES];
    snprintf(full, sizeof full, ".%s.%d", name, l);
    return ref_conv(x, head, full, stride, strcmp(name, "up") == 0 ? 0 : 1);
}

static struct ref_map want(void)
{
    static const int stay[] = {0, 1, 1, 2, 1, 2};
    struct ref_map e[6], d = ref_floats(in.px, in.h, in.w, NET_COMPLETE_IN);
    for (int l = 0; l < 6; l++) {
        char name[REF_NAMES];
        d = ref_relu(layer(&d, "down", l, l ? 2 : 1));
        snprintf(name, sizeof name, "stay.%d", l);
        for (int k = 0; k < stay[l]; k++) {
            struct ref_map r = ref_relu(layer(&d, name, k, 1));
            ref_add(&d, &r, 1);
        }
        e[l] = d;
    }
    for (int l = 4; l >= 0; l--) {
        d = layer(&d, "up", l, 1);
        d = ref_resize_to(&d, e[l].h, e[l].w, false);
        ref_add(&d, &e[l], 1);
        d = ref_relu(layer(&d, "join", l, 1));
    }
    return ref_conv(&d, head, ".out", 1, 1);
}

static double apart_most(const float *a, const double *b, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++)
        most = fmax(most, fabs(a[i] - b[i]));
    return most;
}

static void as_specified(void **state)
{
    static const int sizes[][2] = {{16, 16}, {37, 22}, {70, 90}, {1, 1}, {2, 33}};
    static const double bounds[] = {
        [PRECISION_F32] = 1e-5, [PRECISION_BF16] = 1e-2, [PRECISION_S8] = 3e-2};
    (void)state;
    for (int i = 0; i < 5; i++)
        for (int p = PRECISION_F32; p <= PRECISION_S8; p++) {
            const int h = sizes[i][0], w = sizes[i][1], n = h * w * NET_COMPLETE_OUT;
            run((enum precision)p, h, w, 2, got);
            const struct ref_map m = want();
            assert_true(m.h == h && m.w == w && m.c == NET_COMPLETE_OUT);
            assert_true(ref_apart(got, m.px, (size_t)n) < bounds[p]);
            assert_true(apart_most(got, m.px, n) < bounds[p]);
            ref_close();
        }
}

static void any_number_of_threads(void **state)
{
    static const int threads[] = {2, 7};
    const int h = 70, w = 90; // several tiles, the last ones cut
    (void)state;
    for (int p = PRECISION_F32; p <= PRECISION_S8; p += PRECISION_S8) {
        run((enum precision)p, h, w, 1, got);
        ref_close();
        for (int i = 0; i < 2; i++) {
            run((enum precision)p, h, w, threads[i], again);
            ref_close();
            assert_memory_equal(got, again, sizeof got);
        }
    }
}

static void cancelled(void **state)
{
    (void)state;
    open_branch(PRECISION_S8, 20, 30, 2);
    atomic_store(&ref.cancel, true);
    assert_int_equal(complete_run(&ref.r, &ref.net, &in, got), ERR_CANCELLED);
    assert_int_equal(ref.tmp.used, 0);
    ref_close();
}

/* Less memory than planned, down to none. */
static void out_of_memory(void **state)
{
    (void)state;
    open_branch(PRECISION_S8, 20, 30, 2);
    const size_t all = ref.tmp.size;
    for (int i = 0; i < 16; i++) {
        ref.tmp.size = all * (size_t)i / 16;
        assert_int_equal(complete_run(&ref.r, &ref.net, &in, got), ERR_NOMEM);
        assert_int_equal(ref.tmp.used, 0);
    }
    ref.tmp.size = all;
    assert_int_equal(complete_run(&ref.r, &ref.net, &in, got), OK);
    ref_close();
}

static void overflow_is_refused(void **state)
{
    static const float bias[NET_COMPLETE_OUT] = {0, INFINITY, 0};
    (void)state;
    open_branch(PRECISION_S8, 20, 30, 2);
    ref.net.complete.out.bias = bias;
    assert_int_equal(complete_run(&ref.r, &ref.net, &in, got), ERR_FORMAT);
    assert_non_null(strstr(err_text(), "element 1 of its complete.out"));
    assert_int_equal(ref.tmp.used, 0);
    ref_close();
}

/* Without quantised activations only the rounding of the weights is left. */
static void floats_on_request(void **state)
{
    (void)state;
    open_branch(PRECISION_S8, 37, 22, 2);
    ref.net.floats = NET_FLOAT_HEADS;
    assert_int_equal(complete_run(&ref.r, &ref.net, &in, got), OK);
    const struct ref_map m = want();
    assert_true(ref_apart(got, m.px, 37 * 22 * NET_COMPLETE_OUT) < 1e-2);
    ref_close();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(as_specified),        cmocka_unit_test(any_number_of_threads),
        cmocka_unit_test(cancelled),           cmocka_unit_test(out_of_memory),
        cmocka_unit_test(overflow_is_refused), cmocka_unit_test(floats_on_request),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
