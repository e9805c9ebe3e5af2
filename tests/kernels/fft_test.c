/* Fourier tiles on every instruction set of this machine, against sums in double and forth and
 * back; arrays end at inaccessible pages. */
#include "core/base/cpu.h"
#include "core/kernels/kernels.h"
#include "tests/kernels/guard.h"

#include <math.h>

enum { EDGE = FFT_EDGE, AREA = EDGE * EDGE, N_MAX = 48, GAP = 5 };

static const double turn = 2 * 3.14159265358979323846 / EDGE;
static int failures;

static void expect_good(bool good, const char *level, const char *what)
{
    failures += !good;
    if (!good)
        printf("%s: %s\n", level, what);
}

/* A tile whose pixels and planes lie GAP elements further apart than they must. */
static struct fft_tile make_tile(int n, int edge)
{
    struct fft_tile t = {.n = n, .edge = edge};
    t.step = (size_t)n + GAP;
    t.row = (size_t)edge * t.step + GAP;
    t.plane = (size_t)n + GAP;
    t.px = guard_alloc((size_t)(edge - 1) * (t.row + t.step) + (size_t)n, sizeof(float));
    t.planes = guard_alloc((FFT_PLANES - 1) * t.plane + (size_t)n, sizeof(float));
    return t;
}

static void fill_tile(const struct fft_tile *t)
{
    uint32_t rng = 1;
    for (int i = 0; i < AREA * t->n; i++) {
        rng = rng * 1664525u + 1013904223u;
        t->px[(size_t)(i / t->n / EDGE) * t->row + (size_t)(i / t->n % EDGE) * t->step +
              (size_t)(i % t->n)] = (float)(rng >> 8) * 0x1p-23f - 1;
    }
}

/* Frequency (ky, kx) of channel c. */
static void slow_frequency(const struct fft_tile *t, int ky, int kx, int c, double out[2])
{
    out[0] = out[1] = 0;
    for (int i = 0; i < AREA; i++) {
        double v = t->px[(size_t)(i / EDGE) * t->row + (size_t)(i % EDGE) * t->step + (size_t)c];
        double a = turn * (ky * (i / EDGE) + kx * (i % EDGE));
        out[0] += v * cos(a);
        out[1] -= v * sin(a);
    }
}

/* Where frequency (ky, kx) lies: columns 1 to 7 in full, columns 0 and 8 from 1 to 7. */
static int bin_of(int ky, int kx)
{
    if (kx % (EDGE / 2))
        return (kx - 1) * EDGE + ky;
    return 7 * EDGE + (kx ? 7 : 0) + ky - 1;
}

static void check_forward(const struct kernels *k, const char *level)
{
    static const int corners[FFT_REALS][2] = {{0, 0}, {8, 0}, {0, 8}, {8, 8}};
    struct fft_tile t = make_tile(16, EDGE);
    double want[2], worst = 0;
    fill_tile(&t);
    k->net.fft_forward(&t);
    for (int i = 0; i < EDGE * 9; i++) {
        int ky = i % EDGE, kx = i / EDGE, c = i % t.n;
        if (kx % 8 == 0 && (ky % 8 == 0 || ky > 8))
            continue;
        const float *p = t.planes + (size_t)(3 * bin_of(ky, kx)) * t.plane + c;
        slow_frequency(&t, ky, kx, c, want);
        worst = fmax(worst, fabs((double)p[0] - want[0]));
        worst = fmax(worst, fabs((double)p[t.plane] - want[1]));
        worst = fmax(worst, fabs((double)p[2 * t.plane] - want[0] - want[1]));
    }
    for (int r = 0; r < FFT_REALS; r++) {
        slow_frequency(&t, corners[r][0], corners[r][1], r, want);
        worst =
            fmax(worst, fabs((double)t.planes[(size_t)(3 * FFT_BINS + r) * t.plane + (size_t)r] -
                             want[0]));
    }
    expect_good(worst < 2e-5, level, "forward"); // the largest sums are near 30
}

/* Forward, planes as a product with 1 gives them, inverse: 256 times the tile. */
static void check_inverse(const struct kernels *k, const char *level, int n, int edge)
{
    struct fft_tile t = make_tile(n, EDGE), back = make_tile(n, edge);
    double worst = 0;
    fill_tile(&t);
    k->net.fft_forward(&t);
    for (size_t p = 0; p < 3 * FFT_BINS; p += 3)
        for (size_t c = 0; c < (size_t)n; c++) {
            float *from = t.planes + p * t.plane + c, *to = back.planes + p * back.plane + c;
            to[0] = from[t.plane] - from[0];
            to[back.plane] = 0;
            to[2 * back.plane] = from[0];
        }
    for (size_t p = 3 * FFT_BINS; p < FFT_PLANES; p++)
        memcpy(back.planes + p * back.plane, t.planes + p * t.plane, (size_t)n * sizeof(float));
    k->net.fft_inverse(&back);
    for (int i = 0; i < edge * edge * n; i++) {
        size_t y = (size_t)(i / n / edge), x = (size_t)(i / n % edge), c = (size_t)(i % n);
        double want = 256.0 * (double)t.px[y * t.row + x * t.step + c];
        worst = fmax(worst, fabs((double)back.px[y * back.row + x * back.step + c] - want));
    }
    for (int i = 0; i < edge * edge - 1; i++) { // between the pixels nothing is written
        const float *px = back.px + (size_t)(i / edge) * back.row + (size_t)(i % edge) * back.step;
        expect_good(guard_is_canary(px + n) && guard_is_canary(px + n + GAP - 1), level, "beside");
    }
    expect_good(worst < 1e-3, level, "inverse");
}

struct call {
    const struct kernels *k;
    const char *level;
};

static void check_tile(const void *ctx)
{
    const struct call *c = ctx;
    static const int edges[] = {8, 9, 10, 12, 16};
    for (int at_end = 0; at_end < 2; at_end++) {
        guard_reset(at_end);
        check_forward(c->k, c->level);
        for (size_t i = 0; i < sizeof edges / sizeof *edges; i++) {
            guard_reset(at_end);
            check_inverse(c->k, c->level, i % 2 ? N_MAX : 16, edges[i]);
            expect_good(guard_intact(), c->level, "wrote beside its arrays");
        }
    }
}

int main(void)
{
    static const unsigned levels[] = {0, CPU_SSE41, CPU_SSE41 | CPU_AVX2,
                                      CPU_SSE41 | CPU_AVX2 | CPU_AVX512, CPU_NEON};
    guard_open();
    guard_trap();
    for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
        char names[CPU_NAMES_CAP];
        struct kernels k;
        if ((cpu_detect() & levels[i]) != levels[i])
            continue;
        kernels_init(&k, levels[i]);
        struct call c = {&k, cpu_names(levels[i], names)};
        int number = guard_call(check_tile, &c);
        expect_good(number == 0, c.level, "left its arrays, or an instruction is missing");
    }
    printf("%d failures\n", failures);
    return failures > 0;
}
