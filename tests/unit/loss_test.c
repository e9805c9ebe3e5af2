/* The loss against a plain double-precision one, its gradients against finite differences of that, and extremes. */
#include "core/opt/loss.h"

#include "core/base/cpu.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

enum { W = 37, H = 29, PX = W * H };

static const unsigned masks[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2, CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};
static uint32_t seed = 1;

static double uniform(double lo, double hi)
{
    seed = seed * 1664525u + 1013904223u;
    return lo + (hi - lo) * (double)(seed >> 8) / 16777216.0;
}

static float radiance[3 * PX], alpha[PX], depth[PX];
static uint8_t photo[3 * PX], held[16];
static struct tonemap tone;
static double ref_radiance[3 * PX], ref_alpha[PX], ref_tone[TONE_PARAMS], ref_shift;
static struct loss_input in;
static struct loss work;
static struct arena arena;
static struct kernels kernels;
static struct run run = {.k = &kernels};
static struct loss_output out;
static struct render pic = {W, H, radiance, depth, alpha};

static double display(int c, double rad, double a)
{
    const double *p = ref_tone + c * TONE_PER_COLOUR;
    double x = log2(rad + 1e-6) + ref_shift, l = p[192];
    for (int k = 0; k < 64; k++)
        l += p[128 + k] * fmax(p[k] * x + p[64 + k], 0);
    return 1 / (1 + exp(-l)) + (double)in.behind[c] * (1 - a);
}

static bool is_held(int x, int y)
{
    return in.held && in.held[y / in.held_px * ((W + in.held_px - 1) / in.held_px) + x / in.held_px];
}

/* Displays are passed in so that held-out pixels can be frozen, as the gradient has it. */
static double ref_of(const double *d)
{
    double taps[11], norm = 0, l1 = 0, ssim = 0;
    for (int k = 0; k < 11; k++)
        norm += taps[k] = exp(-(k - 5) * (k - 5) / 4.5);
    for (int i = 0; i < 3 * PX; i++)
        l1 += fabs(d[i] - photo[i] / 255.0);
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < H - 10; y++)
            for (int x = 0; x < W - 10; x++) {
                double m[5] = {0};
                for (int j = 0; j < 121; j++) {
                    int at = (y + j / 11) * W + x + j % 11;
                    double w = taps[j / 11] * taps[j % 11] / norm / norm;
                    double a = d[c * PX + at], b = photo[c * PX + at] / 255.0;
                    m[0] += w * a, m[1] += w * b, m[2] += w * a * a, m[3] += w * b * b, m[4] += w * a * b;
                }
                double vx = m[2] - m[0] * m[0], vy = m[3] - m[1] * m[1], cxy = m[4] - m[0] * m[1];
                ssim += (2 * m[0] * m[1] + 1e-4) * (2 * cxy + 9e-4) /
                        ((m[0] * m[0] + m[1] * m[1] + 1e-4) * (vx + vy + 9e-4));
            }
    return (double)in.w_l1 * l1 / (3 * PX) + (double)in.w_ssim * (1 - ssim / (3.0 * (W - 10) * (H - 10)));
}

static double frozen[3 * PX];

static double ref_loss(void)
{
    static double d[3 * PX];
    for (int i = 0; i < 3 * PX; i++)
        d[i] = is_held(i % PX % W, i % PX / W) ? frozen[i] : display(i / PX, ref_radiance[i], ref_alpha[i % PX]);
    return ref_of(d);
}

static double difference(double *x, double h)
{
    double x0 = *x;
    *x = x0 + h;
    double a = ref_loss();
    *x = x0 - h;
    double b = ref_loss();
    *x = x0;
    return (a - b) / (2 * h);
}

static void open_case(unsigned cpu)
{
    kernels_init(&kernels, cpu);
    assert_int_equal(arena_init(&arena, "test", loss_plan(W, H, 1) + 4096), OK);
    assert_int_equal(loss_init(&work, &arena, W, H, 1), OK);
    tonemap_linear(&tone, 0.6f, -8, 6, 0);
    for (int i = 0; i < TONE_PARAMS; i++)
        tone.p[i] += (float)uniform(-.02, .02);
    tone.p[5] = -1; // a unit that is on to the left, and one that never bends
    tone.p[9] = 0;
    for (int i = 0; i < 3 * PX; i++) {
        radiance[i] = (float)exp(uniform(-5, 3));
        photo[i] = (uint8_t)uniform(0, 256);
    }
    for (int i = 0; i < PX; i++)
        alpha[i] = (float)uniform(0, 1);
    memset(held, 0, sizeof held);
    held[1] = held[6] = 1;
    in = (struct loss_input){&pic, &tone, 0.7f, photo, {.1f, .3f, -.2f}, 0.8f, 0.2f, held, 12};
    for (int i = 0; i < 3 * PX; i++)
        ref_radiance[i] = (double)radiance[i];
    for (int i = 0; i < PX; i++)
        ref_alpha[i] = (double)alpha[i];
    for (int i = 0; i < TONE_PARAMS; i++)
        ref_tone[i] = (double)tone.p[i];
    ref_shift = (double)in.shift;
    for (int i = 0; i < 3 * PX; i++)
        frozen[i] = display(i / PX, ref_radiance[i], ref_alpha[i % PX]);
}

