/* The loss against a plain double-precision one, its gradients against finite differences of that,
 * and extremes. */
#include "core/refine/loss.h"

#include "core/base/cpu.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <string.h>

#include <cmocka.h>

enum { W = 29, H = 27, PX = W * H }; // a vector of any width and a rest; two chunks of rows

static const unsigned masks[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2,
                                 CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};
enum { N_MASKS = sizeof masks / sizeof *masks };
static uint32_t seed = 1;

/* Number of the next instruction set that this machine has, N_MASKS after the last; -1 starts. */
static int next_isa(int m)
{
    unsigned have = cpu_detect();
    do
        m++;
    while (m < N_MASKS && (masks[m] & have) != masks[m]);
    return m;
}

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
    return in.held &&
           in.held[y / in.held_px * ((W + in.held_px - 1) / in.held_px) + x / in.held_px];
}

static bool is_skipped(int x, int y)
{
    if (in.masked && in.masked[y * W + x])
        return true;
    return in.skip && in.skip[y / in.cell_px * in.cells_across + x / in.cell_px];
}

static double frozen[3 * PX];

/* Squared difference of what is held out, over black. */
static double held_square(int i, double shown, double want)
{
    return pow(shown - (double)in.behind[i / PX] * (1 - (double)alpha[i % PX]) - want, 2);
}

/* Display value of the photograph; where it is left out, that of the picture. */
static double ref_photo(int i)
{
    return is_skipped(i % PX % W, i % PX / W) ? frozen[i] : photo[i] / 255.0;
}

static double ref_similarity(const double *d, int from)
{
    double taps[11], norm = 0, m[5] = {0};
    for (int k = 0; k < 11; k++)
        norm += taps[k] = exp(-(k - 5) * (k - 5) / 4.5);
    for (int j = 0; j < 121; j++) {
        int at = j / 11 * W + j % 11;
        double w = taps[j / 11] * taps[j % 11] / norm / norm, a = d[from + at],
               b = ref_photo(from + at);
        const double add[5] = {w * a, w * b, w * a * a, w * b * b, w * a * b};
        for (int k = 0; k < 5; k++)
            m[k] += add[k];
    }
    double vx = m[2] - m[0] * m[0], vy = m[3] - m[1] * m[1], cxy = m[4] - m[0] * m[1];
    return (2 * m[0] * m[1] + 1e-4) * (2 * cxy + 9e-4) /
           ((m[0] * m[0] + m[1] * m[1] + 1e-4) * (vx + vy + 9e-4));
}

/* Displays are passed in so that held-out pixels can be frozen, as the gradient has it. */
static double ref_of(const double *d)
{
    double l1 = 0, ssim = 0;
    for (int i = 0; i < 3 * PX; i++)
        l1 += fabs(d[i] - ref_photo(i));
    for (int i = 0; i < 3 * PX; i++)
        if (i % PX % W < W - 10 && i % PX / W < H - 10)
            ssim += ref_similarity(d, i);
    ssim /= 3.0 * (W - 10) * (H - 10);
    return (double)in.w_l1 * l1 / (3 * PX) + (double)in.w_ssim * (1 - ssim);
}

