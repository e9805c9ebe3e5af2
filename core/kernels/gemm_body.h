/* gemm_body.h - products of floats and unpacking of weights, compiled once per instruction set.
 * Included by gemm_<isa>.c after one SIMD_ macro.
 * A tile keeps the sums of F32_ROWS rows and two vectors of columns in registers, enough to hide
 * the latency of an FMA; each step loads two vectors of weights and one value of each row.
 * There is none for AVX-512: measured on Zen 4 it gains less than a tenth over AVX2. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"

enum { F32_ROWS = 6, AHEAD = 32 * PANEL }; // AHEAD: weights asked for before they are needed

static inline __attribute__((always_inline)) void f32_tile(const struct gemm_f32 *g, int i, int col,
                                                           int rows)
{
    vf sum[F32_ROWS][2];
    const float *w = g->w + (size_t)(col / PANEL) * g->ldw + col % PANEL;
    float *c = g->c + (size_t)i * g->ldc + col;
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < 2; v++)
            sum[r][v] = g->add ? v_load(c + (size_t)r * g->ldc + LANES * v) : v_set(0);
    for (int s = 0; s < g->segs; s++) {
        const float *a = g->a + (size_t)i * g->lda + (size_t)s * g->seg_stride;
        for (int l = 0; l < g->seg; l++, w += PANEL) {
            vf w0 = v_load(w), w1 = v_load(w + LANES);
            __builtin_prefetch(w + AHEAD);
            for (int r = 0; r < rows; r++) {
                vf x = v_set(a[(size_t)r * g->lda + (size_t)l]);
                sum[r][0] = v_fma(w0, x, sum[r][0]);
                sum[r][1] = v_fma(w1, x, sum[r][1]);
            }
        }
    }
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < 2; v++)
            v_store(c + (size_t)r * g->ldc + LANES * v, sum[r][v]);
}

static void gemm_f32(const struct gemm_f32 *g)
{
    for (int col = 0; col < PANEL * g->panels; col += 2 * LANES)
        for (int i = 0; i < g->m; i += F32_ROWS)
            switch (g->m - i) {
            case 1:
                f32_tile(g, i, col, 1);
                break;
            case 2:
                f32_tile(g, i, col, 2);
                break;
            case 3:
                f32_tile(g, i, col, 3);
                break;
            case 4:
                f32_tile(g, i, col, 4);
                break;
            case 5:
                f32_tile(g, i, col, 5);
                break;
            default:
                f32_tile(g, i, col, F32_ROWS);
            }
}

typedef int32_t vi __attribute__((vector_size(4 * LANES)));
typedef uint16_t vh __attribute__((vector_size(2 * LANES)));

static void unpack_s8(const int8_t *w, int k, float *out)
{
    for (int i = 0; i < k; i += 4, w += 4 * PANEL, out += 4 * PANEL)
        for (int j = 0; j < PANEL; j += LANES) {
            vi x; // four inputs of LANES outputs
            memcpy(&x, w + 4 * j, sizeof x);
            v_store(out + j, __builtin_convertvector(x << 24 >> 24, vf));
            v_store(out + j + PANEL, __builtin_convertvector(x << 16 >> 24, vf));
            v_store(out + j + 2 * PANEL, __builtin_convertvector(x << 8 >> 24, vf));
            v_store(out + j + 3 * PANEL, __builtin_convertvector(x >> 24, vf));
        }
}

static void unpack_bf16(const uint16_t *w, int k, float *out)
{
    for (int i = 0; i < k * PANEL; i += LANES) {
        vh x;
        memcpy(&x, w + i, sizeof x);
        vi bits = __builtin_convertvector(x, vi) << 16;
        memcpy(out + i, &bits, sizeof bits);
    }
}

static void gemm_fill(struct gemm_kernels *k, const char *name)
{
    k->f32_name = name;
    k->f32 = gemm_f32;
    k->unpack_s8 = unpack_s8;
    k->unpack_bf16 = unpack_bf16;
}