static double relative(double num, double den)
{
    return sqrt(num / (den + 1e-30));
}

static void test_gradients(void **state)
{
    (void)state;
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++) {
        if ((cpu_detect() & masks[m]) != masks[m])
            continue;
        seed = 4;
        open_case(masks[m]);
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(fabs(out.loss - ref_loss()) < 1e-6);
        double num[3] = {0}, den[3] = {0};
        for (int i = 0; i < 3 * PX; i += 17) {
            double d = difference(&ref_radiance[i], 1e-5 * ref_radiance[i]);
            num[0] += pow((double)work.d_radiance[i] - d, 2), den[0] += d * d;
        }
        for (int i = 0; i < PX; i += 11) {
            double d = difference(&ref_alpha[i], 1e-5);
            num[1] += pow((double)work.d_alpha[i] - d, 2), den[1] += d * d;
        }
        in.held = NULL; // frozen pixels would still move with the curve
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        for (int i = 0; i < TONE_PARAMS; i += 5) {
            double d = difference(&ref_tone[i], 1e-6);
            num[2] += pow((double)out.tone[i] - d, 2), den[2] += d * d;
        }
        const char *names[] = {"radiance", "alpha", "tone curve"};
        for (int k = 0; k < 3; k++) {
            print_message("  %s: %-10s relative difference %.1e\n", kernels.name, names[k], relative(num[k], den[k]));
            assert_true(relative(num[k], den[k]) < 1e-3); // single pixels sit next to a knot or to |d| = 0
        }
        arena_free(&arena);
    }
}

static void test_held_out(void **state)
{
    (void)state;
    open_case(cpu_detect());
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    double sse = 0;
    long n = 0;
    for (int i = 0; i < 3 * PX; i++)
        if (is_held(i % PX % W, i % PX / W)) {
            sse += pow(frozen[i] - photo[i] / 255.0, 2);
            n++;
            assert_float_equal(work.d_radiance[i], 0, 0);
        }
    assert_int_equal(out.held_n, n);
    assert_true(n > 100 && fabs(out.held_sse - sse) < 1e-4 * sse);
    arena_free(&arena);
}

/* Radiance 0, denormal, huge and infinite; black and white photographs; exposures of 2^+-20; flat curves. */
static void test_extremes(void **state)
{
    (void)state;
    const float values[] = {0, 1e-42f, 1e-20f, 1, 65504, 1e30f, 3e38f, INFINITY};
    for (size_t m = 0; m < sizeof masks / sizeof *masks; m++)
        for (int k = 0; k < 4; k++) {
            if ((cpu_detect() & masks[m]) != masks[m])
                continue;
            open_case(masks[m]);
            for (int i = 0; i < 3 * PX; i++) {
                radiance[i] = values[i % 8];
                photo[i] = k == 0 ? 0 : k == 1 ? 255 : i == 700 ? 255 : 0;
            }
            in.shift = k & 1 ? 20 : -20;
            assert_int_equal(loss_run(&run, &work, &in, &out), OK);
            assert_true(isfinite(out.loss) && isfinite(out.held_sse));
            for (int i = 0; i < 3 * PX; i++)
                assert_true(isfinite(work.d_radiance[i]) && isfinite(work.d_alpha[i % PX]));
            for (int i = 0; i < TONE_PARAMS; i++)
                assert_true(isfinite(out.tone[i]));
            arena_free(&arena);
        }
}

static void test_refuses(void **state)
{
    (void)state;
    assert_int_equal(arena_init(&arena, "test", 1 << 20), OK);
    assert_int_equal(loss_init(&work, &arena, 10, 40, 1), ERR_ARG);
    arena_free(&arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_gradients), cmocka_unit_test(test_held_out),
                                       cmocka_unit_test(test_extremes), cmocka_unit_test(test_refuses)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
