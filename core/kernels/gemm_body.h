/* gemm_body.h - products of floats and unpacking of weights, compiled once per instruction set.
 * Included by gemm_<isa>.c after one SIMD_ macro.
 * A tile keeps the sums of ROWS rows and two vectors of columns in registers, enough to hide the
 * latency of an FMA; each step loads two vectors of weights and one value of each row. */
#include "core/kernels/kernels.h"
#include "core/kernels/simd.h"

enum { F32_ROWS = LANES == 16 ? 8 : 6 };

static inline __attribute__((always_inline)) void f32_tile(const struct gemm_f32 *g, int i, int col,
                                                           int rows, int vecs)
{
    vf sum[F32_ROWS][2];
    const float *w0 = g->w + (size_t)(col / PANEL) * g->ldw + col % PANEL;
    const float *w1 = vecs < 2 ? w0 : LANES == PANEL ? w0 + g->ldw : w0 + LANES;
    float *c = g->c + (size_t)i * g->ldc + col;
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vecs; v++)
            sum[r][v] = g->add ? v_load(c + (size_t)r * g->ldc + LANES * v) : v_set(0);
    for (int s = 0; s < g->segs; s++) {
        const float *a = g->a + (size_t)i * g->lda + (size_t)s * g->seg_stride;
        for (int l = 0; l < g->seg; l++, w0 += PANEL, w1 += PANEL) {
            vf x0 = v_load(w0), x1 = vecs == 2 ? v_load(w1) : x0;
            for (int r = 0; r < rows; r++) {
                vf y = v_set(a[(size_t)r * g->lda + (size_t)l]);
                sum[r][0] = v_fma(x0, y, sum[r][0]);
                if (vecs == 2)
                    sum[r][1] = v_fma(x1, y, sum[r][1]);
            }
        }
    }
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vecs; v++)
            v_store(c + (size_t)r * g->ldc + LANES * v, sum[r][v]);
}

/* One or two vectors of columns of all rows. */
static inline __attribute__((always_inline)) void f32_columns(const struct gemm_f32 *g, int col,
                                                              int vecs)
{
    for (int i = 0; i < g->m; i += F32_ROWS)
        switch (g->m - i) {
        case 1:
            f32_tile(g, i, col, 1, vecs);
            break;
        case 2:
            f32_tile(g, i, col, 2, vecs);
            break;
        case 3:
            f32_tile(g, i, col, 3, vecs);
            break;
        case 4:
            f32_tile(g, i, col, 4, vecs);
            break;
        case 5:
            f32_tile(g, i, col, 5, vecs);
            break;
#if LANES == 16
        case 6:
            f32_tile(g, i, col, 6, vecs);
            break;
        case 7:
            f32_tile(g, i, col, 7, vecs);
            break;
#endif
        default:
            f32_tile(g, i, col, F32_ROWS, vecs);
        }
}

static void gemm_f32(const struct gemm_f32 *g)
{
    int col = 0, n = PANEL * g->panels;
    for (; col + 2 * LANES <= n; col += 2 * LANES)
        f32_columns(g, col, 2);
#if LANES == 16
    if (col < n)
        f32_columns(g, col, 1);
#endif
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
    k->f32_rows = F32_ROWS;
    k->unpack_s8 = unpack_s8;
    k->unpack_bf16 = unpack_bf16;
}