static double ref_loss(void)
{
    static double d[3 * PX];
    for (int i = 0; i < 3 * PX; i++)
        d[i] = is_held(i % PX % W, i % PX / W) || is_skipped(i % PX % W, i % PX / W)
                   ? frozen[i]
                   : display(i / PX, ref_radiance[i], ref_alpha[i % PX]);
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
    in = (struct loss_input){.pic = &pic,
                             .tone = &tone,
                             .shift = 0.7f,
                             .photo = photo,
                             .behind = {.1f, .3f, -.2f},
                             .w_l1 = 0.8f,
                             .w_ssim = 0.2f,
                             .held = held,
                             .held_px = 12,
                             .held_across = (W + 11) / 12};
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

enum { STEP_RADIANCE = 17, STEP_ALPHA = 11, STEP_TONE = 5 }; // every so many are checked

/* Derivatives of the case, found once for all instruction sets. */
static double want_loss, want_radiance[3 * PX], want_alpha[PX], want_tone[TONE_PARAMS];

static void ref_gradients(void)
{
    want_loss = ref_loss();
    for (int i = 0; i < 3 * PX; i += STEP_RADIANCE)
        want_radiance[i] = difference(&ref_radiance[i], 1e-5 * ref_radiance[i]);
    for (int i = 0; i < PX; i += STEP_ALPHA)
        want_alpha[i] = difference(&ref_alpha[i], 1e-5);
    in.held = NULL; // frozen pixels would still move with the curve
    for (int i = 0; i < TONE_PARAMS; i += STEP_TONE)
        want_tone[i] = difference(&ref_tone[i], 1e-6);
    in.held = held;
}

static void compare(const char *what, const float *got, const double *want, int n, int step)
{
    double num = 0, den = 1e-30;
    for (int i = 0; i < n; i += step) {
        num += pow((double)got[i] - want[i], 2);
        den += want[i] * want[i];
    }
    double rel = sqrt(num / den);
    print_message("  %s: %-10s relative difference %.1e\n", kernels.name, what, rel);
    assert_true(rel < 1e-5);
}

static void test_gradients(void **state)
{
    (void)state;
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m)) {
        seed = 4;
        open_case(masks[m]);
        if (m == 0)
            ref_gradients();
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(fabs(out.loss - want_loss) < 1e-6);
        compare("radiance", work.d_radiance, want_radiance, 3 * PX, STEP_RADIANCE);
        compare("alpha", work.d_alpha, want_alpha, PX, STEP_ALPHA);
        in.held = NULL;
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        compare("tone curve", out.tone, want_tone, TONE_PARAMS, STEP_TONE);
        arena_free(&arena);
    }
}

/* Cells that are left out, some of them in held-out squares, and what all cells are off by. */
static void test_left_out(void **state)
{
    (void)state;
    enum { CELL = 4, ACROSS = (W + CELL - 1) / CELL, CELLS = ACROSS * ((H + CELL - 1) / CELL) };
    static uint8_t skip[CELLS];
    static float excess[3 * CELLS];
    for (int i = 0; i < CELLS; i++)
        skip[i] = i % 3 == 0 || i / ACROSS == 3;
    for (int m = next_isa(-1), first = m; m < N_MASKS; m = next_isa(m)) {
        seed = 4;
        open_case(masks[m]);
        in.cell_px = CELL;
        in.cells_across = ACROSS;
        in.skip = skip;
        in.excess = excess;
        if (m == first)
            ref_gradients();
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(fabs(out.loss - want_loss) < 1e-6);
        compare("radiance", work.d_radiance, want_radiance, 3 * PX, STEP_RADIANCE);
        double mean[3 * CELLS] = {0}, sse = 0;
        int n[CELLS] = {0}, n_held = 0;
        for (int i = 0; i < 3 * PX; i++) {
            const int x = i % PX % W, y = i % PX / W, cell = y / CELL * ACROSS + x / CELL;
            const double diff = frozen[i] - photo[i] / 255.0;
            mean[(y / CELL * 3 + i / PX) * ACROSS + x / CELL] += diff;
            n[cell] += i < PX;
            sse += is_held(x, y) && !skip[cell] ? held_square(i, frozen[i], photo[i] / 255.0) : 0;
            n_held += is_held(x, y) && !skip[cell];
            assert_true(!skip[cell] || work.d_radiance[i] == 0);
        }
        assert_true(fabs(out.held.sse - sse) < 1e-4 * sse);
        assert_true(out.held.n == n_held);
        for (int i = 0; i < 3 * CELLS; i++) {
            const int cell = i / (3 * ACROSS) * ACROSS + i % ACROSS;
            assert_true(fabs((double)excess[i] - mean[i] / n[cell]) < 1e-5);
        }
        arena_free(&arena);
    }
}

/* Masked pixels, also in held-out squares; they are off by nothing. */
static void test_masked(void **state)
{
    (void)state;
    enum { CELL = 4, ACROSS = (W + CELL - 1) / CELL, CELLS = ACROSS * ((H + CELL - 1) / CELL) };
    static uint8_t masked[PX];
    static float excess[3 * CELLS];
    for (int i = 0; i < PX; i++)
        masked[i] = (i / W > 8 && i / W < 20 && i % W > 5) || i % 17 == 0;
    for (int m = next_isa(-1), first = m; m < N_MASKS; m = next_isa(m)) {
        seed = 4;
        open_case(masks[m]);
        in.masked = masked;
        in.cell_px = CELL;
        in.cells_across = ACROSS;
        in.excess = excess;
        if (m == first)
            ref_gradients();
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(fabs(out.loss - want_loss) < 1e-6);
        compare("radiance", work.d_radiance, want_radiance, 3 * PX, STEP_RADIANCE);
        const double sse = out.held.sse;
        assert_true(fabsf(excess[3 * ACROSS * 4 + 3]) < 1e-6f); // its cell is masked all over
        for (int i = 0; i < 3 * PX; i++)
            photo[i] = masked[i % PX] ? (uint8_t)(photo[i] + 99) : photo[i];
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(out.held.sse == sse);
        compare("radiance", work.d_radiance, want_radiance, 3 * PX, STEP_RADIANCE);
        arena_free(&arena);
    }
}

/* Two photographs of one picture: value and gradients add up. */
static void test_shared(void **state)
{
    (void)state;
    static double first_radiance[3 * PX], first_alpha[PX];
    for (int m = next_isa(-1), first = m; m < N_MASKS; m = next_isa(m)) {
        seed = 4;
        open_case(masks[m]);
        if (m == first) {
            ref_gradients();
            memcpy(first_radiance, want_radiance, sizeof first_radiance);
            memcpy(first_alpha, want_alpha, sizeof first_alpha);
        }
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        for (int i = 0; i < 3 * PX; i++)
            photo[i] = (uint8_t)(255 - photo[i]);
        in.shift = -1.5f;
        in.more = true;
        ref_shift = -1.5;
        for (int i = 0; i < 3 * PX; i++)
            frozen[i] = display(i / PX, ref_radiance[i], ref_alpha[i % PX]);
        if (m == first)
            ref_gradients();
        for (int i = 0; i < 3 * PX && m == first; i++) {
            want_radiance[i] += first_radiance[i];
            want_alpha[i % PX] += i < PX ? first_alpha[i] : 0;
        }
        assert_int_equal(loss_run(&run, &work, &in, &out), OK);
        assert_true(fabs(out.loss - want_loss) < 1e-6);
        compare("radiance", work.d_radiance, want_radiance, 3 * PX, STEP_RADIANCE);
        compare("alpha", work.d_alpha, want_alpha, PX, STEP_ALPHA);
        arena_free(&arena);
    }
}

/* A photograph of 8 bits in 16: the same numbers. */
static void test_deep(void **state)
{
    (void)state;
    static uint16_t deep[3 * PX];
    static float before[3 * PX];
    open_case(cpu_detect());
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    const struct loss_output small = out;
    memcpy(before, work.d_radiance, sizeof before);
    for (int i = 0; i < 3 * PX; i++)
        deep[i] = (uint16_t)(257 * photo[i]);
    in.photo = NULL;
    in.photo16 = deep;
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    assert_true(fabs(out.loss - small.loss) < 1e-6);
    assert_true(fabs(out.held.sse - small.held.sse) < 1e-5 * small.held.sse);
    for (int i = 0; i < 3 * PX; i++)
        assert_true(fabsf(work.d_radiance[i] - before[i]) < 1e-6f);
    double sse = 0; // bits below the eighth count
    for (int i = 0; i < 3 * PX; i++) {
        deep[i] = (uint16_t)(deep[i] < 65408 ? deep[i] + 127 : deep[i]);
        if (is_held(i % PX % W, i % PX / W))
            sse += held_square(i, (double)work.ldr[i], deep[i] / 65535.0);
    }
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    assert_true(fabs(out.held.sse - sse) < 1e-5 * sse);
    assert_true(fabs(out.held.sse - small.held.sse) > 1e-4 * sse);
    arena_free(&arena);
}

/* A part of a larger photograph is the same as that part alone. */
static void test_part(void **state)
{
    (void)state;
    enum { X = 8, Y = 4, WIDE = W + 13, HIGH = H + 9, ACROSS = (WIDE + 3) / 4 };
    static uint8_t large[3 * WIDE * HIGH], all[ACROSS * ((HIGH + 3) / 4)], own[64];
    static float before[3 * PX];
    open_case(cpu_detect());
    in.held_px = 4;
    in.held_across = (W + 3) / 4;
    for (int i = 0; i < (int)sizeof own; i++)
        own[i] = i % 5 == 0;
    in.held = own;
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    const struct loss_output alone = out;
    memcpy(before, work.d_radiance, sizeof before);
    memset(large, 200, sizeof large);
    memset(all, 1, sizeof all);
    for (int i = 0; i < 3 * PX; i++)
        large[(i / PX * HIGH + i % PX / W + Y) * WIDE + i % W + X] = photo[i];
    for (int i = 0; i < (W + 3) / 4 * ((H + 3) / 4); i++)
        all[(i / ((W + 3) / 4) + Y / 4) * ACROSS + i % ((W + 3) / 4) + X / 4] = own[i];
    in.photo = large;
    in.photo_w = WIDE;
    in.photo_h = HIGH;
    in.x = X;
    in.y = Y;
    in.held = all;
    in.held_across = ACROSS;
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    assert_memory_equal(work.d_radiance, before, sizeof before);
    assert_true(out.loss == alone.loss && out.held.sse == alone.held.sse);
    assert_true(out.held.n == alone.held.n);
    assert_true(alone.held.n > 0);
    arena_free(&arena);
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
            sse += held_square(i, frozen[i], photo[i] / 255.0);
            n++;
            assert_float_equal(work.d_radiance[i], 0, 0);
        }
    assert_true(out.held.n == (double)n);
    assert_true(n > 100 && fabs(out.held.sse - sse) < 1e-4 * sse);
    arena_free(&arena);
}

/* The same of each square and 16 rows; the picture is the lower right part of a photograph. */
static void test_held_sums(void **state)
{
    (void)state;
    enum { ACROSS = 1 + (W + 15) / 16, BANDS = 1 + (H + 15) / 16, CELLS = ACROSS * BANDS };
    static uint8_t large[3 * (W + 16) * (H + 16)], all[CELLS];
    static struct held_sum sums[CELLS];
    double sse[CELLS] = {0};
    int n[CELLS] = {0};
    open_case(cpu_detect());
    for (int i = 0; i < CELLS; i++) {
        all[i] = i % 2 == 0;
        sums[i] = (struct held_sum){-1, -1};
    }
    for (int i = 0; i < 3 * PX; i++) {
        const int x = i % W + 16, y = i % PX / W + 16, cell = y / 16 * ACROSS + x / 16;
        large[(i / PX * (H + 16) + y) * (W + 16) + x] = photo[i];
        sse[cell] += all[cell] ? held_square(i, frozen[i], photo[i] / 255.0) : 0;
        n[cell] += all[cell];
    }
    in.photo = large;
    in.photo_w = W + 16;
    in.photo_h = H + 16;
    in.x = in.y = in.held_px = 16;
    in.held = all;
    in.held_across = ACROSS;
    in.sums = sums;
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    for (int i = 0; i < CELLS; i++) {
        const bool beside = i < ACROSS || i % ACROSS == 0;
        assert_true(sums[i].n == (beside ? -1 : n[i]));
        assert_true(fabs(sums[i].sse - (beside ? -1 : sse[i])) <= 1e-4 * sse[i]);
    }
    arena_free(&arena);
}

/* Radiance 0, denormal, huge and infinite; black and white photographs; exposures of 2^+-20; flat
 * curves. */
static void extreme(int k)
{
    const float values[] = {0, 1e-42f, 1e-20f, 1, 65504, 1e30f, 3e38f, INFINITY};
    for (int i = 0; i < 3 * PX; i++) {
        radiance[i] = values[i % 8];
        photo[i] = k == 0 ? 0 : k == 1 ? 255 : i == 700 ? 255 : 0;
    }
    in.shift = k & 1 ? 20 : -20;
    assert_int_equal(loss_run(&run, &work, &in, &out), OK);
    assert_true(isfinite(out.loss) && isfinite(out.held.sse));
    for (int i = 0; i < 3 * PX; i++)
        assert_true(isfinite(work.d_radiance[i]) && isfinite(work.d_alpha[i % PX]));
    for (int i = 0; i < TONE_PARAMS; i++)
        assert_true(isfinite(out.tone[i]));
}

static void test_extremes(void **state)
{
    (void)state;
    for (int m = next_isa(-1); m < N_MASKS; m = next_isa(m))
        for (int k = 0; k < 4; k++) {
            open_case(masks[m]);
            extreme(k);
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
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gradients), cmocka_unit_test(test_left_out),
        cmocka_unit_test(test_masked),    cmocka_unit_test(test_shared),
        cmocka_unit_test(test_deep),      cmocka_unit_test(test_part),
        cmocka_unit_test(test_held_out),  cmocka_unit_test(test_held_sums),
        cmocka_unit_test(test_extremes),  cmocka_unit_test(test_refuses)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
